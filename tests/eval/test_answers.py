"""Commands end, and studies begin, with their outcome in a sentence; tables fit the screen.

Progress is not on stdout.
"""

import re

import pytest
from rich.text import Text

from inclined_landing.envs.shared.tables import new_table, show_table
from inclined_landing.eval import cli
from inclined_landing.eval.cli import COMMANDS
from inclined_landing.train import cli as train
from tests.campaign.inputs import place

SHARE = r"\(\d+\.\d % \[\d+\.\d, \d+\.\d\]\)"
SMALL = "--width 96 --height 64 --backend ray"
FLOWN = "robustness landing --plant analytic"
# Command lines, {place} being a folder of the campaign's, and how what they say ends.
QUICK = {
    "doctor": r"All requirements are met\..*",
    "export landing --format c --out {place}/out": r"is exported as c; .*contract.json describes .*\.",
    "gap-example --out {place}/out": r".*out contains twenty flights with hidden effects.*\.",
    "logs {place}/log.csv": r"1 of 1 log can be used(, 1 with limits)?\.",
    "success setpoint --plant analytic": rf"within 5 cm of its goal in \d+ of 200 flights {SHARE}\.",
    "mission --missions 2": rf"At rest on the feet after 2 of 2 missions {SHARE}\.",
    "plan {place}/report --out {place}/out": r"No flight is needed: body drag has .* over 99 %\.",
    "replay landing --out {place}/a.html": r"a.html shows 3 flights; open it in a browser\.",
    f"{FLOWN} --every 60 --over thrust": (
        rf"reached the goal box in 5 of 5 flights {SHARE}; 97 % or more at thrusts .*\."
    ),
    f"{FLOWN} --every 60 --over slopes": rf"in 5 of 5 flights {SHARE} on slopes of -25\.7 deg only\.",
    f"picture landing {SMALL} --out {{place}}/a.png": r"1 of 1 flight succeeded; .*a\.png\.",
}
LONG = {
    "figure landing --plant analytic --out {place}/out": r"2 of 2 flights succeeded; .*out has .*\.",
    "landings {place}/study.toml --out {place}/out": r"The page is .*index.html\.",
    f"video landing {SMALL} --out {{place}}/a.mp4": r"1 of 1 flight succeeded; .*a\.mp4\.",
    "benchmark": r"This machine simulates [\d,]+ control steps per second .*\.",
    "curves {place}/run --out {place}/a.png": r"The learning curves are in .*a\.png\.",
    "demo --out {place}/out": rf"goal box in 53 of 53 flights {SHARE}; open .*html in .*\.",
    "fly --simulated --out {place}/out": r"reached the goal box .* slope; the logs are in .*out\.",
    "gap {place}/20/fit/*.csv --out {place}/out": r"Thrust over mass .*rotor drag.*report.html\.",
    "identify {place}/20/fit/*.csv --out {place}/out": r"\d+ of \d+ constants differ.*vehicle.toml\.",
    "success landing": rf"landing reached the goal box in 251 of 251 flights {SHARE}\.",
    "robustness setpoint --over effects --plant analytic": r"under \d+ of \d+ effects; the worst is .*\.",
    "robustness planner --over moving": rf"planner came to rest .* in \d+ of 88 flights {SHARE}\..*",
    "touchdown touchdown": rf"policy came to rest .* {SHARE}; .*\.",
    "train setpoint --steps 4096 --out {place}/out": r"Training: ended after .*final.zip\.",
    "train sweep {place}/small.toml --out {place}/out": r"Small: .*it is .* cm .*\.",
    "contact --out {place}/out": r"\d+ of \d+ claims hold\. .*contact.html\.",
    "equivalence --quick --out {place}/out": r"(\d+) of \1 claims hold\. .*report.html\.",
}
SWEEP = """
title = "Small"
question = "None?"
answer = "After 4096 steps it is {error} from the goal."
seeds = [1, 2]
commands = [
    "landing-train setpoint --steps 4096 --seed {seed} --out {out} --no-report",
    "landing-eval success {out}/final.zip --plant analytic --out {out}/success",
]

[numbers.error]
title = "error"
file = "success/success.json"
row = { measure = "mean_error" }
unit = "cm"
factor = 100
"""
LINES = [
    pytest.param(*case, id=case[0].split(" --out")[0][:60], marks=[pytest.mark.slow] * (case[0] in LONG))
    for case in (QUICK | LONG).items()
]


def printed(line, folder, capsys) -> tuple[str, str]:
    """Stdout and stderr of a command line; stars are files."""
    words = []
    for word in line.replace("{place}", str(folder)).split():
        words += sorted(map(str, folder.glob(word[len(str(folder)) + 1 :]))) if "*" in word else [word]
    code = train.main(words[1:]) if words[0] == "train" else cli.main(words)
    out, err = capsys.readouterr()
    assert code == 0, err
    return out, err


@pytest.mark.parametrize(("line", "outcome"), LINES)
def test_a_sentence_says_what_came_out(line, outcome, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    place(tmp_path)
    (tmp_path / "small.toml").write_text(SWEEP)
    if "/20/" in line:
        printed("gap-example --out {place}/20", tmp_path, capsys)
    if "/run" in line:
        printed("train setpoint --steps 4096 --no-report --out {place}/run", tmp_path, capsys)
    out, _ = printed(line, tmp_path, capsys)
    if (
        COMMANDS.get(line.split()[0], "").startswith("study.") or line == "benchmark"
    ):  # the answer comes first
        assert re.search(f"{outcome}$", out[: out.index("\n  ")], re.MULTILINE), out
    else:
        assert re.search(f"{outcome}$", out.splitlines()[-1]), out
    rows = [row for row in out.splitlines() if row.endswith(" ")]  # of tables, which fill their width
    assert max(map(len, rows), default=0) <= 80
    assert not {"━", "\r", "…"} & set(out)


def test_every_command_has_its_line():
    assert {line.split()[0] for line in QUICK | LONG} == set(COMMANDS) | {"train"}


@pytest.mark.parametrize("width", [60, 80, 120])
def test_numbers_are_never_wrapped(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    table = new_table(
        "A title", "policy", "slopes", "strict [%]", "success [%]", "time to the goal [s]", labels=2
    )
    cells = ("99.6 [97.8, 99.9]", "98.4 [96.0, 99.4]", "1.72 (0.83 to 2.32)")
    table.add_row("landing", "on every slope that it knows", *cells)
    table.add_row(Text("landing-slopes"), "", *cells, end_section=True)
    table.caption = "What the columns are."
    show_table(table)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "A title" and lines[-1] == "What the columns are."
    assert max(map(len, lines)) <= width
    assert all(sum(cell in line for line in lines) == 2 for cell in cells)
    assert sum("landing" in line for line in lines) == (2 if width == 120 else 2 * len(cells))
