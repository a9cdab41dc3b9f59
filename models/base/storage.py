"""Files read within limits, and written atomically."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import json
import math
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.models.base.errors import UserError, shown

LARGEST = 1_000_000  # bytes of a file that people write
LARGEST_JSON = 100_000_000
LONGEST_NAME = 255  # bytes, of any file system in use
_PART = re.compile(r"\..*\.([0-9a-f]{8}|\d+)\.part(\..*)?", re.DOTALL)
_STALE = 86_400.0  # s since its last change, after which a temporary file that is not locked is removed
_DOTS = 3e7  # squared and summed over the lines of a TOML file: a dotted key takes a second for this many


def as_path(path: object, what: str) -> Path:
    """Return a path; raises UserError for a value that is neither text nor a path. what: see `read_bytes`."""
    if not isinstance(path, (str, os.PathLike)):
        raise UserError(f"{what} must be a path, not {shown(repr(path), 40)}")
    return Path(path)


def read_bytes(path: str | Path, what: str, largest: int = LARGEST) -> bytes:
    """Return the content of a file of at most `largest` bytes.

    what: what messages call the file, for instance "vehicle file". Raises UserError for a file that is
    missing, unreadable or too large, and for pipes and devices, which have no end.
    """
    name = shown(as_path(path, what), 240)
    try:
        kind = os.stat(path)
        if not stat.S_ISREG(kind.st_mode):
            found = "a folder" if stat.S_ISDIR(kind.st_mode) else "a pipe or device"
            raise UserError(f"{what} {name} is {found}, not a file")
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
    """Return the absolute path without links, or `path` itself if links form a cycle or it has a zero byte.

    `Path.resolve` raises three kinds of errors in these cases. The function that reads the file reports the
    problem.
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


def _lower(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error).partition("\n")[0]


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file next to `path`, with the same suffix, renamed to `path` on success.

    On any error the temporary file is removed and `path` is unchanged. OSErrors (a full disk, a
    folder that cannot be written) become UserErrors.
    """
    with scratch(path) as part:
        yield part
        os.replace(part, path)


@contextlib.contextmanager
def scratch(path: str | Path, folder: Path | None = None) -> Iterator[Path]:
    """Yield a new temporary file next to `path`, with the same suffix, which is removed at the end.

    It has a random name and is locked, so an unlocked one was left by a process that was killed. Such files
    of the same `path` are removed if they are older than _STALE. folder: make a temporary folder in this one
    instead. OSErrors become UserErrors that name `path`.
    """
    path = as_path(path, "output")
    name = (path.name if folder else path.stem)[:40] or "run"
    where = folder or path.parent
    part = where / f".{name}.{secrets.token_hex(4)}.part{'' if folder else path.suffix}"
    handle = None
    try:
        _remove(where.glob(f".{glob.escape(name)}.*.part*"), time.time() - _STALE)
        if folder:
            part.mkdir()
        # Writable, because a network file system locks no other file.
        handle = os.open(part, os.O_RDONLY if folder else os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        lock(handle)
        yield part
    except OSError as error:
        raise UserError(f"cannot write {path}: {reason(error)}") from error
    finally:
        _remove_part(part)
        if handle is not None:
            os.close(handle)


def lock(handle: int) -> bool:
    """Lock an open file or folder until it is closed; returns False if another process has locked it."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True


@contextlib.contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder and its parents; on any error, those that this process made are removed.

    Raises UserError if that is impossible.
    """
    ours: list[Path] = []
    try:
        for path in reversed([path for path in (folder, *folder.parents) if not path.exists()]):
            with contextlib.suppress(FileExistsError):  # another process was quicker
                path.mkdir()
                ours.insert(0, path)
        folder.mkdir(exist_ok=True)
    except OSError as error:
        _remove_empty(ours)
        raise UserError(f"cannot create the folder {folder}: {reason(error)}") from error
    try:
        yield
    except BaseException:
        _remove_empty(ours)
        raise


def _remove_empty(folders: Iterable[Path]) -> None:
    with contextlib.suppress(OSError):  # something else is in it by now
        for path in folders:
            path.rmdir()


def is_part(path: Path) -> bool:
    """Return whether this is a temporary file or folder of `scratch`."""
    return _PART.fullmatch(path.name) is not None


def remove_parts(folder: Path) -> None:
    """Remove temporary files of killed processes from a folder that only this process writes, recursively."""
    _remove(folder.rglob(".*.part*"))


def _remove(paths: Iterable[Path], before: float = math.inf) -> None:
    """Remove the paths that are temporary, not locked and last changed before this time."""
    for path in filter(is_part, paths):
        with contextlib.suppress(OSError):
            if path.lstat().st_mtime < before:
                mode = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_NONBLOCK
                handle = os.open(path, mode | os.O_NOFOLLOW)
                try:
                    if lock(handle):
                        _remove_part(path)
                finally:
                    os.close(handle)


def _remove_part(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def check_file(path: str | Path) -> None:
    """Raise UserError if no file can be written at `path`; leaves nothing behind."""
    path = as_path(path, "output")
    check_folder(path.parent)
    _check_name(path)
    if path.is_dir():
        raise UserError(f"cannot write {path}: it is a folder")


def check_folder(path: str | Path) -> None:
    """Raise UserError if no file can be written in the folder `path`, which need not exist yet.

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

    Bytes of file names that are not UTF-8 are written as \udcff, JSON's escape of Python's surrogates.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: str | Path, value: object) -> None:
    """Write `value` as JSON to `path` atomically."""
    write_text(path, to_json(value) + "\n")


def to_json(value: object) -> str:
    """Return JSON text, each row of a table on one line.

    NumPy numbers and arrays become plain ones, NaN and infinity become null.
    """
    return _lines(_plain(value), "\n", in_list=True)


def _lines(value: Any, line: str, in_list: bool = False) -> str:
    """Return JSON text whose lines begin with `line`; flat lists, and flat items of lists, take one line."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    flat = not any(isinstance(item, (dict, list)) and item for item in inner)
    if not inner or (flat and (in_list or isinstance(value, list))):
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    deeper = line + "  "
    if isinstance(value, dict):
        texts = [f"{json.dumps(key, ensure_ascii=False)}: {_lines(x, deeper)}" for key, x in value.items()]
        return "{" + deeper + f",{deeper}".join(texts) + line + "}"
    return "[" + deeper + f",{deeper}".join(_lines(x, deeper, in_list=True) for x in value) + line + "]"


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
    """Return the reason of an OSError, as part of a sentence."""
    return (getattr(error, "strerror", None) or str(error)).lower()
