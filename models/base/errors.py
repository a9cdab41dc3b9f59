"""Sentences for the user: the exception for wrong input, and messages for missing packages."""

from __future__ import annotations

import contextlib
import difflib
import re
from collections.abc import Iterable, Iterator, Sequence

# Packages by the extra that installs them; others come with `eval` and with `train`.
_EXTRAS = {
    "eval": (
        *("scipy", "threadpoolctl", "pandas", "matplotlib", "PIL", "mediapy", "imageio_ffmpeg"),
        *("pyarrow", "jinja2", "rosbags"),
    ),
    "train": ("stable_baselines3", "torch", "tensorboard", "psutil", "tomlkit"),
    "export": ("onnx",),
    "ray": ("ray",),
    "fly": ("cflib",),
    "baselines": ("rotorpy", "torchdiffeq", "roma"),
    "mocap": ("motioncapture",),
}
LONGEST = 400  # characters of a sentence; beyond, its middle is left out
LONGEST_LIST = 200  # characters of names that are known
LONG_WORD = r"[^\s/]{151,}"  # shortened in sentences; names of files are rarely that long
LONG_PATH = r"\S{201,}"  # shortened too


class UserError(ValueError):
    """Wrong input. The message says what was wrong, where, and what would be right.

    The command lines print the message and exit with code 2; a library user sees a ValueError. The
    message stays one printable line, whatever names it contains.
    """

    def __init__(self, sentence: str):
        shortened = re.sub(LONG_WORD, lambda word: shown(word[0]), sentence)
        shortened = re.sub(LONG_PATH, lambda path: shown(path[0], 160), shortened)
        super().__init__(shown(shortened, LONGEST))


@contextlib.contextmanager
def optional() -> Iterator[None]:
    """Wrap the import of packages of an extra; if they are missing, raise ImportError with one sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ImportError(not_installed(error), name=error.name) from error


def not_installed(error: ModuleNotFoundError, extra: str = "eval") -> str:
    """Return the sentence for a missing package with its remedy; extra: the extra that installs it."""
    package = (error.name or "").partition(".")[0]
    if package in ("", "inclined_landing"):
        return str(error)
    extra = next((name for name, packages in _EXTRAS.items() if package in packages), extra)
    return f"{package} is not installed; pip install 'inclined-landing[{extra}]'"


def choices(names: Iterable[str], wanted: str) -> str:
    """Return the possible names as the end of a sentence: all, or the nearest to `wanted` of many."""
    names = list(names)
    every = f"choose from {', '.join(names)}"
    if len(every) <= LONGEST_LIST:
        return every
    near = difflib.get_close_matches(wanted, names, 3, 0.5) or names[:3]
    return f"choose from {len(names)} names, such as {', '.join(near)}"


def first_of(texts: Sequence[str]) -> str:
    """Return names or clauses as part of a sentence: the first ones, and the number of further ones."""
    kept = list(texts[:1])
    for text in texts[1:]:
        if sum(map(len, kept)) + len(text) > LONGEST_LIST:
            return f"{'; '.join(kept)}; and {len(texts) - len(kept)} more"
        kept.append(text)
    return "; ".join(kept)


def shown(name: object, longest: int = 80) -> str:
    r"""Return a name (path, column, entry) for a sentence: one line, nothing that reorders or hides text.

    Control characters, direction marks and bytes that are not UTF-8 are escaped, as \n, \u202e and \xff; if
    there are more than `longest` characters, the middle is omitted.
    """
    text = str(name)
    if len(text) > longest:
        text = f"{text[: longest * 2 // 3]} ... {text[-(longest // 4) :]}"
    return text if text.isprintable() else "".join(map(_printable, text))


def _printable(character: str) -> str:
    if character.isprintable():
        return character
    if 0xDC80 <= ord(character) <= 0xDCFF:  # a byte of a file name that is not UTF-8
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")
