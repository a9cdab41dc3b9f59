"""Fails, with file and line, on phrases that a native reader stumbles over.

usage: words.py [FILE ...]   default: pages, examples, and docstrings, messages and templates of the packages
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

PHRASES = {
    r"beside": "next to, compared with, in addition to",
    r"anew": "again",
    r"alike": "the same, both",
    r"told|tells? (\w+ ){0,6}(apart|from)": "state, inform, distinguish",
    r"by (it|them)sel(f|ves)": "automatically, alone",
    r"of yours|of one's own": "custom, your own",
    r"as (it is|they are)(?=[.,;:)]|$)": "unchanged",
    r"known are": "choose from",
    r"(?<!there )(is|are) no (?!UTF|longer|(more|less|later|lower|higher) than)\w+": "is not a",
    r"whole or not at all": "atomically",
    r"nobody|somebody|whoever": "name the actor",
    r"what (is left|came of|came out)": "the rest, the result",
    r"in (its|the|their) place of|in its place": "instead of",
    r"but for": "except for",
    r"(go|goes|went|going) on(?! (to|the|top|a|its))": "continue",
    r"(belongs?|goes?|go) together": "be compatible, be given together",
    r"of (today|now)(?=[.,;:)]|$)|today's": "name the version, or leave it out",
    r"felt|feels?": "is affected by",
    r"(leave|leaves|left) \w+ out": "omit",
}
BANNED = {re.compile(rf"\b({phrase})(?!\w)", re.IGNORECASE): better for phrase, better in PHRASES.items()}
OF = re.compile(r"^ {4,}\w+: of ", re.MULTILINE)  # help that begins with "of"
# Not read: tables of results, and the mathematics of the gap workflow.
ELSEWHERE = ("docs/evidence",)
PACKAGES = ("models", "envs", "eval", "train")


def sentences(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of the lines of a file that people read."""
    text = path.read_text("utf-8")
    if path.suffix != ".py":
        text = re.sub(
            r"```.*?```|`[^`\n]*`|<[^>]*>", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL
        )
        yield from enumerate(text.split("\n"), 1)
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            for k, line in enumerate(re.sub(r"`[^`]*`", "", node.value).split("\n")):
                yield node.lineno + k, line


def found(path: Path) -> Iterator[str]:
    """Yield a sentence on each phrase in a file that has a better one."""
    for number, line in sentences(path):
        for phrase, better in BANNED.items():
            if (match := phrase.search(line)) and not match[0].isupper():
                yield f"{path}:{number}: '{match[0]}', better: {better}"
        if OF.match(line):
            yield f"{path}:{number}: help begins with 'of', better: name the thing"


def main(files: list[str]) -> int:
    """Print what was found; 1 if anything was."""
    if not files:
        listed = [
            "*.md",
            "docs/**/*.md",
            "docs/site/*.py",
            "examples/*",
            "models/**/*.toml",
            "eval/**/*.toml",
        ]
        listed += [f"{package}/**/*.{ending}" for package in PACKAGES for ending in ("md", "py", "j2")]
        paths = [f":(glob){one}" for one in listed] + [f":!{one}" for one in ELSEWHERE]
        files = subprocess.check_output(["git", "ls-files", *paths], text=True).split()
    lines = [line for file in files for line in found(Path(file))]
    print("\n".join(lines), end="\n" * bool(lines))
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
