"""What `landing-eval` and `landing-train` share: words become arguments, whatever is wrong one sentence.

Imports nothing heavy: the rooms and tyro are imported when a command is run.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import inspect
import io
import itertools
import os
import platform
import re
import shutil
import signal
import sys
import typing
from collections.abc import Callable, Sequence
from typing import Any

from inclined_landing.eval.base.manual import manual
from inclined_landing.models.errors import UserError, not_installed, shown


def parse(target: Callable, prog: str, arguments: Sequence[str] | None = None) -> Any:
    """What `target` makes of the words of a command line (default: those of this process).

    target: a dataclass, or a function from `bound`; its signature and docstring are options and help.
    Raises UserError for words that do not fit; --help is printed and raises SystemExit(0).
    """
    import tyro

    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0].replace("_", "-").startswith("--tyro-"):  # would write a file
        raise UserError(f"{shown(words[0])} is no option; {prog} --help says what is right")
    for k, word in enumerate(words):
        option, sign, value = word.partition("=") if word.startswith("--") else ("", "", word)
        if not value and (sign or not option):
            option = option or (words[k - 1] if k and words[k - 1].startswith("--") else "a word")
            raise UserError(f"{shown(option)} is empty; was a variable of the shell not set?")
        if value.isdigit() and not value.isascii():
            raise UserError(f"{shown(word)}: numbers are written with the digits 0 to 9")
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            return tyro.cli(target, prog=prog, args=words)
    except SystemExit as end:
        if end.code:
            raise UserError(_sentence(said.getvalue(), words, prog)) from end
        print(manual(target, prog).page(shutil.get_terminal_size().columns))
        raise


def versions(prog: str) -> str:
    """The line of --version: this package and what decides its results; imports none of them."""
    from inclined_landing.eval.base.runs import packages

    found = {**packages(), "python": platform.python_version()}
    shown_as = {"mujoco": "MuJoCo", "torch": "PyTorch", "python": "Python"}
    others = ", ".join(f"{word} {found[name]}" for name, word in shown_as.items() if found[name])
    return f"{prog} {found['inclined-landing'] or 'not installed'} ({others})"


def bound(command: Callable) -> Callable:
    """`command` with the same signature and docstring, which returns the call instead of making it.

    Numbers beyond the `Range` of their option are refused here, before any work.
    """

    @functools.wraps(command)
    def later(*arguments, **options):
        from inclined_landing.eval.base.options import check_ranges

        given = inspect.signature(command).bind(*arguments, **options).arguments
        check_ranges(given, typing.get_type_hints(command, include_extras=True))
        return functools.partial(command, *arguments, **options)

    return later


def exit_code(prog: str, work: Callable[[], int | None], extra: str = "eval") -> int:
    """Do the work of a command line. Returns what it returns, or says in one sentence why it cannot go on:
    2 for wrong input, for what `extra` would install, and where the engine or the memory gives out."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names that are no UTF-8
    try:
        try:
            return work() or 0
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # here it can be said if that fails
    except ModuleNotFoundError as error:
        sentence = not_installed(error, extra)
    except (UserError, ImportError) as error:
        sentence = str(error)
    except FloatingPointError as error:
        sentence = f"{error}; no simulation can go on from there"
    except MemoryError:
        sentence = "there is not enough memory for this"
    except BrokenPipeError:  # whoever read the output has seen enough
        _drop_output()
        return 128 + signal.SIGPIPE
    except OSError as error:
        sentence = (error.strerror or str(error)).lower()
        if error.filename is not None:
            sentence = f"{sentence}: {shown(error.filename)}"
        elif error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            sentence = f"the output cannot be written: {sentence}"
            _drop_output()
    print(f"{prog}: {sentence}", file=sys.stderr)
    return 2


def _drop_output() -> None:
    """Let go of what was printed and cannot be written: Python would try again, and fail, at its end."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _sentence(box: str, words: Sequence[str], prog: str) -> str:
    """What is in tyro's box as one sentence: without colours, title, frame and closing line."""
    rows = [row.strip(" │") for row in re.sub("\x1b\\[[0-9;]*m", "", box).splitlines()[1:]]
    ruled = itertools.groupby(rows, lambda row: not row.strip("─-╭╮╰╯"))
    parts = [" ".join(" ".join(part).split()).rstrip(".") for rule, part in ruled if not rule]
    wrong = [part.removeprefix("Argument helptext: ") for part in parts if not part.startswith("For full")]
    option = re.match("Error parsing (--[a-z0-9-]+): ", wrong[0] if wrong else "")
    if option is not None:  # of the types of options, numbers alone can be of another
        said = " ".join(wrong)
        whole = re.search(r"\bint\(\)|integer string", said) is not None
        one = "a whole number" if whole else "a number" if "to float" in said else "numbers"
        given = _not_a_number(option[1], words, int if whole else float)
        wrong = [f"{option[1]} takes {one}, not {shown(repr(given), 40)}"]
    return "; ".join([shown("; ".join(wrong), 200), f"{prog} --help says what is right"])


def _not_a_number(option: str, words: Sequence[str], kind: type) -> str:
    """The first value of an option that is no int or no float."""
    given: list[str] = []
    for k, word in enumerate(words):
        name, sign, value = word.partition("=")
        if name.replace("_", "-") == option:
            rest = itertools.takewhile(lambda other: not other.startswith("--"), words[k + 1 :])
            given += [value] if sign else rest
    for value in given:
        try:
            kind(value)
        except ValueError:
            return value
    return " ".join(given)
