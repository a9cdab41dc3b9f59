"""Hidden-effect sets that go on in damaged folders."""

import functools
import json
from pathlib import Path

from tests.campaign.judge import TEXTS, Case, judge, mutations, parametrised, respelt, spoilt, write
from tests.proof.gap_blind import cases as drawn
from tests.proof.gap_blind import command as blind

CASES = {case.name: case.label() for case in drawn.of_set("dev", 0, len(drawn.STRATA))}
NAME, LABEL = next((name, label) for name, label in CASES.items() if label["causes"])
SET = {"set": "dev", "seed": 0, "cases": len(CASES)}
REPORT = {
    "verdict": "effects",
    "effects": [{"name": LABEL["causes"][0], "class": [], "parameters": {}}],
    "sets": [{"effects": [LABEL["causes"][0]], "probability": 1.0}],
    "gap": {},
    "seconds": 1.0,
}


def resumed(folder: Path) -> None:
    blind._open_set(folder, SET, CASES)
    row = blind._scored(folder, "workflow", NAME, LABEL)
    if row is None:  # is made again
        write(blind._report(folder, "workflow", NAME), json.dumps(REPORT))
        assert blind._scored(folder, "workflow", NAME, LABEL)["outcome"]


def case(title: str, file: str, change) -> Case:
    def make(folder: Path) -> Path:
        out = folder / "out"
        report = blind._report(out, "workflow", NAME)
        report.parent.mkdir(parents=True)
        blind._open_set(out, SET, CASES)
        write(report, json.dumps(REPORT))
        path = report if file == "report" else out / file
        content = change(path.read_bytes())
        path.unlink()
        if content is not None:
            write(path, content)
        return out

    return Case(title, make, resumed, named="out")


def damages(file: str):
    for what, content in (TEXTS | {"missing": None}).items():
        yield case(f"{file} {what}", file, lambda old, content=content: content)
    for k in range(21):
        yield case(f"{file} damage {k}", file, lambda old, k=k: list(mutations(old, k + 1))[k][1]())


def entries(file: str, like: dict):
    for name, change in spoilt(like):
        yield case(f"{file} {name}", file, functools.partial(respelt, change=change))


FILES = ("set.json", "sealed/labels.json", "report")


@parametrised(
    *(functools.partial(damages, file) for file in FILES),
    functools.partial(entries, "set.json", SET),
    functools.partial(entries, "report", REPORT),
    each=1,
)
def test_sets_go_on_or_say_why_not(case, tmp_path):
    judge(case, tmp_path)
