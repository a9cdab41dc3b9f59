"""Every option of every command changes something, or is refused where it does not."""

import collections
import dataclasses
import typing

import pytest

from inclined_landing.envs.shared import command_line
from inclined_landing.envs.shared.options import Only, flag_of
from inclined_landing.eval import cli
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.sweep.command import command as sweep

COMMANDS = {name: cli.find(name) for name in cli.COMMANDS} | {"sweep": sweep}
# Lines with an option that has no effect there: the option is the last one.
REFUSED = [
    "fly --plan a.csv --start 0,2",
    "fly --no-platform",
    *(f"fly --simulated --{option}"
      for option in ("uri a", "mocap a", "mocap-latency 0", "stand 0", "heading 3")),
    *(f"fly --position onboard --{option}" for option in ("mocap a", "mocap-latency 0", "heading 3")),
    *(f"fly --{option}" for option in ("vehicle hidden", "fault a", "seed 3")),
    "mission --start 0,0,2 --missions 5",
    "mission --start 0,0,2 --seed 3",
    "mission --no-film",
    *(f"mission {given} --{option}" for given in ("", "--out o --no-film")
      for option in ("camera side", "width 64", "height 64", "backend ray")),
    "replay log.csv --out a.html --start 0,2",
    "replay log.csv --out a.html --drawn 2",
    "replay landing --out a.html --start 0,2 --drawn 2",
    "replay landing --out a.html --seed 3",
    *(f"replay landing --out a.html --{option}"
      for option in ("restart 2", "mapping a", "unit a=deg", "where a=b", "platform")),
    *(f"robustness landing --over moving --{option}" for option in ("plant analytic", "every 3")),
    "robustness landing --over slopes --draws 3",
    "video landing --out a.gif --gif",
    "video landing --out a.mp4 --seed 3",
    "video landing --out a.mp4 --start 0,2 --drawn 3",
]  # fmt: skip


def options_of(command) -> dict[str, tuple[tuple, bool]]:
    """Marks of each option of a command, those of its group included, and whether it has several values."""
    found = {}
    for name, kind in typing.get_type_hints(command, include_extras=True).items():
        marks, plain = getattr(kind, "__metadata__", ()), getattr(kind, "__origin__", kind)
        if dataclasses.is_dataclass(plain):
            found |= {inner: (marks + more, many) for inner, (more, many) in options_of(plain).items()}
        elif name != "return":
            found[name] = marks, typing.get_origin(plain) is tuple and "Positional" not in repr(kind)
    return found


def parsed(line: str):
    name, *words = line.split()
    target = COMMANDS[name]
    return command_line.parse(target, name, words)


@pytest.mark.parametrize("line", REFUSED)
def test_an_option_without_an_effect_is_refused(line):
    option = line.split(" --")[-1].split()[0]
    with pytest.raises(UserError, match=f"^--{option} has no effect with"):
        parsed(line)
    parsed(line[: line.rindex(" --")])


def test_every_mark_has_its_line():
    """As many lines as the option has marks."""
    lines = collections.Counter((line.split()[0], line.split(" --")[-1].split()[0]) for line in REFUSED)
    for name, command in COMMANDS.items():
        for option, (marks, _) in options_of(command).items():
            count = sum(isinstance(mark, Only) for mark in marks)
            assert lines[name, flag_of(option)[2:]] == count, (name, option)


MANY = [(name, o) for name in COMMANDS for o, (_, many) in options_of(COMMANDS[name]).items() if many]
ENOUGH = {
    **{"gap": "a.csv --out o", "identify": "a.csv --out o", "logs": "a.csv", "replay": "a.csv --out a.html"},
    **{"video": "landing --out a.mp4", "robustness": "landing --over thrust effects vehicles moving"},
    **{"success": "landing", "touchdown": "touchdown", "figure": "landing --out o"},
}


@pytest.mark.parametrize(("name", "option"), MANY)
def test_an_option_of_several_values_needs_one(name, option):
    """As where a shell variable is unset."""
    for end in ("", " --"):
        with pytest.raises(
            UserError, match=r"needs a value; is a shell variable unset|[Mm]issing|[Ee]xpected"
        ):
            parsed(f"{name} {ENOUGH.get(name, '')} {flag_of(option)}{end}")
