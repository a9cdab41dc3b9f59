"""A command's options, as tyro makes them of signature and docstring, for its help and its completion."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
import textwrap
from collections.abc import Callable, Sequence

_UNFOLDED = "10000"  # columns: tyro wraps nothing
_INDENT, _COLUMN = 2, 26  # of words and of their text on the page, characters
_WIDEST = 100
_SAYS_NOTHING = re.compile(r" ?\((default: (None|False|''|)|repeatable)\)$")


@dataclasses.dataclass(frozen=True)
class Option:
    """An option, or an argument without a name."""

    words: str  # "--out DIR", "-h, --help", "POLICY"
    text: str  # what it does, its default included

    @property
    def names(self) -> tuple[str, ...]:
        """`--out`; none for an argument without a name."""
        return tuple(re.findall(r"(?:^|, )(--?[a-z0-9-]+)", self.words))

    @property
    def value(self) -> str:
        """`DIR`, or what stands for an argument without a name; "" for a flag."""
        return re.sub(r"(^|, )--?[a-z0-9-]+", "", self.words).strip()

    @property
    def choices(self) -> tuple[str, ...]:
        """The values it takes, where they are listed."""
        listed = re.search(r"\{(.+?)\}", self.value)
        return tuple(listed[1].split(",")) if listed else ()


@dataclasses.dataclass(frozen=True)
class Manual:
    """What `--help` says."""

    usage: str
    text: tuple[str, ...]  # paragraphs; the first is the command in one line
    arguments: tuple[Option, ...]  # without a name
    options: tuple[Option, ...]

    def page(self, width: int) -> str:
        """The help for a terminal of `width` columns."""
        width = max(40, min(width, _WIDEST))
        parts = [_wrapped(self.usage, width, "  ")]
        parts += [_wrapped(paragraph, width) for paragraph in self.text]
        for title, rows in (("arguments", self.arguments), ("options", self.options)):
            if rows:
                parts.append("\n".join([f"{title}:", *(_row(row, width) for row in rows)]))
        return "\n\n".join(parts)


def manual(target: Callable, prog: str) -> Manual:
    """The manual of a dataclass, or of a function from `command_line.bound`."""
    import tyro

    printed, before = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = _UNFOLDED
    try:
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            tyro.cli(target, prog=prog, args=["--help"])
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    return _read(re.sub("\x1b\\[[0-9;]*m", "", printed.getvalue()))


def _read(page: str) -> Manual:
    """A page of tyro's: usage and paragraphs, then sections whose rows have words and, indented, text."""
    head, *sections = re.split(r"^[ ╭]─? ?(?=(?:positional arguments|options)\b)", page, flags=re.MULTILINE)
    usage, *paragraphs = (" ".join(part.split()) for part in head.split("\n\n") if part.strip())
    found = {section.split()[0]: _options(section.splitlines()[1:]) for section in sections}
    arguments = (
        Option(row.words, row.text.removesuffix(" (required)")) for row in found.get("positional", ())
    )
    return Manual(usage, tuple(paragraphs), tuple(arguments), found.get("options", ()))


def _options(lines: Sequence[str]) -> tuple[Option, ...]:
    rows: list[list[str]] = []
    for line in lines:
        line = line.strip("│").rstrip()
        row = re.fullmatch(r" {1,2}(\S.*?)(?: {2,}(\S.*))?", line)
        if row and line.strip(" ─-╰╯"):
            rows.append([row[1], row[2] or ""])
        elif rows and line.startswith("   "):
            rows[-1][1] = f"{rows[-1][1]} {line.strip()}".strip()
    return tuple(Option(words.replace("{None}|", ""), _said(text)) for words, text in rows)


def _said(text: str) -> str:
    """The help without what says nothing, and with one default where the text has its own."""
    while _SAYS_NOTHING.search(text):
        text = _SAYS_NOTHING.sub("", text)
    if text.lower().count("default: ") > 1:
        text = re.sub(r" \(default: [^()]*\)$", "", text)
    return text


def _wrapped(text: str, width: int, hanging: str = "") -> str:
    return textwrap.fill(
        text, width, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False
    )


def _row(row: Option, width: int) -> str:
    lines = textwrap.wrap(row.text, width - _COLUMN, break_long_words=False, break_on_hyphens=False)
    words = " " * _INDENT + row.words
    first = [f"{words:{_COLUMN}}{lines.pop(0)}"] if lines and len(words) < _COLUMN - 1 else [words]
    return "\n".join([*first, *(" " * _COLUMN + line for line in lines)])
