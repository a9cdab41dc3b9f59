"""Files read within limits, and written atomically."""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.models.errors import UserError, shown

LARGEST = 1_000_000  # bytes of a file that people write
LARGEST_JSON = 100_000_000
LONGEST_NAME = 255  # bytes, of any file system in use
_DOTS = 3e7  # squared and summed over the lines of a TOML file: a dotted key takes a second for this many


def as_path(path: object, what: str) -> Path:
    """Return a path; raises UserError for what is neither text nor a path. what: as in `read_bytes`."""
    if not isinstance(path, (str, os.PathLike)):
        raise UserError(f"{what} must be a path, not {shown(repr(path), 40)}")
    return Path(path)


def read_bytes(path: str | Path, what: str, largest: int = LARGEST) -> bytes:
    """Return the content of a file of at most `largest` bytes.

    what: its name in sentences, as in "vehicle file". Raises UserError for a file that is missing,
    unreadable or too large, and for pipes and devices, which have no end.
    """
    name = shown(as_path(path, what), 240)
    try:
        kind = os.stat(path)
        if not stat.S_ISREG(kind.st_mode):
            raise UserError(f"{what} {name} is {_kind(kind.st_mode)}, not a file")
        if kind.st_size > largest:
            raise UserError(f"{what} {name} has {kind.st_size} bytes; the limit is {largest}")
        with open(path, "rb") as file:
            return file.read(largest)
    except FileNotFoundError as error:
        raise UserError(f"{what} {name} does not exist") from error
    except (OSError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{what} {name} cannot be read: {reason(error)}") from error


def real(path: str | Path) -> Path:
    """Return the absolute path without links; `path` itself where they lead in a circle, or with a zero byte.

    `Path.resolve` raises errors of three kinds there. What is wrong is said by what reads the file.
    """
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError):
        return Path(path)


def read_text(path: str | Path, what: str, largest: int = LARGEST) -> str:
    """Return the UTF-8 text of a file, with the limits and errors of `read_bytes`."""
    try:
        return read_bytes(path, what, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{what} {path} is not UTF-8 text: {error.reason} at byte {error.start}") from error


def read_toml(path: str | Path, what: str) -> dict:
    """Return the tables of a TOML file; raises UserError if it cannot be read or is not TOML."""
    text = read_text(path, what)
    if sum(line.count(".") ** 2 for line in text.splitlines()) > _DOTS:
        raise UserError(f"{what} {path} is refused because of lines with thousands of dots")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # bad syntax, or a number of thousands of digits
        raise UserError(f"{what} {path} is not TOML: {_lower(error)}") from error


def read_json(path: str | Path, what: str, largest: int = LARGEST_JSON) -> Any:
    """Return the value in a JSON file; raises UserError if it cannot be read or is not JSON."""
    return parse_json(read_text(path, what, largest), f"{what} {path}")


def parse_json(text: str | bytes, what: str) -> Any:
    """Return the value in a JSON text; raises UserError, beginning with `what`, if it is not JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{what} is not JSON: {_lower(error)}") from error


def _kind(mode: int) -> str:
    return "a folder" if stat.S_ISDIR(mode) else "a pipe or device"


def _lower(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error).partition("\n")[0]


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, with the same suffix, renamed to `path` on success.

    On any error the temporary file is removed and `path` is unchanged. OSErrors (a full disk, a
    folder that cannot be written) become UserErrors.
    """
    with scratch(path) as part:
        try:
            yield part
            os.replace(part, path)
        except OSError as error:
            raise UserError(f"cannot write {path}: {reason(error)}") from error


@contextlib.contextmanager
def scratch(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, with the same suffix, whose file is removed at the end."""
    path = as_path(path, "output")
    part = path.with_name(f".{path.stem[:40]}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder, with those above it; what of them was not there before goes again on any error.

    Raises UserError where that is impossible.
    """
    try:
        missing = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {folder}: {reason(error)}") from error
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):  # something else is in it by now
            for path in missing:
                path.rmdir()
        raise


def is_part(path: Path) -> bool:
    """Return whether this is a temporary file or folder of `atomic` or of a staged run."""
    return re.fullmatch(r"\..*\.\d+\.part(\..*)?", path.name, re.DOTALL) is not None


def remove_parts(folder: Path) -> None:
    """Remove what killed processes left in a folder that only this one writes, and in its folders."""
    for path in folder.rglob(".*.part*"):
        if is_part(path) and path.is_file():
            path.unlink(missing_ok=True)


def check_file(path: str | Path) -> None:
    """Raise UserError if no file could be written at `path`; leaves nothing behind."""
    path = as_path(path, "output")
    check_folder(path.parent)
    _check_name(path)
    if path.is_dir():
        raise UserError(f"cannot write {path}: it is a folder")


def check_folder(path: str | Path) -> None:
    """Raise UserError if no file could be written in the folder `path`, there or to be made.

    Leaves nothing behind.
    """
    path = as_path(path, "output")
    _check_name(path)
    if path.name == ".." and not path.exists():
        raise UserError(f"cannot write into {path}: it leads through a folder that does not exist")
    try:
        there = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
        if not there.is_dir():
            raise UserError(f"cannot write into {path}: {there} is not a folder")
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise UserError(f"cannot write into {path}: {reason(error)}") from error


def _check_name(path: Path) -> None:
    if any("\0" in part or len(os.fsencode(part)) > LONGEST_NAME for part in path.parts):
        raise UserError(
            f"cannot write {shown(path)}: a name has at most {LONGEST_NAME} bytes, none of them zero"
        )


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` atomically."""
    with atomic(path) as part:
        part.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    r"""Write UTF-8 text to `path` atomically.

    Bytes of file names that are no UTF-8 become \udcff: JSON's own way to write what Python holds.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: str | Path, value: object) -> None:
    """Write `value` as JSON to `path` atomically."""
    write_text(path, to_json(value) + "\n")


def to_json(value: object) -> str:
    """Return JSON text; NumPy numbers and arrays become plain ones, NaN and infinity become null."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def reason(error: Exception) -> str:
    """Return what went wrong, as part of a sentence."""
    return (getattr(error, "strerror", None) or str(error)).lower()
