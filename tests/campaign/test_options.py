"""Options of every command with evil values, outputs that cannot be written, and names of any kind."""

import contextlib
import functools
import shutil
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

from inclined_landing.eval import cli
from inclined_landing.models.parameters import load_vehicle
from tests.campaign.commands import (
    NAMES,
    NEEDED,
    POLICIES,
    SUFFIX,
    Option,
    accepted,
    called,
    options,
    place,
    refused,
)
from tests.campaign.flights import a_flight, text
from tests.campaign.judge import EVIL, Case, changed, command, examples, judged, places, write
from tests.campaign.test_policies import FILES, PICKLED, PICKLES, case, inner, tensor
from tests.campaign.test_toml import STUDY, VEHICLE, spelt
from tests.campaign.test_toml import case as toml_case

# Never right for any number, or for any name of something that is there.
NUMBERS = (
    *("nan", "inf", "-inf", "-1", "1e300", "9" * 400, "9" * 5000, "heavy", "", "１２", "1,2", "0x10", "1j"),
    *("None!", "\x1b[31m\n"),
)
TEXTS = (*NAMES, "no-such", "x" * 5000, "/proc/none", "/dev/zero", "", "LANDING", "é\u0301")
OUTPUTS = {
    "empty": "",
    "here": ".",
    "above": "..",
    "through nothing": "{place}/new/..",
    "everything": "/",
    "under a file": "{place}/log.csv/out",
    "deep under a file": "{place}/log.csv/a/b/out",
    "a file": "{place}/study.toml",
    "a full folder": "{place}/report",
    "over-long": "{place}/" + "x" * 300,
    "deep and over-long": "{place}/new/" + "é" * 200,
    "NUL": "{place}/a\0b",
    "not of this world": "/proc/none/out",
    "device": "/dev/null/out",
    "under a device": "/dev/null",
    "link to nowhere": "{place}/link/out",
    "a loop": "{place}/loop/out",
}
# Of them, what a name of a file cannot be: they stand without its ending.
NO_NAMES = (
    "empty",
    "here",
    "above",
    "through nothing",
    "everything",
    "a file",
    "a full folder",
    "under a device",
)
FOLDERS = ("here", "above", "everything", "a full folder")  # that files may be put into


known = functools.cache(options)


def options_that(keep: Callable[[str, Option], bool]) -> st.SearchStrategy[tuple[str, str]]:
    """Draw (command, option) of which something holds; commands are imported when it is drawn."""

    def found() -> list[tuple[str, str]]:
        return [
            (name, option) for name in NEEDED for option, about in known(name).items() if keep(option, about)
        ]

    return st.deferred(lambda: st.sampled_from(found()))


def is_text(option: str, about: Option) -> bool:
    return about.kind is not bool and not about.number and option not in ("out", "site", "page", "gamma")


def number(where: tuple[str, str], value: str) -> Case:
    """A numeric option with what no number, or no possible one, is spelt like: it is named."""
    name, option = where
    reach = known(name)[option].range
    if value == "-1" and (option == "inclination" or (reach and reach.low <= -1)):
        value = "nan"
    # What is a number, the command itself may refuse, and name it in other words.
    named = option.split("-")[-1] if value in ("-1", "1e300") else f"--{option}"
    return refused(f"{name} {option} {value[:20]!r}", name, [f"--{option}={value}"], named)


def bound(where: tuple[str, str], upper: bool) -> Case:
    """A numeric option beyond an end of its range, or at it where it is open."""
    name, option = where
    reach = known(name)[option].range
    value = (reach.high if upper else reach.low) + (0 if reach.open else 1 if upper else -1)
    # What landing-train has for other tasks and algorithms is refused as such first.
    sentence = f"--{option}"
    return refused(f"{name} {option} beyond {value}", name, [f"--{option}={value:.15g}"], sentence)


def idle(where: tuple[str, str], data) -> Case:
    """A name of nothing, while another option makes that it is not needed."""
    name, option = where
    others = [f"--{other}" for other, about in known(name).items() if about.kind is bool]
    others += [f"--{o}=0" for o, about in known(name).items() if about.range and about.range.low == 0]
    other = data.draw(st.sampled_from([*others, f"--{option}=none-such"]))
    return refused(f"{name} {option} {other}", name, [other, f"--{option}=none-such"])


def output(where: tuple[str, str], what: str) -> Case:
    """What a command writes into, where nothing can be written: it is said before any work."""
    name, option = where
    if what in FOLDERS and (name == "figure" or option in ("site", "page")):
        what = "under a file"
    suffix = "" if what in NO_NAMES else SUFFIX.get(name, "")
    return refused(f"{name} {option} {what}", name, [f"--{option}={OUTPUTS[what]}{suffix}"])


ZIPS = [case(name, FILES[name]) for name in ("none", "bomb", "a pickle")] + [
    inner(name, PICKLED, lambda name=name: PICKLES[name]) for name in ("runs code", "empty")
]
ZIPS.append(tensor("action_net.bias", "complex"))
TABLES = tomllib.loads(VEHICLE)
MASSES = [changed(TABLES, ("body", "mass", "value"), EVIL[evil]) for evil in ("nan", "minus one")]
VEHICLES = st.sampled_from(MASSES).map(lambda tables: toml_case("vehicle", "mass", lambda: spelt(tables)))
WITH_VEHICLE = options_that(lambda option, _: option == "vehicle").map(
    lambda where: (where[0], ["--vehicle={wrong}"], True)
)
WITH_POLICY = options_that(lambda option, _: option == "policy").map(
    lambda where: (where[0], ["--policy={wrong}"], True)
) | st.sampled_from(
    [(name, ["{wrong}", *words[1:]], False) for name, words in NEEDED.items() if {*words[:1]} & {*POLICIES}]
)


def given_file(bad: Case, where: tuple[str, list[str], bool]) -> Case:
    """A command that is given the wrong file of a case, and refuses it."""
    name, words, needed = where

    def take(path: Path) -> str:
        filled = [word.replace("{wrong}", str(path)) for word in words]
        return called(name, filled, path.parent, needed)

    return Case(f"{name} with {bad.name}", lambda folder: bad.make(place(folder)), take, accepted, bad.named)


def command_of(name: str) -> Case:
    """A command that there is not."""
    return Case(f"command {name[:20]!r}", place, lambda _: command(cli.main, [name]), named="")


KINDS = {
    "numbers": st.builds(number, options_that(lambda _, about: about.number), st.sampled_from(NUMBERS)),
    "bounds": st.builds(bound, options_that(lambda _, about: about.range is not None), st.booleans()),
    "texts": st.builds(
        lambda where, text: refused(f"{where} {text[:20]!r}", where[0], [f"--{where[1]}={text}"]),
        *(options_that(is_text), st.sampled_from(TEXTS)),
    ),
    "idle": st.builds(idle, options_that(is_text), st.data()),
    "commands": st.sampled_from((*NAMES, "x" * 5000, "")).map(command_of),
    "outputs": st.builds(
        output,
        options_that(lambda option, _: option in ("out", "site", "page")),
        st.sampled_from(list(OUTPUTS)),
    ),
    "files": st.builds(given_file, st.sampled_from(ZIPS), WITH_POLICY)
    | st.builds(
        given_file,
        VEHICLES | places("vehicle.toml", load_vehicle),
        WITH_VEHICLE,
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@examples(5)
@given(data=st.data())
def test_evil_options_are_refused_before_any_work(kind, data):
    judged(data.draw(KINDS[kind]))


def policy(folder: Path, name: str) -> str:
    shipped = resources.files("inclined_landing.envs") / "shipped/landing.zip"
    return str(shutil.copy(shipped, folder / f"{name}.zip"))


def vehicle(folder: Path, name: str) -> str:
    shipped = resources.files("inclined_landing.models") / "crazyflie.toml"
    return f"--vehicle={shutil.copy(shipped, folder / f'{name}.toml')}"


def flight(folder: Path, name: str) -> str:
    return str(write(folder / f"{name}.csv", text(a_flight())))


# Commands on files that are called `n`, in a folder `f`; they write into what --out says.
JOBS = {
    "success": lambda f, n: [policy(f, n), "--plant=analytic", vehicle(f, n), "--json"],
    "export": lambda f, n: [policy(f, n), "--format=c"],
    "figure": lambda f, n: [policy(f, n), "--start=1,1.5"],
    "landings": lambda f, n: [str(write(f / f"{n}.toml", STUDY))],
    "gap": lambda f, n: [flight(f, n), vehicle(f, n)],
    "identify": lambda f, n: [flight(f, n), vehicle(f, n)],
    "gap-example": lambda f, n: [],
    "figure whole": lambda f, n: [policy(f, n), "--whole", "--width=64", "--height=48"],
}


def job(name: str, called: str) -> Case:
    """Everything is called by an evil name, and all of it works."""

    def take(folder: Path) -> str:
        out = f"--out={folder}/{called}{SUFFIX.get(name, '')}"
        return command(cli.main, [name.split()[0], *JOBS[name](folder, called), out])

    return Case(f"{name} called {called!r}", lambda folder: folder, take, seconds=90, named="")


def into_empty(name: str) -> Case:
    """--out names an empty folder, the one that the shell is in: it gets the files."""

    def take(folder: Path) -> list[Path]:
        (folder / "empty").mkdir()
        with contextlib.chdir(folder / "empty"):
            command(cli.main, [name.split()[0], *JOBS[name](folder, "a"), "--out=."])
            return list(Path().iterdir())

    def works(files: list[Path]) -> None:
        assert files and not any(file.name.startswith(".") for file in files)

    return Case(f"{name} into an empty folder", lambda folder: folder, take, works, seconds=90, named="")


@examples(2)
@given(
    case=st.builds(
        job, st.sampled_from(list(JOBS)), st.sampled_from([name.removesuffix("x" * 20) for name in NAMES])
    )
    | st.sampled_from([name for name in JOBS if name not in SUFFIX]).map(into_empty)
)
def test_evil_names_and_empty_folders_work(case):
    assert judged(case) == "works"
