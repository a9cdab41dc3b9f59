"""`landing-eval`: the commands of the packages, in groups.

A command and its module have the same name: `figure` of the package `pictures` is the function `command` in
`pictures/figure`, a module or a package with a module `command`. Its signature and docstring are the options
and the help. Slow imports are in its body, so that `--help` and wrong options are handled at once. Wrong
input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence

from inclined_landing.envs.shared.command_line import bound, exit_code, parse, versions
from inclined_landing.models.base.errors import UserError

# Command: the package it is in, and the first line of its docstring.
COMMANDS = {
    "demo": (
        "",
        "Fly the shipped landing policy: success table, video, picture and 3D page (half a minute).",
    ),
    "success": (
        "study",
        "Compare policies: how often, how fast and how hard they reach their goals.",
    ),
    "touchdown": (
        "study",
        "Compare a touchdown policy with a landing policy whose motors are cut (minutes).",
    ),
    "robustness": (
        "study",
        "Test policies at other thrusts, under effects, on slopes, vehicles or moving platforms.",
    ),
    "mission": (
        "study",
        "Fly whole missions, from anywhere in the room to rest on the slope; count and film them.",
    ),
    "export": (
        "",
        "Export a policy as ONNX or as C for a microcontroller, with contract and test vectors.",
    ),
    "figure": ("pictures", "Draw a stroboscopic trajectory with PWM and pitch over time, as PNG and PDF."),
    "picture": (
        "pictures",
        "Render one picture of a whole flight, with copies of the vehicle along its path.",
    ),
    "video": ("pictures", "Render a video of flights, one after the other."),
    "replay": ("", "Show flights of policies and logs in 3D, on one page for the browser."),
    "curves": (
        "pictures",
        "Plot the learning curves of training runs of one task; seeds as median and range.",
    ),
    "equivalence": (
        "truth",
        "Check the vehicle in MuJoCo against the paper's equations; writes a page of claims.",
    ),
    "contact": (
        "truth",
        "Check contact against mechanics: rest, slip, drops, energy ...; writes a page of claims.",
    ),
    "landings": (
        "",
        "Run a landing study: simulate and classify thousands of touchdowns over friction, speeds ...",
    ),
    "logs": ("", "Report what flight logs contain and whether they are plausible."),
    "identify": ("gap", "Identify thrust, lags, delays, attitude loops and drag, and write a vehicle file."),
    "gap": ("", "Name the effects that the model lacks, from flights, and write the corrected model."),
    "plan": ("gap", "Plan a safe flight that best separates the candidate explanations of a report."),
    "gap-example": (
        "gap",
        "Write twenty example flights with hidden effects, as input for gap.",
    ),
    "fly": (
        "flying",
        "Fly a real or simulated Crazyflie onto the slope, or along a plan; logs as CSV.",
    ),
    "benchmark": (
        "machine",
        "Measure the speed of steps, actions, training and first use on this machine (one to two minutes).",
    ),
    "doctor": ("machine", "Check the installation and suggest remedies."),
}
GROUPS = {
    "Start": ("demo", "doctor", "benchmark"),
    "Policies": ("success", "robustness", "touchdown", "mission", "export"),
    "Pictures": ("figure", "picture", "video", "replay", "curves"),
    "Physics": ("equivalence", "contact", "landings"),
    "Flight logs and the gap to the model": ("logs", "identify", "gap", "plan", "gap-example"),
    "A real vehicle": ("fly",),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    return exit_code("landing-eval", lambda: _run(words))


def find(name: str) -> Callable:
    """Return the function of a command; imports its package."""
    package, _ = COMMANDS[name]
    path = ".".join(filter(None, ("inclined_landing.eval", package, name.replace("-", "_"))))
    spec = importlib.util.find_spec(path)
    if spec is not None and spec.submodule_search_locations is not None:
        path += ".command"
    return importlib.import_module(path).command


def _run(words: list[str]) -> int | None:
    name = words[0] if words else ""
    if name in ("-h", "--help"):
        print(_help())
        return 0
    if name == "--version":
        print(versions("landing-eval"))
        return 0
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        wrong = f"unknown command {name!r}" if name else "no command"
        meant = f"; did you mean {near[0]}? See" if near else "; see"
        raise UserError(f"{wrong}{meant} landing-eval --help")
    return parse(bound(find(name)), f"landing-eval {name}", words[1:])()


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = ["usage: landing-eval COMMAND [OPTIONS]", ""]
    lines.append("Evaluate policies and models.")
    for title, names in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:{width}}  {COMMANDS[name][1]}" for name in names)]
    return "\n".join(
        [
            *lines,
            "",
            "landing-eval COMMAND --help lists the options. --version prints the versions.",
        ]
    )
