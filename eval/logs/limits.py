"""Limits on the size of a log, far beyond those of real flights, and reading within them.

An hour at 1 kHz with two dozen columns is 3.6 million rows and below 1 GB of text.
"""

from __future__ import annotations

import codecs
import gzip
import os
import stat
import zlib
from pathlib import Path

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

LARGEST = 2**30  # bytes, unpacked
LONGEST_LINE = 2**20  # bytes
MOST_ROWS = 10_000_000
MOST_COLUMNS = 5_000
LONGEST = 12 * 3600.0  # s from the first row to the last
FEWEST_PER_SECOND, MOST_PER_SECOND = 1.0, 1e5  # rows
# Hz: commands are sent every 20 ms or faster and held from row to row: on average they are dated
# (dt - 20 ms)/2 wrong, beyond the 5 ms of lag that matter for dt > 30 ms.
LEAST_RATE = 30.0
LARGEST_VALUE = 1e9  # in SI units: beyond, no quantity of a flight
LATEST = 60.0  # s that a mapping may shift a column
CONVERT = "save it as CSV in UTF-8; eval/logs/README.md names programs that convert logs"


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


def read_table(path: Path) -> bytes:
    """Return the bytes of a table in UTF-8, unpacked if it is compressed by gzip; lines end in line feeds.

    Raises UserError for other data, for lines or files beyond the limits, and for damaged packed files.
    """
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
        with gzip.open(path) if packed else path.open("rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST or data.count(b"\n") > MOST_ROWS:
            most = f"{LARGEST:.3g} bytes or {MOST_ROWS:.0e} rows"
            raise UserError(f"{path}: more than {most}; extract the flight")
        if b"\0" in data:
            raise ValueError("it contains zero bytes")
        parts = (data[k : k + LONGEST_LINE] for k in range(0, len(data) - LONGEST_LINE + 1, LONGEST_LINE))
        if not all(b"\n" in part or b"\r" in part for part in parts):
            raise ValueError(f"a line of more than {LONGEST_LINE} bytes")
        data.decode()
    except (gzip.BadGzipFile, zlib.error, EOFError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: not a readable text table ({error}); {CONVERT}") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({storage.reason(error)})") from error
    return data.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
