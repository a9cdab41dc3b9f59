"""Pages that are made from the program itself: options, constants, tasks, effects."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterable, Iterator
from importlib import resources

import numpy as np

from inclined_landing.envs.history import input_names
from inclined_landing.envs.shared.command_line import help_page
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks import TASKS, Task, make_task
from inclined_landing.envs.tasks import manual as task_manual
from inclined_landing.envs.tasks.base import ACTIONS, COLUMNS
from inclined_landing.envs.tasks.training import DEFAULTS, Training
from inclined_landing.envs.tasks.training import __doc__ as manual
from inclined_landing.eval import cli
from inclined_landing.models.attitude import COMMAND_UNITS, STATE_UNITS
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import Constant, constants, load_vehicle
from inclined_landing.train.config import TrainConfig, flag_of
from inclined_landing.train.sweep.command import command as sweep


def pages() -> dict[str, str]:
    """Markdown by page of the site."""
    return {
        "reference/commands.md": commands(),
        "reference/tasks.md": tasks(),
        "reference/constants.md": provenance(),
        "reference/effects.md": effects(),
    }


# --- commands ------------------------------------------------------------------------------------


def commands() -> str:
    """Every command with its options, from the commands' own help."""
    parts = [
        "# Commands\n",
        "`landing-train` trains a policy, `landing-eval COMMAND` does everything else. This page is "
        "generated from `--help`. Wrong input is reported in one sentence on standard error, with exit code "
        "2; output folders are written atomically.\n",
        table(
            ["command", "purpose"],
            [
                [
                    "[`landing-train`](#landing-train)",
                    "Train a policy and write everything into one run folder.",
                ],
                [
                    "[`landing-train sweep`](#landing-train-sweep)",
                    "Run the command lines of a recipe for every seed.",
                ],
                *([f"[`landing-eval {name}`](#{name})", cli.summary(name)] for name in cli.COMMANDS),
            ],
        ),
        _section("landing-train", help_page(TrainConfig, "landing-train")),
        _section("landing-train sweep", help_page(sweep, "landing-train sweep")),
    ]
    for name in cli.COMMANDS:
        parts.append(_section(name, help_page(cli.find(name), f"landing-eval {name}")))
    return "\n".join(parts)


def _section(title: str, page: str) -> str:
    return f"## {title}\n\n```text\n{page}\n```\n"


# --- tasks ---------------------------------------------------------------------------------------


def tasks() -> str:
    """The tasks with their spaces."""
    parts = [
        "# Tasks\n",
        "Observations, actions and training defaults of every task for the shipped vehicle, generated from "
        "the environments. `import inclined_landing` registers the Gymnasium ids.\n",
    ]
    for name, kind in TASKS.items():
        task = make_task(name)
        parts += [
            f"## {kind.__name__}\n",
            f'`make_task({name!r})`, `gymnasium.make("{kind.__name__}-v0")`\n',
            _observations(task),
            _actions(task),
            f"Control period {task.vehicle.command_control_period:g} s, at most {task.max_steps} steps.\n",
            '??? note "Manual of the task: goal, reward, end"\n',
            "\n".join(f"    {line}" if line else "" for line in task_manual(kind).splitlines()) + "\n",
        ]
    return "\n".join([*parts, _training()])


def _training() -> str:
    """The training defaults: a row for each option, a column for each case."""
    rows = [
        [f"`{flag_of(field.name)}`", *(str(getattr(case, field.name)) for case in DEFAULTS.values())]
        for field in dataclasses.fields(TrainConfig)
        if hasattr(Training, field.name)
    ]
    return f"## Training defaults\n\n```text\n{manual}```\n\n{table(['', *DEFAULTS], rows)}"


def _observations(task: Task) -> str:
    space = observation_space(task)
    rows = []
    for index, name in enumerate(input_names(task)):
        low, high = space.low[index], space.high[index]
        arena = getattr(task.vehicle, f"arena_{name}", None)
        inside = f"{arena[0]:g} to {arena[1]:g}" if arena else ""
        unbounded = np.isinf(low) and np.isinf(high)
        rows.append(
            [
                str(index),
                name,
                STATE_UNITS[COLUMNS[name]] if name in COLUMNS else "1",
                "unbounded" if unbounded else f"{low:g} to {high:g}",
                inside,
                f"{task.observation_centre[index]:g}",
                f"{task.observation_scale[index]:g}",
            ]
        )
    heads = ["index", "quantity", "unit", "space", "inside the arena", "centre", "scale"]
    said = f"Observation, {space.dtype}, shape {space.shape}; networks see (observation - centre) / scale:"
    return f"{said}\n\n{table(heads, rows)}"


def _actions(task: Task) -> str:
    space = action_space(task)
    low, middle, high = (task.commands(np.full((1, len(task.action_names)), a))[0] for a in (-1.0, 0.0, 1.0))
    rows = []
    for index, name in enumerate(task.action_names):
        column = ACTIONS[name]
        unit = COMMAND_UNITS[column]
        at = [f"{commands[column]:.6g} {unit}" for commands in (low, middle, high)]
        rows.append([str(index), name, f"{space.low[index]:g} to {space.high[index]:g}", *at])
    heads = ["index", "command", "space", "at the lowest", "at 0", "at the highest"]
    return f"Action, {space.dtype}, shape {space.shape}; other commands are zero:\n\n" + table(heads, rows)


# --- physics -------------------------------------------------------------------------------------


def sources() -> list[list[str]]:
    """Marks of sources and what they stand for, as the head of the vehicle file has them."""
    text = (resources.files("inclined_landing.models") / "crazyflie.toml").read_text("utf-8")
    return [list(pair) for pair in re.findall(r"^#   (\[\w\])  (.*)$", text, re.MULTILINE)]


def provenance() -> str:
    """Every physical constant, by table of the vehicle file."""
    parts = [
        "# Constants\n",
        "Every entry of the shipped vehicle file, `models/crazyflie.toml`, which equations, scene, plugins "
        "and tests read. A vehicle file is checked against its units and ranges "
        "([how](../guides/vehicle.md)). The uncertainty is the half-width of the 95 % interval where one is "
        "published or estimated.\n",
        table(["mark", "source"], sources()),
    ]
    for section, entries in itertools.groupby(constants(), lambda constant: constant.section):
        rows = [_constant(constant) for constant in entries]
        heads = ["entry", "value", "unit", "uncertainty", "source", "range"]
        parts += [f"## `[{section}]`\n", table(heads, rows)]
    vehicle = load_vehicle()
    derived = [
        ["PWM at hover, transfer function", f"{vehicle.hover_pwm:.0f}", "PWM"],
        ["PWM at hover, static map", f"{vehicle.static_hover_pwm:.0f}", "PWM"],
        ["steady thrust per PWM", f"{vehicle.thrust_per_pwm:.4g}", "N/PWM"],
        ["weight", f"{vehicle.body_mass * vehicle.environment_gravity:.4g}", "N"],
        ["half length of the slab along the slope", f"{vehicle.slab_half_length:.4g}", "m"],
    ]
    parts += ["## Derived quantities\n", table(["quantity", "value", "unit"], derived)]
    return "\n".join(parts)


def _constant(constant: Constant) -> list[str]:
    spread = dict.fromkeys(constant.range)  # one for all numbers, or one for each
    return [
        f"`{constant.name}`",
        numbers(constant.value),
        constant.unit,
        constant.uncertainty if isinstance(constant.uncertainty, str) else numbers(constant.uncertainty),
        constant.source,
        ", ".join(f"{low:g} to {high:g}" for low, high in spread),
    ]


def numbers(value) -> str:
    """A number or several."""
    return ", ".join(f"{number:.8g}" for number in (value if isinstance(value, Iterable) else (value,)))


def effects() -> str:
    """The library of effects."""
    parts = [
        "# The library of effects\n",
        f"{len(LIBRARY)} physical effects that the paper's equations leave out, each in the equations and in "
        "MuJoCo. All are neutral in the shipped vehicle file. `landing-eval gap` names them from flights, "
        "`landing-train --randomise` draws them, `landing-eval robustness --over effects` flies a policy "
        "under each.\n",
        table(
            ["effect", "formula", "a plausible size", "shows in"],
            (
                [
                    f"[{e.name}](#{e.name})",
                    f"`{e.formula}`",
                    ", ".join(_size(p) for p in e.parameters),
                    ", ".join(e.regimes),
                ]
                for e in LIBRARY.values()
            ),
        ),
    ]
    return "\n".join([*parts, *map(_effect, LIBRARY.values())])


def _size(parameter) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.name} {parameter.plausible:g}{unit}"


def _effect(effect: Effect) -> str:
    heads = ["parameter", "unit", "neutral", "plausible", "lowest", "highest", "negligible within"]
    rows = (
        [f"`{p.name}`", p.unit, *(f"{n:g}" for n in (p.neutral, p.plausible, *p.bounds, p.negligible))]
        for p in effect.parameters
    )
    facts = {
        "Source": effect.source,
        "Shows in": ", ".join(effect.regimes),
        "Confused with": ", ".join(
            f"[{name}](#{name})" if name in LIBRARY else name for name in effect.confused_with
        ),
        "Measured without a flight": effect.told_by,
        "Remedy": effect.remedy,
        "Needs in the log": ", ".join(effect.requires),
    }
    said = [f"- {title}: {text}" for title, text in facts.items() if text]
    return "\n".join(
        [
            f"## {effect.name}\n",
            effect.description + "\n",
            f"```text\n{effect.formula}\n```\n",
            table(heads, rows),
            *said,
            "",
        ]
    )


# --- Markdown ------------------------------------------------------------------------------------


def table(heads: list[str], rows: Iterable[list[str]]) -> str:
    """A table."""
    lines: Iterator[list[str]] = itertools.chain([heads, ["---"] * len(heads)], rows)
    return "\n".join("| " + " | ".join(cell(text) for text in line) + " |" for line in lines) + "\n"


def cell(text: str) -> str:
    """A text that may stand in a table, with angle brackets escaped outside of code."""
    parts = re.split(
        r"(`[^`]*`|\[[^]]*\]\([^)]*\))", text.replace("\n", " ")
    )  # code and links stay as they are
    return "".join(
        re.sub(r"([<>*_|])", r"\\\1", part) if k % 2 == 0 else part for k, part in enumerate(parts)
    )
