"""Limits on the size of a log, far beyond those of real flights, and reading within them.

An hour at 1 kHz with two dozen columns is 3.6 million rows and below 1 GB of text.
"""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import lzma
import os
import stat
import zipfile
import zlib
from pathlib import Path
from typing import IO

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

LARGEST = 2**30  # bytes, unpacked
LONGEST_LINE = 2**20  # bytes
MOST_ROWS = 10_000_000
MOST_COLUMNS = 5_000
MOST_AT_THE_END = 10  # rows of words or sums below a log, which are cut
LONGEST = 12 * 3600.0  # s from the first row to the last
FEWEST_PER_SECOND, MOST_PER_SECOND = 1.0, 1e5  # rows
# Hz: commands are sent every 20 ms or faster and held from row to row: on average they are dated
# (dt - 20 ms)/2 wrong, beyond the 5 ms of lag that matter for dt > 30 ms.
LEAST_RATE = 30.0
LARGEST_VALUE = 1e9  # in SI units: beyond, no quantity of a flight
LATEST = 60.0  # s that a mapping may shift a column
_PLAIN = bytes(range(32, 127)) + b"\t\n\r\f"


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


def read_table(path: Path) -> tuple[bytes, str, list[str]]:
    """Return the bytes of a table with line feeds as line ends, the encoding, and notes.

    Files compressed by gzip, xz, bzip2 or zip are unpacked. Zero bytes at the end of a file that was not
    closed are removed. Text that is not UTF-8 is read as Latin-1, which has the same digits and signs.

    Raises UserError for binary data, for lines or files beyond the limits, and for damaged packed files.
    """
    try:
        with _open_unpacked(path) as file:
            data = file.read(LARGEST + 1)
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):  # spreadsheets save "Unicode text" so
            data = data.decode("utf-16").encode()
        data, size = data.rstrip(b"\0"), len(data)
        if size and not data:
            raise UserError(f"{path}: contains only zero bytes: nothing was written to it")
        if size > LARGEST or data.count(b"\n") > MOST_ROWS:
            most = f"{LARGEST:.3g} bytes or {MOST_ROWS:.0e} rows"
            raise UserError(f"{path}: more than {most}; extract the flight")
        if b"\0" in data:
            raise UserError(f"{path}: not a readable text table (it contains zero bytes)")
        parts = (data[k : k + LONGEST_LINE] for k in range(0, len(data) - LONGEST_LINE + 1, LONGEST_LINE))
        if not all(b"\n" in part or b"\r" in part for part in parts):
            raise UserError(f"{path}: not a readable text table (a line of more than {LONGEST_LINE} bytes)")
        encoding = "utf-8"
        try:
            data.decode()
        except UnicodeDecodeError:
            if 2 * len(data.translate(None, _PLAIN)) > len(data):
                raise
            encoding = "latin-1"
    except (gzip.BadGzipFile, zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: not a readable text table ({error})") from error
    except (OSError, RuntimeError) as error:  # RuntimeError: a zip file with a password
        raise UserError(f"{path}: cannot be read ({storage.reason(error)})") from error
    data, zeros = data.removeprefix(codecs.BOM_UTF8), size - len(data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    notes = (
        [f"the file ends in {zeros} zero bytes; it was not closed properly and is read up to there"]
        if zeros
        else []
    )
    return data, encoding, notes


def _open_unpacked(path: Path) -> io.BufferedIOBase | IO[bytes]:
    with path.open("rb") as file:
        start = file.read(6)
    if start.startswith(b"PK\3\4"):
        with zipfile.ZipFile(path) as archive:
            files = [item for item in archive.infolist() if not item.is_dir()]
            if len(files) != 1:
                raise UserError(f"{path}: contains {len(files)} files; unpack it and name the log")
            return archive.open(files[0])
    for magic, opener in ((b"\x1f\x8b", gzip.GzipFile), (b"\xfd7zXZ", lzma.LZMAFile), (b"BZh", bz2.BZ2File)):
        if start.startswith(magic):
            return opener(path, "rb")
    return path.open("rb")
