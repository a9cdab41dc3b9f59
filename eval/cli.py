"""`landing-eval`: the commands of the rooms.

A command and its module are called alike: `contact-truth` of the room `truth` is the function `command` in
`truth/contact_truth`, a module or a package with a module `command`. Its signature and docstring are the
options and the help. Only the room of the command that is run gets imported, so that `--help` is instant.
Wrong input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence

from inclined_landing.eval.base.command_line import bound, exit_code, parse, versions
from inclined_landing.eval.base.manual import manual
from inclined_landing.models.errors import UserError

# Command: where its room is, and the first line of its docstring.
COMMANDS = {
    "demo": (
        "",
        "The first thing to try: a landing policy flown, counted, filmed and pictured (half a minute).",
    ),
    "success": (
        "policies",
        "Success table of a policy: how often, how fast, how hard it reaches its goal.",
    ),
    "touchdown": ("policies", "Touchdown policy beside a landing policy whose motors are cut (minutes)."),
    "mission": (
        "",
        "Whole missions: from anywhere in the room to the slope, onto it, and to rest, counted and filmed.",
    ),
    "robustness": (
        "policies",
        "Landing policies over thrust and under every effect of the library: curve, matrix, page (minutes).",
    ),
    "vehicles": (
        "policies",
        "One landing policy on many quadrotors, named and drawn, beside one policy for each (a minute).",
    ),
    "slopes": (
        "policies",
        "Landing policies over all slopes that they know: curve over the angle, map of all directions.",
    ),
    "moving": (
        "",
        "Landings on moving decks: the frozen benchmark, for policies and controllers of your own (minutes).",
    ),
    "export": (
        "",
        "A policy as ONNX, as C for a microcontroller or for NumPy, with contract and test vectors.",
    ),
    "figure": ("pictures", "Stroboscopic trajectory with PWM and pitch over time, as PNG and PDF."),
    "video": ("pictures", "Video of flights, one after the other."),
    "picture": ("pictures", "One picture of a whole flight: copies of the vehicle along its way."),
    "curves": ("pictures", "Learning curves of training runs of one task; seeds with median and range."),
    "replay": ("", "Flights of policies and logs as one page for the browser, to be seen from all sides."),
    "view": ("replay", "Watch a policy fly in MuJoCo's viewer, in real time; needs a display."),
    "beyond": (
        "sweeps",
        "The results of sweeps on one page: question, answer, numbers with their bars, figure, video.",
    ),
    "equivalence": ("truth", "Is the MuJoCo vehicle the paper's model? One page of claims with tolerances."),
    "contact-truth": ("truth", "Can contact be believed? Rest, slip, drops, energy ... as page and figures."),
    "landings": ("", "Landing study: thousands of touchdowns over friction, speeds ..., each classified."),
    "logs": ("", "What flight logs hold and whether they can be believed, in words."),
    "flights": (
        "logs",
        "Measured flights of others: where to get each set; its own files converted to documented CSV.",
    ),
    "identify": ("gap", "Thrust, lags, delays, attitude loops and drag from flights: a vehicle file."),
    "gap": ("", "Where simulation and flights disagree, which effect is missing, the corrected model."),
    "plan": ("gap", "The safe flight that tells best which of the sets of effects of a report is right."),
    "effects": ("gap", "The physical effects that a model may lack: formula, size, what to do about them."),
    "gap-example": ("gap", "Twenty flights with hidden effects, of an independent simulator, to try gap."),
    "fly": (
        "flying",
        "Fly a Crazyflie, or a simulated one: to the start, and onto the slope; logged as CSV.",
    ),
    "crazyflie": ("flying", "A simulated Crazyflie in real time, for cflib over UDP."),
    "benchmark": ("machine", "What a step, an action, a picture and a training cost here (a few minutes)."),
    "doctor": ("machine", "What is installed, what is missing, and what to do about it."),
}
OLD_NAMES = {"contact": "landings"}
# Evidence of the authors that is run from a clone, beside the tests.
MOVED = ("gap-blind", "gap-agreement", "gap-real", "nanobench", "plan-proof", "flight-table")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return exit_code("landing-eval", lambda: _run(words))
    except KeyboardInterrupt:
        print("landing-eval: interrupted", file=sys.stderr)
        return 130


def find(name: str) -> Callable:
    """The function of a command; imports its room."""
    room, _ = COMMANDS[name]
    path = ".".join(filter(None, ("inclined_landing.eval", room, name.replace("-", "_"))))
    if importlib.util.find_spec(path).submodule_search_locations is not None:
        path += ".command"
    return importlib.import_module(path).command


def _run(words: list[str]) -> int | None:
    name, *rest = words or [""]
    if name in ("-h", "--help"):
        print(_help())
        return 0
    if name == "--version":
        print(versions("landing-eval"))
        return 0
    if name.partition("=")[0] == "--print-completion":
        return _print_completion(words)
    name = OLD_NAMES.get(name, name)
    if name in MOVED:
        raise UserError(f"{name} is now run from a clone of the repository: python -m tests.proof {name}")
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        wrong = f"unknown command {name!r}" if name else "no command"
        raise UserError(f"{wrong}{', perhaps ' + near[0] if near else ''}; landing-eval --help lists them")
    return parse(bound(find(name)), f"landing-eval {name}", rest)()


def _print_completion(words: list[str]) -> int:
    from inclined_landing.eval.base.completion import script, shell_of

    pages = {name: manual(bound(find(name)), f"landing-eval {name}") for name in COMMANDS}
    lines = {name: line for name, (_, line) in COMMANDS.items()}
    print(script(shell_of(words), "landing-eval", pages, lines), end="")
    return 0


def _help() -> str:
    rows = (f"  {name:{max(map(len, COMMANDS))}}  {line}" for name, (_, line) in COMMANDS.items())
    return "\n".join(
        [
            "usage: landing-eval COMMAND [OPTIONS]",
            "\nEvaluate policies and models: success, pictures, contact, measured flights.\n",
            *rows,
            "\nlanding-eval COMMAND --help tells the options; contact is the old name of landings.",
            "--version says what is installed; --print-completion bash, zsh or fish completes commands.",
        ]
    )
