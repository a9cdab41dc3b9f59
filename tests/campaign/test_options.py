"""Options of every command with evil values, outputs that cannot be written, and names of any kind."""

import contextlib
import functools
import shutil
import tomllib
from importlib import resources
from pathlib import Path

from inclined_landing.eval import cli
from tests.campaign.commands import NAMES, NEEDED, POLICIES, SUFFIX, accepted, called, options, place, refused
from tests.campaign.flights import a_flight, text
from tests.campaign.judge import EVIL, Case, changed, command, judge, parametrised, write
from tests.campaign.test_policies import pickles, tensors, zips
from tests.campaign.test_toml import STUDY, VEHICLE, case, elsewhere, spelt, texts

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


def evil_numbers():
    """Every numeric option with what no number, or no possible one, is spelt like: it is named."""
    for name in NEEDED:
        for option, about in options(name).items():
            for k, value in enumerate(NUMBERS if about.number else ()):
                down = option == "inclination" or (about.range and -1 in about.range)
                if value != "-1" or not down:
                    # What is a number, the command itself may refuse, and name it in other words.
                    named = option.split("-")[-1] if value in ("-1", "1e300") else f"--{option}"
                    yield refused(f"{name} {option} number {k}", name, [f"--{option}={value}"], named)


def bounds():
    """Every numeric option with a range, beyond its ends, and at them where they are open."""
    for name in NEEDED:
        for option, about in options(name).items():
            if about.range is None:
                continue
            low, high = about.range.low, about.range.high
            beyond = (low, high) if about.range.open else (low - 1, high + 1)
            for value in beyond:
                # What landing-train has for other tasks and algorithms is refused as such first.
                sentence = f"--{option}" if name == "train" else f"--{option} must lie {about.range}, not "
                yield refused(f"{name} {option} beyond {value}", name, [f"--{option}={value:.15g}"], sentence)


def evil_texts():
    """Every other option with names of nothing that is there."""
    for name in NEEDED:
        for option, about in options(name).items():
            if about.kind is bool or about.number or option in ("out", "site", "gamma"):
                continue
            for k, value in enumerate(TEXTS):
                yield refused(f"{name} {option} text {k}", name, [f"--{option}={value}"])


def evil_commands():
    """Commands that there are not."""
    for k, name in enumerate((*NAMES, "x" * 5000, "")):
        yield Case(f"command {k}", place, lambda _, name=name: command(cli.main, [name]), named="")


def idle_options():
    """Names of nothing, while another option makes that they are not needed."""
    for name in NEEDED:
        known = options(name)
        idle = [f"--{option}" for option, about in known.items() if about.kind is bool]
        idle += [f"--{o}=0" for o, about in known.items() if about.range and about.range.low == 0]
        for option, about in known.items():
            if about.kind is bool or about.number or option in ("out", "site", "gamma"):
                continue
            for other in idle:
                yield refused(f"{name} {option} {other}", name, [other, f"--{option}=none-such"])


def evil_outputs():
    """Whatever a command writes into, where nothing can be written: it is said before any work."""
    for name in NEEDED:
        for option in [o for o in options(name) if o in ("out", "site")]:
            for what, out in OUTPUTS.items():
                if what in FOLDERS and (name == "figure" or option == "site"):
                    continue
                suffix = "" if what in NO_NAMES else SUFFIX.get(name, "")
                yield refused(f"{name} {option} {what}", name, [f"--{option}={out}{suffix}"])


def wrong_files():
    """Every command that takes a policy or a vehicle, with a file that is none."""
    wrong = {"zip without policy.pth", "zip bomb", "tensor action_net.bias complex", "pickle runs code"}
    policies = [bad for bad in (*zips(), *tensors(), *pickles()) if bad.name in wrong]
    wrong = {"vehicle UTF-16", "vehicle nothing there", "vehicle a pipe", "vehicle a folder"}
    vehicles = [bad for bad in (*texts("vehicle"), *elsewhere("vehicle")) if bad.name in wrong]
    for evil in ("nan", "minus one"):
        tables = changed(tomllib.loads(VEHICLE), ("body", "mass", "value"), EVIL[evil])
        vehicles.append(case("vehicle", f"mass {evil}", functools.partial(spelt, tables)))
    for name, words in NEEDED.items():
        known = options(name)
        for bad in policies:
            if "policy" in known:
                yield given(name, bad, ["--policy={wrong}"])
            elif words[:1] and words[0] in POLICIES:
                yield given(name, bad, ["{wrong}", *words[1:]], needed=False)
        for bad in vehicles if "vehicle" in known else ():
            yield given(name, bad, ["--vehicle={wrong}"])


def given(name: str, bad: Case, words: list[str], needed: bool = True) -> Case:
    """A command that is given the wrong file of a case, and refuses it."""

    def take(path: Path) -> str:
        filled = [word.replace("{wrong}", str(path)) for word in words]
        return called(name, filled, path.parent, needed)

    return Case(f"{name} with {bad.name}", lambda folder: bad.make(place(folder)), take, accepted)


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


def evil_names():
    """Everything is called by an evil name, and all of it works."""
    for k, name in enumerate(name.removesuffix("x" * 20) for name in NAMES):
        for job, words in JOBS.items():

            def take(folder: Path, job=job, words=words, name=name) -> str:
                return command(
                    cli.main,
                    [job.split()[0], *words(folder, name), f"--out={folder}/{name}{SUFFIX.get(job, '')}"],
                )

            yield Case(f"{job} called {k}", lambda folder: folder, take, seconds=90, named="")


def in_empty_folders():
    """--out names an empty folder, the one that the shell is in: it gets the files."""
    for job, words in JOBS.items():
        if job in SUFFIX:
            continue

        def take(folder: Path, job=job, words=words) -> list[Path]:
            (folder / "empty").mkdir()
            with contextlib.chdir(folder / "empty"):
                command(cli.main, [job.split()[0], *words(folder, "a"), "--out=."])
                return list(Path().iterdir())

        def works(files: list[Path]) -> None:
            assert files and not any(file.name.startswith(".") for file in files)

        yield Case(f"{job} into an empty folder", lambda folder: folder, take, works, seconds=90, named="")


@parametrised(
    evil_numbers, bounds, evil_texts, idle_options, evil_commands, evil_outputs, wrong_files, each=3
)
def test_evil_options_are_refused_before_any_work(case, tmp_path):
    judge(case, tmp_path)


@parametrised(evil_names, in_empty_folders, each=1)
def test_evil_names_and_empty_folders_work(case, tmp_path):
    assert judge(case, tmp_path) == "works"
