"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inclined_landing.models.errors import UserError, shown

LONGEST_NAME = 255  # bytes, of any file system in use


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path`, with the same suffix, renamed to `path` on success.

    On any error the temporary file is removed and `path` stays as it was. OSErrors (a full disk, a
    folder that cannot be written) become UserErrors.
    """
    path = Path(path)
    part = path.with_name(f".{path.stem[:40]}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {reason(error)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def check_file(path: str | Path) -> None:
    """Raise UserError if no file could be written at `path`; leaves nothing behind."""
    path = Path(path)
    check_folder(path.parent)
    _check_name(path)
    if path.is_dir():
        raise UserError(f"cannot write {path}: it is a folder")


def check_folder(path: str | Path) -> None:
    """Raise UserError if no file could be written in the folder `path`, there or to be made.

    Leaves nothing behind.
    """
    path = Path(path)
    _check_name(path)
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
    """Write `data` to `path`, whole or not at all."""
    with atomic(path) as part:
        part.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    r"""Write UTF-8 text to `path`, whole or not at all.

    Bytes of file names that are no UTF-8 become \udcff: JSON's own way to write what Python holds.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: str | Path, value) -> None:
    """Write `value` as JSON to `path`, whole or not at all."""
    write_text(path, to_json(value) + "\n")


def to_json(value) -> str:
    """JSON text; NumPy numbers and arrays become plain ones, NaN and infinity become null."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def _plain(value):
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
    """What went wrong, as part of a sentence."""
    return (getattr(error, "strerror", None) or str(error)).lower()
