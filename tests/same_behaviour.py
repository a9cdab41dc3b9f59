"""Is the behaviour still the same? Records what the commands answer, and compares two records.

    python tests/same_behaviour.py record DIR [NAME ...]    with the installation of one version
    python tests/same_behaviour.py compare DIR DIR          of two versions

Only the public commands are used, so that one script runs on any two versions. Compared is every number of
their JSON, every landing of a study and every weight of a short training; left out are times, paths, versions
and words. "bit for bit" means equal; otherwise the largest difference and where it is. Takes some twenty
minutes a side on two cores.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import math
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

EVAL, TRAIN, VALIDATION = "inclined_landing.eval", "inclined_landing.train", "tests.validation"
# Name of the record -> module, arguments ({out} is a new folder), files whose content is compared.
COMMANDS = {
    "success_landing": (EVAL, "success landing --thrust-scale 1 1.05 0.95 0.88 --json", ()),
    "success_analytic": (EVAL, "success landing --plant analytic --json", ()),
    "success_setpoint": (EVAL, "success setpoint --json", ()),
    "success_tilted": (EVAL, "success landing --inclination -15 --json", ()),
    "touchdown": (EVAL, "touchdown touchdown --json", ()),
    "mission": (EVAL, "mission --missions 20 --seed 3 --json", ()),
    "robustness": (EVAL, "robustness landing landing-nominal --every 50 --json", ()),
    "moving": (EVAL, "robustness --over moving --json", ()),
    "equivalence": (EVAL, "equivalence --out {out}", ("report.json",)),
    "contact_truth": (EVAL, "contact --out {out}", ("contact.json",)),
    "paper_landing": (EVAL, "landings paper_landing --out {out}", ("results.parquet",)),
    "steep_landing": (EVAL, "landings steep_landing --out {out}", ("results.parquet",)),
    "train_landing": (TRAIN, "landing --steps 32768 --no-report --out {out}", ("final.zip", "best.zip")),
    "train_setpoint": (TRAIN, "setpoint --steps 16384 --no-report --out {out}", ("final.zip",)),
    "train_touchdown": (TRAIN, "touchdown --steps 98304 --no-report --out {out}", ("final.zip",)),
    "gap_example": (EVAL, "gap-example --out {out}", ("fit", "heldout")),
    "gap": (EVAL, "gap {flights} --out {out}", ("report.json",)),
    "identify": (EVAL, "identify {flights} --out {out}", ("report.json",)),
    "blind": (VALIDATION, "gap-blind --sets dev --seed 3 --cases 24 --out {out}", ("results.json",)),
    "success_effects": (EVAL, "robustness landing --over effects --every 1 --plant mujoco --json", ()),
}
SKIPPED = {
    *("versions", "seconds", "command", "policy", "baseline", "trained", "path", "out", "config"),
    *("landings_per_minute", "cores", "wall", "vehicle", "timings", "progress", "stages"),
}  # fmt: skip


def record(folder: Path, names: list[str]) -> None:
    """Run the commands and keep what they answer below `folder`."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or COMMANDS:
        module, arguments, files = COMMANDS[name]
        if (folder / f"{name}.json").exists():
            continue
        out = folder / "out" / name
        flights = sorted((folder / "out" / "gap_example" / "fit").glob("*.csv"))
        filled = []
        for word in arguments.split():
            filled += [str(f) for f in flights] if word == "{flights}" else [word.format(out=out)]
        began = time.monotonic()
        done = _run(module, filled)
        if done.returncode:
            sys.exit(f"{name}: exit code {done.returncode}\n{done.stderr[-2000:]}")
        answer = {file: _content(out / file) for file in files} if files else json.loads(done.stdout)
        (folder / f"{name}.json").write_text(json.dumps(answer), "utf-8")
        print(f"{name:18} {time.monotonic() - began:7.1f} s", flush=True)


def _run(module: str, words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command of the installed version; what makes evidence, from its repository."""
    place, environment = None, dict(os.environ)
    if module == VALIDATION:
        from inclined_landing import models

        roots = [Path(path).resolve().parent for path in models.__path__]
        place = next(root for root in roots if (root / "tests").is_dir())
        environment["PYTHONPATH"] = str(place)
    command = [sys.executable, "-P", "-m", module, *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=place, env=environment)


def _content(path: Path):
    """What is compared of a file: JSON, the columns of a table, the weights of a policy, or a checksum."""
    if path.is_dir():
        return {file.name: _content(file) for file in sorted(path.iterdir())}
    if path.suffix == ".json":
        return json.loads(path.read_text("utf-8"))
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        return {name: column.to_pylist() for name, column in zip(*_columns(pq.read_table(path)))}
    if path.suffix == ".zip":
        import torch

        with zipfile.ZipFile(path) as archive:
            tensors = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
        return {name: tensor.double().flatten().tolist() for name, tensor in tensors.items()}
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _columns(table):
    return table.column_names, table.columns


def compare(before: Path, after: Path) -> int:
    """Print one line for each record in both folders; returns how many are not bit for bit."""
    different = 0
    for name in COMMANDS:
        files = [folder / f"{name}.json" for folder in (before, after)]
        if not all(file.exists() for file in files):
            print(f"{name:18} not in both records")
            continue
        old, new = (dict(_leaves(json.loads(file.read_text("utf-8")))) for file in files)
        lines = _differences(old, new)
        different += bool(lines)
        print(f"{name:18} {len(old)} values, " + ("\n    ".join(lines) if lines else "bit for bit"))
    return different


def _differences(old: dict, new: dict) -> list[str]:
    gone, come = sorted(set(old) - set(new)), sorted(set(new) - set(old))
    lines = [f"{len(gone)} gone: {', '.join(gone[:4])}"] if gone else []
    lines += [f"{len(come)} new: {', '.join(come[:4])}"] if come else []
    changed = {k: (old[k], new[k]) for k in old if k in new and not _same(old[k], new[k])}
    if changed:
        worst = max(changed, key=lambda k: _distance(*changed[k]))
        lines.append(f"{len(changed)} differ, most at {worst}: {changed[worst][0]} -> {changed[worst][1]}")
    return lines


def _leaves(value, path: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in SKIPPED and not key.endswith("seconds"):
                yield from _leaves(inner, f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from _leaves(inner, f"{path}[{k}]")
    elif not (isinstance(value, str) and " " in value):  # words may be said better
        yield path, value


def _same(a, b) -> bool:
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def _distance(a, b) -> float:
    if not all(isinstance(x, (int, float)) for x in (a, b)):
        return math.inf
    return abs(a - b) / max(abs(a), abs(b), 1e-12)


def main() -> int:
    """The script; the exit code of a comparison is 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("record")
    one.add_argument("folder", type=Path)
    one.add_argument("names", nargs="*", choices=[[], *COMMANDS])
    two = commands.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "record":
        record(arguments.folder, arguments.names)
        return 0
    return int(compare(arguments.before, arguments.after) > 0)


if __name__ == "__main__":
    sys.exit(main())
