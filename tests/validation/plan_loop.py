"""`plan-loop`: identify, fly, gap, plan, fly what was planned, gap, all by the commands of the user.

A simulated Crazyflie with one hidden cause flies an ordinary landing, after which the cause is in doubt. From
there the loop goes on with one planned flight; beside it, from the same landing, with two further landings.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.models.base import storage
from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from tests.validation.gap_blind import score
from tests.validation.shared import check_known, table_of

# Small enough that one landing leaves them in doubt, as looked at with seed 100; the last one because
# ordinary flights do not go where it is.
CAUSES: dict[str, dict[str, float]] = {
    "attitude_delay": {"delay": 0.012},
    "body_drag": {"coefficient": 0.002},
    "motor_lag": {"scale": 1.25},
    "ground_effect": {"strength": 6.0, "fading": 3.0},
}
HEALTHY = 6  # landings that the vehicle is identified from
ORDINARY = 2  # further landings in the place of the planned flight


class Failed(Exception):
    """Raised for a command that ended with an exit code which is not its own."""


class _Shell:
    """Runs commands as a user types them, and keeps them with their times."""

    def __init__(self):
        self.steps: list[dict] = []

    def __call__(self, *words: object, codes: Sequence[int] = (0,)) -> None:
        """Run a command of this installation. Raises Failed for an exit code that is none of `codes`."""
        typed = [str(word) for word in words]
        print("$ " + shlex.join(typed), file=sys.stderr, flush=True)
        began = time.monotonic()
        program = str(Path(sys.executable).parent / typed[0])
        done = subprocess.run([program, *typed[1:]], check=False, capture_output=True, text=True)
        seconds = time.monotonic() - began
        self.steps.append({"command": shlex.join(typed), "seconds": seconds, "said": done.stdout})
        if done.returncode not in codes:
            raise Failed(f"{shlex.join(typed)} ended with {done.returncode}: {done.stderr.strip()}")


def command(
    out: Folder,
    seed: Seed = 0,
    causes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CAUSE [CAUSE ...]")] = tuple(CAUSES),
) -> None:
    """The loop with planned flights on hidden causes, beside ordinary flights (minutes).

    Args:
        out: new folder for all files, results.json and table.md.
        seed: of the flights.
        causes: hidden one after the other.
    """
    check_known("cause", causes, CAUSES)
    runs.check_new_run(out)
    out.mkdir(parents=True, exist_ok=True)
    shell = _Shell()
    fly(shell, out / "healthy", 1000 * seed, "landing-nominal", "--flights", HEALTHY)
    shell("landing-eval", "identify", *logs(out / "healthy"), "--platform", "--out", out / "identified")
    rows = [loop(shell, out / name, name, CAUSES[name], 1000 * seed + 10) for name in causes]
    text = table_of(list(map(line, rows)))
    results = {"seed": seed, "rows": rows, "steps": shell.steps, "versions": runs.versions()}
    storage.write_json(out / "results.json", results)
    storage.write_text(out / "table.md", text)
    print(text)


def loop(shell: _Shell, folder: Path, cause: str, values: Mapping[str, float], seed: int) -> dict:
    """Return the probabilities of the right set before and after, and the seconds that the loop took."""
    folder.mkdir()
    hidden, identified = folder / "hidden.toml", folder.parent / "identified" / "vehicle.toml"
    write_vehicle(hidden, apply(load_vehicle(), {cause: dict(values)}))
    vehicle = ("--vehicle", hidden)
    began = len(shell.steps)

    def gap(name: str, *folders: str) -> dict:
        flown = [log for one in folders for log in logs(folder / one)]
        options = ("--vehicle", identified, "--platform", "--out", folder / name)
        shell("landing-eval", "gap", *flown, *options)
        return json.loads((folder / name / "report.json").read_text("utf-8"))

    fly(shell, folder / "first", seed, "landing-nominal", *vehicle)
    before = gap("report", "first")
    row = {"cause": cause, "values": dict(values), "before": right(cause, before), "planned": None}
    shell("landing-eval", "plan", folder / "report", "--out", folder / "plan")
    row["plan_seconds"] = shell.steps[-1]["seconds"]
    if (folder / "plan" / "flight.csv").is_file():
        plan = json.loads((folder / "plan" / "plan.json").read_text("utf-8"))
        row["lowest"], row["expected"] = plan["simulated"]["lowest"], plan["expected"]
        row["pieces"] = [piece["text"] for piece in plan["pieces"]]
        fly(shell, folder / "planned", seed + 1, "--plan", folder / "plan" / "flight.csv", *vehicle)
        row["planned"] = right(cause, gap("after", "first", "planned"))
    row["seconds"] = sum(step["seconds"] for step in shell.steps[began:])
    fly(shell, folder / "further", seed + 2, "landing-nominal", "--flights", ORDINARY, *vehicle)
    row["ordinary"] = right(cause, gap("beside", "first", "further"))
    return row


def fly(shell: _Shell, out: Path, seed: int, *what: object) -> None:
    """Fly; a landing that misses (exit code 3) is a log as well."""
    words = ("landing-eval", "fly", *what, "--simulated", "--seed", seed, "--out", out)
    shell(*words, codes=(0, 3))


def logs(folder: Path) -> list[Path]:
    """Return the logs of a folder of flights."""
    return sorted(folder.glob("flight_??.csv"))


def right(cause: str, report: Mapping) -> float:
    """Return the probability of the sets that name the cause and nothing that does not belong to it."""
    return score.belief({"causes": [cause], "base": []}, report)["truth"]


def line(row: Mapping) -> dict:
    """Return a row as a line of the table."""
    values = ", ".join(f"{name} {value:g}" for name, value in row["values"].items())
    return {
        "hidden cause": f"{row['cause']} ({values})",
        "before": f"{row['before']:.2f}",
        "after one planned flight": "not planned" if row["planned"] is None else f"{row['planned']:.2f}",
        "after two ordinary flights": f"{row['ordinary']:.2f}",
        "planning": f"{row['plan_seconds']:.0f} s",
        "lowest": f"{row['lowest']:.2f} m" if "lowest" in row else None,
    }
