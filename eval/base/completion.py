"""Scripts that complete a command line in bash, zsh and fish: `--print-completion SHELL`.

A script holds every command, option and listed value as they are at the time; TAB then runs no Python.
"""

from __future__ import annotations

import dataclasses
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence

from inclined_landing.envs.policy import SHIPPED
from inclined_landing.eval.base.manual import Manual, Option
from inclined_landing.models.errors import UserError, shown


@dataclasses.dataclass(frozen=True)
class _Value:
    """What may follow an option, or stand for an argument."""

    option: Option
    words: tuple[str, ...]  # known ones
    path: str  # "file", "folder" or "": is it a path?


def script(shell: str, prog: str, manuals: Mapping[str, Manual], lines: Mapping[str, str]) -> str:
    """The script for `prog`.

    shell: bash, zsh or fish. manuals: by command; "" alone for a program without commands. lines: what each
    command does, in one line. Raises UserError for another shell.
    """
    if shell not in SHELLS:
        raise UserError(f"--print-completion takes one of {', '.join(SHELLS)}, not {shown(shell, 40)!r}")
    return "\n".join(SHELLS[shell](prog, manuals, lines)) + "\n"


def _value(option: Option) -> _Value:
    word = option.value.strip("[]").split(" ")[0]
    path = {"DIR": "folder", "FILE": "file", "LOG": "file", "POLICY": "file"}.get(word, "")
    if word in ("REPORT", "DATA"):
        path = "folder"
    if word.endswith((".toml", "|FILE")):
        path = "file"
    return _Value(option, tuple(SHIPPED) if word == "POLICY" else option.choices, path)


def _function(prog: str) -> str:
    return "_" + prog.replace("-", "_")


# ---- bash


def _bash(prog: str, manuals: Mapping[str, Manual], lines: Mapping[str, str]) -> Iterator[str]:
    name = _function(prog)
    yield f"# bash completion of {prog}"
    yield f"{name}() {{"
    yield '  local cur="${COMP_WORDS[COMP_CWORD]}" prev="${COMP_WORDS[COMP_CWORD-1]}"'
    yield '  local command="" words="" files=""'
    yield "  COMPREPLY=()"
    if lines:
        yield '  command="${COMP_WORDS[1]}"'
        yield "  if [[ $COMP_CWORD -eq 1 ]]; then"
        yield f'    COMPREPLY=($(compgen -W "{" ".join([*lines, *_COMMON])}" -- "$cur"))'
        yield "    return"
        yield "  fi"
    yield "  if [[ $prev == --print-completion ]]; then"
    yield f'    COMPREPLY=($(compgen -W "{" ".join(SHELLS)}" -- "$cur"))'
    yield "    return"
    yield "  fi"
    yield '  case "$command $prev" in'
    for command, page in manuals.items():
        for value in map(_value, page.options):
            if value.option.value:
                pattern = "|".join(f'"{command} {option}"' for option in value.option.names)
                yield f"    {pattern}) {_bash_value(value)};;"
    yield "    *)"
    yield '      case "$command" in'
    for command, page in manuals.items():
        options = " ".join(option for row in page.options for option in row.names)
        free = [_value(row) for row in page.arguments]
        words = " ".join(word for value in free for word in value.words)
        path = "yes" if any(value.path for value in free) else ""
        common = "" if lines else " " + " ".join(_COMMON)
        yield f'        "{command}")'
        yield f'          if [[ $cur == -* ]]; then words="{options}{common}"'
        yield f'          else words="{words}" files="{path}"; fi;;'
    yield "      esac;;"
    yield "  esac"
    yield '  COMPREPLY=($(compgen -W "$words" -- "$cur"))'
    yield "  if [[ -n $files ]]; then"
    yield "    compopt -o filenames"
    yield "    local found"
    yield '    while IFS= read -r found; do COMPREPLY+=("$found"); done < <('
    yield '      if [[ $files == folder ]]; then compgen -d -- "$cur"; else compgen -f -- "$cur"; fi)'
    yield "  fi"
    yield "}"
    yield f"complete -F {name} {prog}"


def _bash_value(value: _Value) -> str:
    return f'words="{" ".join(value.words)}" files="{value.path}"'


# ---- zsh


def _zsh(prog: str, manuals: Mapping[str, Manual], lines: Mapping[str, str]) -> Iterator[str]:
    name = _function(prog)
    yield f"#compdef {prog}"
    shipped = f"_alternative 'policies:shipped policy:({' '.join(SHIPPED)})' 'files:file:_files'"
    yield f"{name}_policy() {{ {shipped} }}"
    yield f"{name}() {{"
    if lines:
        yield "  local -a commands=("
        yield from (f"    {shlex.quote(f'{command}:{line}')}" for command, line in lines.items())
        yield "  )"
        yield "  if (( CURRENT == 2 )); then"
        yield "    _describe -t commands command commands"
        yield f"    _arguments {' '.join(_zsh_common())}"
        yield "    return"
        yield "  fi"
        yield '  local command="$words[2]"'
        yield "  shift words; (( CURRENT-- ))"
    else:
        yield '  local command=""'
    yield '  case "$command" in'
    for command, page in manuals.items():
        specs = [spec for row in page.options for spec in _zsh_option(row, name)]
        specs += [
            f"'*:{row.value or row.words}:{_zsh_value(_value(row), name)}'" for row in page.arguments[-1:]
        ]
        yield f"    '{command}')"
        yield " \\\n        ".join(["      _arguments", *specs, *([] if lines else _zsh_common())]) + ";;"
    yield "  esac"
    yield "}"
    yield f'if [[ $funcstack[1] == {name} ]]; then {name} "$@"; else compdef {name} {prog}; fi'


def _zsh_option(row: Option, function: str) -> Iterator[str]:
    text = re.sub(r"([\\\[\]:])", r"\\\1", row.text)
    value = (
        f":{row.value.split(' ')[0].translate(_PLAIN)}:{_zsh_value(_value(row), function)}"
        if row.value
        else ""
    )
    for name in row.names:
        yield shlex.quote(f"*{name}[{text}]{value}")


def _zsh_value(value: _Value, function: str) -> str:
    files = {"file": "_files", "folder": "_files -/"}.get(value.path, "")
    words = f"({' '.join(value.words)})" if value.words else ""
    if files and words:
        return f" {function}_policy"  # the blank: called with no further words
    return files or words or " "


def _zsh_common() -> list[str]:
    return ["'--version[versions]'", f"'--print-completion[of this shell]:shell:({' '.join(SHELLS)})'"]


# ---- fish


def _fish(prog: str, manuals: Mapping[str, Manual], lines: Mapping[str, str]) -> Iterator[str]:
    yield f"# fish completion of {prog}"
    yield f"complete -c {prog} -f"
    first = " -n __fish_use_subcommand" if lines else ""
    for command, line in lines.items():
        yield f"complete -c {prog}{first} -a {command} -d {_fish_text(line)}"
    yield f"complete -c {prog}{first} -l version -d versions"
    yield f"complete -c {prog}{first} -l print-completion -x -a '{' '.join(SHELLS)}' -d 'of a shell'"
    for command, page in manuals.items():
        when = f" -n '__fish_seen_subcommand_from {command}'" if command else ""
        for row in page.options:
            flags = " ".join(f"-l {n[2:]}" if n.startswith("--") else f"-s {n[1:]}" for n in row.names)
            yield f"complete -c {prog}{when} {flags}{_fish_value(_value(row))} -d {_fish_text(row.text)}"
        for value in map(_value, page.arguments):
            if value.path or value.words:
                words = f" -a '{' '.join(value.words)}'" if value.words else ""
                yield f"complete -c {prog}{when}{' -F' if value.path else ''}{words}"


def _fish_value(value: _Value) -> str:
    if not value.option.value:
        return ""
    words = f" -a '{' '.join(value.words)}'" if value.words else ""
    return f" {'-r -F' if value.path else '-x'}{words}"


def _fish_text(text: str) -> str:
    first = re.split(r"(?<=[.;:]) |[;:]$", text)[0].rstrip(".;:")
    return "'" + first.replace("\\", "\\\\").replace("'", "\\'") + "'"


_COMMON = ("--help", "--version", "--print-completion")
_PLAIN = str.maketrans("", "", "[]{}:")
SHELLS: dict[str, Callable[[str, Mapping[str, Manual], Mapping[str, str]], Iterator[str]]] = {
    "bash": _bash,
    "zsh": _zsh,
    "fish": _fish,
}


def shell_of(words: Sequence[str]) -> str:
    """SHELL of `--print-completion SHELL` or `--print-completion=SHELL`; "" where it is not said."""
    _, _, joined = words[0].partition("=")
    return joined or " ".join(words[1:2])
