"""Command lines of `landing-eval` and `landing-train`: parsing, help, and errors in one sentence.

This module imports nothing slow: other packages and tyro are imported when a command is run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import functools
import gc
import inspect
import io
import itertools
import logging
import math
import os
import platform
import re
import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, get_args, get_origin

from inclined_landing.models.base import imports
from inclined_landing.models.base.errors import UserError, not_installed, shown

# New objects until Python looks for cycles among them. Imports make 300 000 that stay: at the usual 700 a
# fifth of the time of importing goes into looking through them over and over.
_YOUNG = 20_000
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)  # signals that end the work
_UNDISTURBED = 1.0  # s after one of them, in which others do not interrupt the removal of partial files
# Output that cannot be written: disk, quota, size of a file, device, and what was closed by the shell.
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


def parse(target: Callable, prog: str, arguments: Sequence[str] | None = None) -> Any:
    """Return the result of `target` for the words of a command line (default: those of this process).

    target: a dataclass, or a command, of which the `Call` is returned; its signature and docstring are
    options and help.
    Raises UserError for words that do not fit; --help is printed and raises SystemExit(0).
    """
    import tyro

    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments and arguments[0].replace("_", "-").startswith("--tyro-"):  # would write a file
        raise UserError(f"unknown option {shown(arguments[0])}; see {prog} --help")
    for k, word in enumerate(arguments):
        option, sign, value = word.partition("=") if word.startswith("--") else ("", "", word)
        if not value and (sign or not option):
            option = option or (
                arguments[k - 1] if k and arguments[k - 1].startswith("--") else "an argument"
            )
            raise UserError(f"{shown(option)} is empty; is a shell variable unset?")
        if value.isdigit() and not value.isascii():
            raise UserError(f"{shown(word)}: numbers are written with the digits 0 to 9")
    message, page = io.StringIO(), io.StringIO()
    words = _positionals_first(arguments, _choices(target))
    try:
        with contextlib.redirect_stderr(message), contextlib.redirect_stdout(page):
            made_by = target if isinstance(target, type) else bound(target)
            made = tyro.cli(made_by, prog=prog, args=words, config=_config())
    except SystemExit as end:
        if end.code:
            raise UserError(_sentence(message.getvalue(), prog)) from end
        print(_tidy(page.getvalue()))
        raise
    options = made.options if isinstance(made, Call) else dict(_options(vars(made), type(made)))
    check_given(options, given(arguments))
    return made


def _choices(target: Callable) -> dict[str, Container[str]]:
    """Return the choices of each option that takes several of a few words."""
    from inclined_landing.envs.shared.options import flag_of
    from inclined_landing.models.base import schema

    found: dict[str, Container[str]] = {}
    for name, kind in schema.kinds_of(target).items():
        of_each = get_args(kind)[0] if get_origin(kind) is tuple else None
        if get_origin(of_each) is Literal:
            found[flag_of(name)] = get_args(of_each)
    return found


def _positionals_first(arguments: Sequence[str], choices: Mapping[str, Container[str]]) -> list[str]:
    """Move positional arguments that follow an option's values, and are not among its `choices`, to the
    front.

    An option with several values would consume them all, as in `--over moving POLICY`. If a positional
    argument comes first, the order is left unchanged.
    """
    if not arguments or not arguments[0].startswith("-"):
        return list(arguments)
    front, others, known = list[str](), list[str](), None
    for before, word in zip(["", *arguments], arguments):
        if word.startswith("-"):
            known = choices.get(word)
        elif known is not None and before not in choices and word not in known:
            front.append(word)
            continue
        others.append(word)
    return front + others


class Option(NamedTuple):
    """The value of an option, and the marks of its annotation and of its group's."""

    value: Any
    marks: tuple


@dataclasses.dataclass(frozen=True)
class Call:
    """The call of a command with its options. It owns the run folder that it writes (see `runs.owned`)."""

    command: Callable[[], Any]
    options: Mapping[str, Option]

    def __call__(self) -> Any:
        from inclined_landing.envs.shared import runs
        from inclined_landing.envs.shared.options import RUN_FOLDER

        with contextlib.ExitStack() as owned:
            for folder, marks in self.options.values():
                if folder and RUN_FOLDER in marks:
                    owned.enter_context(runs.owned(folder))
            return self.command()


def check_given(options: Mapping[str, Option], flags: Container[str]) -> None:
    """Raise UserError if one of `flags`, from `given`, has no values or no effect."""
    from inclined_landing.envs.shared.options import Only, flag_of

    values = {name: option.value for name, option in options.items()}
    for name, option in options.items():
        if (flag := flag_of(name)) not in flags:
            continue
        if isinstance(option.value, tuple) and (not option.value or () in option.value):
            raise UserError(f"{flag} needs a value; is a shell variable unset?")
        for mark in option.marks:
            if isinstance(mark, Only) and not mark.holds(values):
                raise UserError(f"{flag} has no effect {mark.otherwise}")


def _options(values: Mapping[str, Any], target: Callable, outer: tuple = ()) -> Iterator[tuple[str, Option]]:
    """Yield the options in `values`, which `target` annotates, by name, including those in groups."""
    from inclined_landing.models.base import schema

    kinds = schema.kinds_of(target)
    for name, value in values.items():
        marks = (*outer, *getattr(kinds[name], "__metadata__", ()))
        if dataclasses.is_dataclass(value):
            yield from _options(vars(value), type(value), marks)
        else:
            yield name, Option(value, marks)


def given(arguments: Sequence[str]) -> set[str]:
    """Return the options on a command line, such as "--out"; for --no-film also --film."""
    words = itertools.takewhile(lambda word: word != "--", arguments)
    names = {word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")}
    return names | {name.replace("--no-", "--", 1) for name in names}


def _config() -> tuple:
    """Return tyro's settings: groups add no prefix to their options, and None cannot be typed."""
    import tyro

    return tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone


def help_page(target: Callable, prog: str) -> str:
    """Return the page of --help, as wide as the terminal (environment variable COLUMNS)."""
    import tyro

    page = io.StringIO()
    with contextlib.redirect_stdout(page), contextlib.suppress(SystemExit):
        tyro.cli(target, prog=prog, args=["--help"], config=_config())
    return _tidy(page.getvalue())


def _tidy(page: str) -> str:
    """Return a help page of tyro with its paragraphs wrapped, and without uninformative defaults."""
    page = re.sub(r"\s*(\(default:\s*(None|False|)\)|\(repeatable\))", "", page)
    page = re.sub(r"^ ([\w-]+) options *$", lambda m: f" {_heading(m[1])}", page, flags=re.MULTILINE)
    width = shutil.get_terminal_size().columns
    lines = [line.rstrip() for line in page.splitlines()]
    text = "\n".join(line if line.startswith(" ") else textwrap.fill(line, width) for line in lines)
    return re.sub(r"\n{3,}", "\n\n", _wrapped_helps(text, width)).strip()


def _heading(group: str) -> str:
    """Return the heading of a group of options, which tyro calls by the name of its argument."""
    known = {"flown": "flight conditions", "look": "rendering", "real": "hardware", "source": "flight logs"}
    known |= {"hand-overs": "hand-over", "reading": "flight logs"}
    return known.get(group, group.replace("-", " "))


def _wrapped_helps(page: str, width: int) -> str:
    """Return a page with each option's text as one paragraph; tyro keeps the docstring's line breaks."""
    column = next((line.index("show this") for line in page.splitlines() if "show this help" in line), width)
    rows: list[str] = []
    for line in page.splitlines():
        if rows and _text(rows[-1], column) and line.strip() and not line[:column].strip():
            rows[-1] += " " + line.strip()
        else:
            rows.append(line)
    for k, row in enumerate(rows):
        if text := _text(row, column):
            lines = textwrap.wrap(text, width - column, break_on_hyphens=False)
            rows[k] = row[:column] + ("\n" + " " * column).join(lines)
    return "\n".join(rows)


def _text(row: str, column: int) -> str:
    """Return the text of a row in the column of help texts; "" if it has none."""
    return row[column:] if row[column - 2 : column].isspace() else ""


def versions(prog: str) -> str:
    """Return the line of --version: this package and those that affect its results, without imports."""
    from inclined_landing.envs.shared.runs import packages

    found = {**packages(), "python": platform.python_version()}
    shown_as = {"mujoco": "MuJoCo", "torch": "PyTorch", "python": "Python"}
    others = ", ".join(f"{word} {found[name]}" for name, word in shown_as.items() if found[name])
    return f"{prog} {found['inclined-landing'] or 'not installed'} ({others})"


def bound(command: Callable) -> Callable:
    """Return a function with the signature and docstring of `command` that returns the call without making
    it.

    Values beyond the limits of an option's type are refused here, before any work.
    """

    @functools.wraps(command)
    def later(*arguments: Any, **options: Any) -> Call:
        from inclined_landing.envs.shared.options import flag_of
        from inclined_landing.models.base import schema

        given = inspect.signature(command).bind(*arguments, **options)
        try:
            schema.check(given.arguments, schema.kinds_of(command), flag_of)
        except UserError as error:  # called without the number of the wrong one of several values
            flag, must, rest = str(error).partition(" must be ")
            raise UserError(f"{flag.partition('[')[0]}{must}{rest}") from None
        given.apply_defaults()
        call = functools.partial(command, *arguments, **options)
        return Call(call, dict(_options(given.arguments, command)))

    return later


def exit_code(
    prog: str,
    work: Callable[[], int | None],
    extra: str = "eval",
    interrupted: Callable[[], str] = lambda: "interrupted",
) -> int:
    """Run a command and return its exit code; print one sentence if it fails.

    The code is 2 for wrong input, for a missing package that `extra` would install, for a diverged simulation
    and for lack of memory. If a signal such as Ctrl-C ends it, the sentence is that of `interrupted` and the
    code is 128 plus the signal's number. Failing to write to stderr does not change the code.
    """
    gc.set_threshold(_YOUNG)
    os.environ.update(MATPLOTLIBRC=os.devnull, MPLBACKEND="agg")  # no settings, no window
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # no words on its cache
    imports.around_import("numba.core.event", _announce_compilation)
    caught: list[int] = []
    code = 2
    with _streams():
        try:
            try:
                with _signals(caught):
                    return work() or 0
            finally:
                sys.stdout.flush()  # here it can be said if that fails
        except KeyboardInterrupt:
            sentence, code = interrupted(), 128 + (caught or [signal.SIGINT])[0]
        except ModuleNotFoundError as error:
            sentence = not_installed(error, extra)
        except (UserError, ImportError) as error:
            sentence = str(error)
        except FloatingPointError as error:
            sentence = f"{error}; the simulation cannot continue"
        except MemoryError:
            sentence = "not enough memory"
        except BrokenPipeError:  # whoever read the output has seen enough
            _drop_output()
            return 128 + signal.SIGPIPE
        except OSError as error:
            sentence = (error.strerror or str(error)).lower()
            if error.filename is not None:
                sentence = f"{sentence}: {shown(error.filename)}"
            elif error.errno in _UNWRITABLE:
                sentence = f"the output cannot be written: {sentence}"
                _drop_output()
        except Exception as error:
            from inclined_landing.envs.shared.user_code import blame

            sentence = blame(error) or ""
            if not sentence:
                raise
        print(f"{prog}: {UserError(sentence)}", file=sys.stderr)  # one line, of bounded length
        return code


def _announce_compilation(execute: imports.Execute, event: Any) -> None:
    """Import numba's events and report on a terminal when compilation takes more than a second."""
    execute(event)

    class Announcement(event.Listener):
        said, level, begun, spent = False, 0, 0.0, 0.0

        def on_start(self, event) -> None:
            now = time.perf_counter()
            self.begun = self.begun if self.level else now
            self.level += 1
            if self.spent + now - self.begun > 1.0 and not self.said and sys.stderr.isatty():
                self.said = True
                print("compiling for the first call, about a minute; later calls are quick", file=sys.stderr)

        def on_end(self, event) -> None:
            self.level -= 1
            self.spent += 0.0 if self.level else time.perf_counter() - self.begun

    event.register("numba:compile", Announcement())


@contextlib.contextmanager
def _signals(caught: list[int]) -> Iterator[None]:
    """Make other signals raise KeyboardInterrupt, as Ctrl-C does; they are recorded in `caught`."""
    undisturbed = -math.inf  # until this time [s]

    def stop(number, frame):
        nonlocal undisturbed
        caught.append(number)
        if time.monotonic() >= undisturbed:
            undisturbed = time.monotonic() + _UNDISTURBED
            raise KeyboardInterrupt

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in _ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup and background jobs ask for
                before[number] = signal.signal(number, stop)
    try:
        yield
    except BaseException as error:
        if caught:  # whatever the interruption became on its way through other libraries
            raise KeyboardInterrupt from error
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Lossy(io.FileIO):
    """A stream that drops what it cannot write, so that a full disk or a closed terminal is not an error."""

    def write(self, data) -> int:
        """Write as much as possible, and return the length of the whole text."""
        with contextlib.suppress(OSError):
            super().write(data)
        return len(data)


@contextlib.contextmanager
def _streams() -> Iterator[None]:
    """Make the standard streams of this process robust against closed files and invalid characters."""
    handle = os.open(os.devnull, os.O_RDONLY)
    while handle <= 2:  # closed by the shell; no file may get its number
        handle = os.open(os.devnull, os.O_RDONLY)
    os.close(handle)
    with contextlib.ExitStack() as changed:
        if sys.stdout is None:  # words there are an error, as on a full disk
            changed.enter_context(contextlib.redirect_stdout(open(1, "w", closefd=False)))
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="backslashreplace")  # file names that are no UTF-8
        if sys.stderr is sys.__stderr__:  # unless a test or a notebook has replaced it
            stream = io.BufferedWriter(_Lossy(2, "w", closefd=False))
            lossy = io.TextIOWrapper(stream, errors="backslashreplace", line_buffering=True)
            changed.enter_context(contextlib.redirect_stderr(lossy))
        yield


def _drop_output() -> None:
    """Discard output that cannot be written: Python would try again, and fail, at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _sentence(box: str, prog: str) -> str:
    """Return tyro's framed message as one sentence."""
    lines = [row.strip("│|").rstrip() for row in box.splitlines()[1:]]
    first = next((k for k, row in enumerate(lines) if row.strip().startswith("Missing from")), None)
    if first is not None:  # options follow up to a rule, each indented less than its help
        listed = list(itertools.takewhile(lambda row: row.strip("─- "), lines[first + 1 :]))
        indents = [len(row) - len(row.lstrip()) for row in listed]
        needed = [row.strip() for row, indent in zip(listed, indents) if indent == min(indents)]
        are = "is" if len(needed) == 1 else "are"
        return f"{' and '.join(needed)} {are} missing; see {prog} --help"
    rows = [row.strip() for row in lines]
    ruled = itertools.groupby(rows, lambda row: not row.strip("─-+╰╯"))
    parts = [" ".join(" ".join(part).split()).rstrip(".") for is_rule, part in ruled if not is_rule]
    ends = ("Got errors", "Argument helptext", "For full helptext")
    wrong = itertools.takewhile(lambda part: not part.startswith(ends), parts)
    return f"{shown('; '.join(wrong), 200)}; see {prog} --help"
