"""Every option of every command with evil values, outputs that cannot be written, and names of any kind."""

import dataclasses
import inspect
import shutil
import typing
from importlib import resources
from pathlib import Path

import pytest

from campaign.judge import Case, command, judge, parametrised, write
from campaign.test_logs import NAMES, a_flight, text
from campaign.test_studies import STUDY
from inclined_landing.eval import cli

RECIPE = resources.files("inclined_landing.train") / "recipes" / "landing.toml"

# What each command needs to start its work, {place} being a folder with the files below.
NEEDED = {
    "demo": ("--out", "{place}/out"),
    "success": ("landing",),
    "touchdown": ("touchdown",),
    "vehicles": ("landing", "--out", "{place}/out"),
    "mission": (),
    "robustness": ("landing", "--out", "{place}/out"),
    "moving": ("planner", "--out", "{place}/out"),
    "export": ("landing", "--format", "numpy", "--out", "{place}/out"),
    "figure": ("landing", "--out", "{place}/out"),
    "video": ("landing", "--out", "{place}/out.mp4"),
    "picture": ("landing", "--out", "{place}/out.png"),
    "replay": ("landing", "{place}/log.csv", "--out", "{place}/out.html"),
    "view": ("landing",),
    "beyond": (str(RECIPE), "--out", "{place}/out"),
    "slopes": ("landing-slopes", "--out", "{place}/out"),
    "curves": ("{place}", "--out", "{place}/out.png"),
    "equivalence": ("--out", "{place}/out"),
    "contact-truth": ("--out", "{place}/out"),
    "landings": ("{place}/study.toml", "--out", "{place}/out"),
    "logs": ("{place}/log.csv",),
    "flights": ("nanobench", "{place}/log.csv", "--out", "{place}/out"),
    "identify": ("{place}/log.csv", "--out", "{place}/out"),
    "gap": ("{place}/log.csv", "--out", "{place}/out"),
    "plan": ("{place}/report", "--out", "{place}/out"),
    "effects": (),
    "gap-example": ("--out", "{place}/out"),
    "gap-blind": ("--out", "{place}/out"),
    "plan-proof": ("--out", "{place}/out"),
    "gap-agreement": ("--out", "{place}/out"),
    "gap-real": ("{place}", "--out", "{place}/out"),
    "nanobench": ("{place}/log.csv",),
    "crazyflie": ("--port=0", "--seconds=0.1"),
    "fly": ("--simulated", "--out", "{place}/out"),
    "flight-table": ("--out", "{place}/out"),
    "benchmark": (),
    "doctor": (),
}
# Never right for any number, or for any name of something that is there.
NUMBERS = (
    *(
        "nan",
        "inf",
        "-inf",
        "-1",
        "1e300",
        "9" * 400,
        "9" * 5000,
        "heavy",
        "",
        "１２",
        "1,2",
        "0x10",
        "1j",
        "--",
    ),
    "\x1b[31m\n",
)
TEXTS = (*NAMES, "none", "x" * 5000, "/proc/none", "/dev/zero", "", "LANDING", "é\u0301")
REPORT = '{"sets": [{"effects": ["body_drag"], "probability": 1.0, "values": {"body_drag": {}}}]}'
OUTPUTS = {
    "under a file": "{place}/log.csv/out",
    "deep under a file": "{place}/log.csv/a/b/out",
    "a file": "{place}/study.toml",
    "over-long": "{place}/" + "x" * 300,
    "deep and over-long": "{place}/new/" + "é" * 200,
    "not of this world": "/proc/none/out",
    "device": "/dev/null/out",
    "under a device": "/dev/null",
    "link to nowhere": "{place}/link/out",
}


def place(folder: Path) -> Path:
    write(folder / "log.csv", text(a_flight()))
    write(folder / "study.toml", STUDY)
    (folder / "report").mkdir()
    write(folder / "report/report.json", REPORT)
    (folder / "link").symlink_to(folder / "nowhere" / "at" / "all")
    return folder


def options(name: str) -> dict[str, object]:
    """Options of a command and their types; groups as their fields."""
    function = cli.find(name)
    hints = typing.get_type_hints(function, include_extras=True)
    found = {}
    for key, parameter in inspect.signature(function).parameters.items():
        kind = typing.get_args(hints[key])[0] if hasattr(hints[key], "__metadata__") else hints[key]
        if dataclasses.is_dataclass(kind):
            fields = typing.get_type_hints(kind)
            found |= {field.name: fields[field.name] for field in dataclasses.fields(kind)}
        elif parameter.kind != inspect.Parameter.POSITIONAL_ONLY and "Suppress" not in repr(hints[key]):
            found[key] = kind
    return {key.replace("_", "-"): kind for key, kind in found.items() if key != "files"}


def run(title: str, name: str, words: list[str]) -> Case:
    def take(folder: Path) -> str:
        given = [word.format(place=folder) for word in NEEDED[name]]
        kept = [w for w in words if w.startswith("--out")]
        if kept and "--out" in given:
            at = given.index("--out")
            given = given[:at] + given[at + 2 :]
        return command(cli.main, [name, *given, *(word.replace("{place}", str(folder)) for word in words)])

    def works(printed: str) -> None:
        pytest.fail(f"accepted: {printed[:300]}")

    return Case(title, place, take, works, named="")


def evil_options():
    for name in cli.COMMANDS:
        for option, kind in options(name).items():
            if kind is bool or option == "out":
                continue
            numeric = any(number in str(kind) for number in ("int", "float"))
            for k, value in enumerate(NUMBERS if numeric else TEXTS):
                if option == "inclination" and value == "-1":
                    continue  # slopes down either way
                if option == "site" and value == "":
                    continue  # the folder one is in
                yield run(f"{name} {option} {k}", name, [f"--{option}={value}"])
    for k, name in enumerate((*NAMES, "x" * 5000, "")):
        yield Case(f"command {k}", place, lambda _, name=name: command(cli.main, [name]), named="")


def evil_outputs():
    for name in cli.COMMANDS:
        if "out" not in options(name):
            continue
        suffix = {"video": ".mp4", "picture": ".png", "curves": ".png", "replay": ".html"}.get(name, "")
        for what, out in OUTPUTS.items():
            if what in ("a file", "under a device") and suffix:
                continue
            yield run(f"{name} {what}", name, [f"--out={out}{suffix}"])


def evil_names():
    """Everything is called by an evil name, and all of it works."""

    def policy(folder: Path, name: str) -> Path:
        return shutil.copy(
            resources.files("inclined_landing.envs") / "shipped/landing.zip", folder / f"{name}.zip"
        )

    def vehicle(folder: Path, name: str) -> Path:
        return shutil.copy(
            resources.files("inclined_landing.models") / "crazyflie.toml", folder / f"{name}.toml"
        )

    for k, name in enumerate(name.removesuffix("x" * 20) for name in NAMES):
        jobs = {
            "success": lambda f, n=name: [
                *("success", str(policy(f, n)), "--plant=analytic", f"--vehicle={vehicle(f, n)}"),
                *("--json", f"--out={f}/{n}"),
            ],
            "export": lambda f, n=name: ["export", str(policy(f, n)), "--format=c", f"--out={f}/{n}"],
            "picture": lambda f, n=name: [
                "picture",
                str(policy(f, n)),
                "--width=64",
                "--height=48",
                f"--out={f}/{n}.png",
            ],
            "figure": lambda f, n=name: ["figure", str(policy(f, n)), "--start=1,1.5", f"--out={f}/{n}"],
            "landings": lambda f, n=name: ["landings", str(write(f / f"{n}.toml", STUDY)), f"--out={f}/{n}"],
            "gap": lambda f, n=name: [
                *("gap", str(write(f / f"{n}.csv", text(a_flight()))), f"--vehicle={vehicle(f, n)}"),
                f"--out={f}/{n}",
            ],
            "identify": lambda f, n=name: [
                *("identify", str(write(f / f"{n}.csv", text(a_flight()))), f"--vehicle={vehicle(f, n)}"),
                f"--out={f}/{n}",
            ],
            "gap-example": lambda f, n=name: ["gap-example", f"--out={f}/{n}"],
        }
        for job, words in jobs.items():
            yield Case(
                f"{job} called {k}",
                lambda folder: folder,
                lambda folder, words=words: command(cli.main, words(folder)),
                seconds=90,
                named="",
            )


@parametrised(evil_options(), sample=40)
def test_evil_options_are_refused_before_any_work(case, tmp_path):
    judge(case, tmp_path)


@parametrised(evil_outputs(), sample=20)
def test_what_cannot_be_written_is_found_before_any_work(case, tmp_path):
    judge(case, tmp_path)


@parametrised(evil_names(), sample=2)
def test_evil_names_are_only_names(case, tmp_path):
    assert judge(case, tmp_path) == "works"
