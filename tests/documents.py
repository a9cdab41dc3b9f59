"""The documents of the repository and the code blocks in them."""

from __future__ import annotations

import functools
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from sybil import Document
from sybil.parsers.markdown.lexers import RawFencedCodeBlockLexer

from inclined_landing.envs.shared.command_line import help_page, parse
from inclined_landing.eval import cli
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.sweep.command import command as sweep
from tests import ROOT
from tests.validation import __main__ as validation

sys.path.insert(0, str(ROOT / "docs" / "site"))
import generated  # noqa: F401  (the pages that the site makes)

SHELLS = ("sh", "console", "bash")
PROGRAMS = ("landing-eval", "landing-train")
VALIDATION = ["python", "-m", "tests.validation"]
BLOCK = RawFencedCodeBlockLexer(re.compile(r'(?P<language>[a-z]+)(?: title="(?P<title>[^"]+)")?[ \t]*\n'))
SPAN = re.compile(r"`((?:landing-eval|landing-train|python -m tests\.validation) [^`]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")
FENCE = re.compile(r"^( *)(`{3,}|~{3,}).*?^\1\2 *$", re.DOTALL | re.MULTILINE)
_OPERATORS = ("&", "&&", "||", ";", "|")


def documents() -> list[str]:
    """Every Markdown file that people read, as a path in the repository."""
    files = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    folders = ("models", "envs", "eval", "train", "examples")
    files += [file for folder in folders for file in ROOT.glob(f"{folder}/**/*.md")]
    return sorted(file.relative_to(ROOT).as_posix() for file in files)


def prose(name: str) -> str:
    """A document without its code blocks."""
    return FENCE.sub("", (ROOT / name).read_text("utf-8"))


def links(name: str) -> Iterator[tuple[Path, str]]:
    """The links of a document into the repository: the file or folder, and the anchor in it."""
    for found in LINK.finditer(re.sub(r"`[^`\n]*`", "", prose(name))):
        path, _, anchor = (found[1] or found[2]).partition("#")
        if not re.match(r"[a-z][a-z0-9+.-]*:", path):
            yield ((ROOT / name).parent / path if path else ROOT / name), anchor


def anchors(name: str) -> set[str]:
    """The anchors that are the same on a code host and on the site: those of plain, unrepeated headings."""
    titles = re.findall(r"^#+ (.*?) *$", prose(name).replace("`", ""), re.MULTILINE)
    titles = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", title) for title in titles]  # a link's text
    plain = [re.sub(r"[^\w\s-]", "", title).lower() for title in titles]
    host, site = [re.sub(r"\s", "-", title) for title in plain], [re.sub(r"[-\s]+", "-", t) for t in plain]
    return {one for one, other in zip(host, site, strict=True) if one == other and host.count(one) == 1}


def blocks(name: str, *languages: str) -> list[tuple[str, str | None, str]]:
    """Language, title and text of the fenced blocks of a document; only those in `languages`, if any."""
    document = Document((ROOT / name).read_text("utf-8"), name)
    found = [tuple(map(region.lexemes.get, ("language", "title", "source"))) for region in BLOCK(document)]
    return [block for block in found if not languages or block[0] in languages]


def run_python(title: str | None, text: str, namespace: dict, place: str) -> None:
    """Run a block in the namespace of its document; one with a title is saved as that file first."""
    if title:
        Path(title).write_text(text, "utf-8")
    namespace.setdefault("__name__", "documents")
    exec(compile(text, place, "exec", dont_inherit=True), namespace)


def lines(source: str) -> Iterator[list[str]]:
    """The commands of a shell block as words, without comments, variables and what is piped on."""
    for line in re.sub(r"\\\n\s*", " ", source).splitlines():
        lexer = shlex.shlex(line.removeprefix("$ "), posix=True, punctuation_chars="&|;<>")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if words and words[-1] in (">", ">>", "<"):  # a file that is written or read
                words.pop()
            elif word not in _OPERATORS:
                words.append(word)
                continue
            while words and (words[0] in ("nohup", "time", "nice") or re.match(r"\w+=", words[0])):
                words.pop(0)
            if words:
                yield words
            words = []


def check(words: list[str]) -> None:
    """Fail unless a command could be run as it stands: its options, its target, its files exist."""
    program, *rest = words
    if program in PROGRAMS:
        rest = [re.sub(r"\$\w+|\$\{\w+\}", "1", word).strip("[]") for word in rest]
        target = _target(program, rest)
        if target is not None and "--help" not in rest:
            named = program == "landing-eval" or rest[:1] == ["sweep"]
            parse(target, program, rest[1:] if named else rest)
    elif program == "make":
        known = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
        assert all(word in known or "=" in word for word in rest), words
    elif words[:3] == VALIDATION:
        assert words[3] in validation.COMMANDS, words
        parse(validation.COMMANDS[words[3]], " ".join(words[:4]), words[4:])
    elif program == "python" and rest[0].endswith(".py"):
        assert (ROOT / rest[0]).is_file(), words
    elif "pytest" in program:
        assert all((ROOT / word).exists() for word in rest if word.startswith("tests/")), words
    elif words[:2] == ["pip", "install"]:
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
            "optional-dependencies"
        ]
        for word in rest:
            asked = re.match(r"inclined-landing\[(.*)\]", word)
            assert not asked or set(asked[1].split(",")) <= set(extras), words


def _target(program: str, rest: list[str]):
    """What the words of a command are parsed into; None for those of a program itself (--help, --version)."""
    if program == "tests.validation":
        return validation.COMMANDS[rest[0]]
    if rest and rest[0] in ("--version",):  # of either program
        return None
    if program == "landing-train" and rest[:1] == ["sweep"]:
        return sweep
    if program == "landing-train":
        return TrainConfig
    if not rest or rest[0].startswith("-"):
        return None
    assert rest[0] in cli.COMMANDS, f"landing-eval has no command {rest[0]}"
    return cli.find(rest[0])


def check_span(text: str) -> None:
    """Fail when a command in a sentence, where parts may be left out, has an option that is none."""
    program, *rest = text.removeprefix("python -m ").split()
    name = next((word for word in rest if re.fullmatch("[a-z][a-z-]+", word)), None)
    if program != "landing-train" and name is None:
        return
    for option in re.findall(r"(?<=\s)--[a-z][a-z-]*", text):
        assert option in options(program, name), f"{program} {name} has no option {option}"


@functools.cache
def options(program: str, name: str | None) -> frozenset[str]:
    """The options of a command, as its help has them."""
    target = _target(program, [name] if name else [])
    found = re.findall(r"(?<![\w-])--?[a-z][a-z-]*", help_page(target, program))
    return frozenset(found) | {"--help", "--help-all"}
