"""What a log may hold at most, far beyond real flights, and files read within that.

An hour at 1 kHz with two dozen columns is 3.6 million rows and below 1 GB of text.
"""

from __future__ import annotations

import gzip
import io
import os
import stat
import zlib
from pathlib import Path

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

LARGEST = 2**30  # bytes, unpacked
LONGEST_LINE = 2**20  # bytes
MOST_ROWS = 10_000_000
MOST_COLUMNS = 5_000
LONGEST = 12 * 3600.0  # s from the first row to the last
FEWEST_PER_SECOND, MOST_PER_SECOND = 1.0, 1e5  # rows
LARGEST_VALUE = 1e9  # in SI units: beyond, no quantity of a flight
LATEST = 60.0  # s that a mapping may shift a column


def check_file(path: Path) -> bool:
    """Return whether `path` is a folder; raise UserError for a missing, oversized or unreadable file."""
    try:
        state = os.stat(path)
        if stat.S_ISDIR(state.st_mode):
            return True
        if not stat.S_ISREG(state.st_mode):
            raise UserError(f"{path}: a pipe or device, not a file; write the log to a file first")
        if state.st_size > LARGEST:
            raise UserError(f"{path}: has {state.st_size:.3g} bytes; a log of at most {LARGEST:.3g} is read")
        with path.open("rb") as file:
            file.read(1)
        return False
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such flight log") from error
    except (OSError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{shown(path, 250)}: cannot be read ({storage.reason(error)})") from error


def read_table(path: Path) -> io.BytesIO:
    """Return the bytes of a table, unpacked where the name ends in .gz.

    Raises UserError for what is no text, for lines or files beyond the limits, and for a damaged .gz.
    """
    table, rows = io.BytesIO(), 0
    try:
        with (gzip.open if path.suffix == ".gz" else open)(path, "rb") as file:
            while part := file.read(LONGEST_LINE):
                if table.tell() == 0 and part.startswith((b"\xff\xfe", b"\xfe\xff")):
                    # What spreadsheets save as "Unicode text".
                    part = (part + file.read(LARGEST // 2)).decode("utf-16").encode()
                _check_text(path, part)
                rows += part.count(b"\n")
                if table.tell() + len(part) > LARGEST or rows > MOST_ROWS:
                    raise UserError(
                        f"{path}: more than {LARGEST:.3g} bytes or {MOST_ROWS:.0e} rows; cut the flight out"
                    )
                table.write(part)
    except (gzip.BadGzipFile, zlib.error, EOFError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not a readable text table ({error})") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({storage.reason(error)})") from error
    table.seek(0)
    return table


def _check_text(path: Path, part: bytes) -> None:
    if b"\0" in part:
        raise UserError(f"{path}: not a readable text table (it holds zero bytes)")
    if len(part) >= LONGEST_LINE and b"\n" not in part and b"\r" not in part:
        raise UserError(f"{path}: not a readable text table (a line of more than {LONGEST_LINE} bytes)")
