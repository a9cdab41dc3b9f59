"""`landing-eval`: the commands of the packages, in groups.

A command and its module are called alike: `figure` of the package `pictures` is the function `command` in
`pictures/figure`, a module or a package with a module `command`. Its signature and docstring are the options
and the help. Only the package of the command that is run gets imported, so that `--help` is instant.
Wrong input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence

from inclined_landing.envs.shared.command_line import bound, completion, exit_code, parse, shell_of, versions
from inclined_landing.models.errors import UserError

# Command: the package it is in, and the first line of its docstring.
COMMANDS = {
    "demo": (
        "",
        "The first thing to try: a landing policy flown, counted, filmed and pictured (half a minute).",
    ),
    "success": (
        "policies",
        "Success table of policies, side by side: how often, how fast, how hard they reach their goals.",
    ),
    "touchdown": ("policies", "Touchdown policy beside a landing policy whose motors are cut (minutes)."),
    "robustness": (
        "policies",
        "Policies under other thrusts, effects, slopes, vehicles or moving platforms: tables, figures, page.",
    ),
    "mission": (
        "policies",
        "Whole missions: from anywhere in the room to the slope, onto it, and to rest, counted and filmed.",
    ),
    "export": (
        "",
        "A policy as ONNX, as C for a microcontroller or for NumPy, with contract and test vectors.",
    ),
    "figure": ("pictures", "Stroboscopic trajectory with PWM and pitch over time, as PNG and PDF."),
    "picture": ("pictures", "One picture of a whole flight, with copies of the vehicle along its way."),
    "video": ("pictures", "Video of flights, one after the other."),
    "replay": ("", "Flights of policies and logs in 3D, as one page for the browser."),
    "view": ("replay", "Flights of a policy in MuJoCo's viewer, in real time; needs a display."),
    "curves": ("pictures", "Learning curves of training runs of one task; seeds with median and range."),
    "equivalence": (
        "truth",
        "Is the vehicle the paper's model? MuJoCo against the paper's equations: a page of claims.",
    ),
    "contact": (
        "truth",
        "Can contact be believed? Rest, slip, drops, energy and more against mechanics: a page of claims.",
    ),
    "landings": ("", "Landing study: thousands of touchdowns over friction, speeds ..., each classified."),
    "logs": ("", "What flight logs hold and whether they can be believed, in words."),
    "flights": (
        "logs",
        "Measured flights of others: where each set is, its licence, and its files as documented CSV.",
    ),
    "identify": ("gap", "Identify thrust, lags, delays, attitude loops and drag: a vehicle file."),
    "gap": ("", "Name the effects that the model lacks, from flights, and write the corrected model."),
    "plan": ("gap", "Plan a safe flight that best separates the candidate explanations of a report."),
    "effects": ("gap", "List the physical effects that a model may lack: formula, size, remedy."),
    "gap-example": (
        "gap",
        "Write twenty flights with hidden effects, to try gap on.",
    ),
    "fly": (
        "flying",
        "Fly a Crazyflie, or a simulated one: to the start and onto the slope, or as planned; logged as CSV.",
    ),
    "crazyflie": ("flying", "A simulated Crazyflie in real time, for cflib over UDP."),
    "benchmark": ("machine", "What a step, an action and a training cost here (about a minute)."),
    "doctor": ("machine", "What is installed, what is missing, and what to do about it."),
}
GROUPS = {
    "Start": ("demo", "doctor", "benchmark"),
    "Policies": ("success", "robustness", "touchdown", "mission", "export"),
    "Pictures": ("figure", "picture", "video", "replay", "view", "curves"),
    "Physics": ("equivalence", "contact", "landings", "effects"),
    "Flight logs and the gap to the model": ("logs", "flights", "identify", "gap", "plan", "gap-example"),
    "A real vehicle": ("fly", "crazyflie"),
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
    if name.partition("=")[0] == "--print-completion":
        print(completion(shell_of(words), "landing-eval", {name: find(name) for name in COMMANDS}), end="")
        return 0
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        wrong = f"unknown command {name!r}" if name else "no command"
        raise UserError(f"{wrong}{', perhaps ' + near[0] if near else ''}; landing-eval --help lists them")
    return parse(bound(find(name)), f"landing-eval {name}", words[1:])()


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = ["usage: landing-eval COMMAND [OPTIONS]", ""]
    lines.append("Evaluate policies and models: success, pictures, contact, measured flights.")
    for title, names in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:{width}}  {COMMANDS[name][1]}" for name in names)]
    return "\n".join(
        [
            *lines,
            "",
            "landing-eval COMMAND --help lists the options. --version says what is installed;",
            "--print-completion bash, zsh or fish prints a completion script.",
        ]
    )
