"""The quickstart and the guides, followed to the letter: every `sh`, file and Python block in its order."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import ROOT, documents

GUIDES = [name for name in documents.documents() if name.startswith("docs/guides/")]
# Lines of guides that take long beyond what they show, as they are run here.
SHORTER = {"--steps 2000000": "--steps 100000", "cleanrl_ppo.py 201": "cleanrl_ppo.py 201 20000"}


def _shell(text: str, folder: Path, environment: dict[str, str]) -> None:
    for line in re.sub(r"\\\n\s*", " ", text).splitlines():
        began = time.monotonic()
        done = subprocess.run(
            ["bash", "-ec", line], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        print(f"{time.monotonic() - began:7.1f} s  {line}")
        assert done.returncode == 0, f"{line}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


@pytest.mark.slow
def test_the_quickstart_in_a_fresh_clone(tmp_path):
    """From `make` to the policy's video."""
    clone = tmp_path / "inclined-landing"
    subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
    script = ["set -e"]
    for language, title, text in documents.blocks("docs/quickstart.md"):
        if language in documents.SHELLS:
            script += text.splitlines()
        elif language == "python":
            assert title is None
            script.append(f"python - <<'BLOCK'\n{text}BLOCK")
    environment = {k: v for k, v in os.environ.items() if k not in ("VIRTUAL_ENV", "PYTHONPATH")}
    environment["PYTHON"] = str(Path(sys.base_prefix) / "bin" / "python3")
    words = ["bash", "-c", "\n".join(script)]
    done = subprocess.run(words, cwd=clone, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "goal box reached: True" in done.stdout
    promised = re.findall(
        r"`([\w.]+\.(?:zip|json|mp4|png|csv|pt))`", (ROOT / "docs/quickstart.md").read_text("utf-8")
    )
    run = clone / "runs" / "landing-42"
    assert len(promised) >= 10 and all((run / name).is_file() for name in promised), sorted(os.listdir(run))
    assert all((clone / f"my_landing.{kind}").stat().st_size > 10_000 for kind in ("mp4", "html"))
    shutil.rmtree(clone)


@pytest.mark.slow
@pytest.mark.parametrize("name", GUIDES)
def test_a_guide(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("inclined_landing.envs.tasks._OWN", {})
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    namespace: dict = {}
    for number, (language, title, text) in enumerate(documents.blocks(name)):
        if language == "sh":  # those of `console` need hardware, a display or hours
            for long, short in SHORTER.items():
                text = text.replace(long, short)
            _shell(text, tmp_path, os.environ | {"PATH": path})
        elif language == "toml" and (file := re.match(r"# (\w+\.toml)\n", text)):
            (tmp_path / file[1]).write_text(text, "utf-8")
        elif language == "python":
            documents.run_python(title, text, namespace, f"{name}, block {number}")
    if name.endswith("close_the_gap.md"):
        likely = [
            sum(
                one["probability"]
                for one in json.loads(report.read_text("utf-8"))["sets"]
                if "body_drag" in one["effects"]
            )
            for report in (tmp_path / f"{name}_report" / "report.json" for name in ("first", "planned"))
        ]
        assert likely[0] < likely[1], likely  # the hidden cause, before and after the planned flight
    if name.endswith("platforms.md"):
        assert (tmp_path / "my_slope" / "index.html").is_file()


@pytest.mark.slow
def test_the_gap_workflow_from_python(tmp_path, monkeypatch, capsys):
    """The Python of its manual, on six flights of one vehicle: nothing changed between them."""
    monkeypatch.chdir(tmp_path)
    assert documents.cli.main(["gap-example", "--out", "flights"]) == 0
    paths = sorted(Path("flights/fit").glob("*.csv"))
    namespace = {"before": paths[:3], "after": paths[3:6]}
    blocks = documents.blocks("eval/gap/README.md", "python")
    assert blocks
    for _, _, text in blocks:
        documents.run_python(None, text, namespace, "eval/gap/README.md")
    assert capsys.readouterr().out.splitlines()[-1].startswith("nothing {}")
