"""Files of unsupported kinds, by their names or first bytes."""

from __future__ import annotations

import re
from pathlib import Path

from inclined_landing.models.base.errors import UserError, shown

_TO_CSV = ".to_csv('flight.csv', index=False) writes a CSV file"
# Suffixes, the first bytes, and what to do with such a file, where {name} is its name.
_KINDS = (
    (".ulg", rb"ULog\x01\x12\x35", "a log of PX4: `ulog2csv {name}` (pip install pyulog) writes CSV files"),
    (
        ".bin .tlog .px4log",
        rb"\xa3\x95|FMT, 128",
        "a binary log, possibly of ArduPilot: `mavlogdump.py --format csv --types TYPE {name}` "
        "(pip install pymavlink) writes the messages of a type as CSV",
    ),
    (
        ".bbl .bfl .bbs",
        rb"H Product:Blackbox",
        "a blackbox log of Betaflight: `blackbox_decode {name}` (blackbox-tools) writes CSV",
    ),
    (".xlsx .xlsm .xls .ods", rb"\xd0\xcf\x11\xe0", "a spreadsheet: save it as CSV"),
    (".parquet", rb"PAR1", "a Parquet table: pandas.read_parquet('{name}')" + _TO_CSV),
    (".feather .arrow", rb"ARROW1|FEA1", "a Feather table: pandas.read_feather('{name}')" + _TO_CSV),
    (
        ".jsonl .ndjson",
        rb"\{[^\n]*\}\s*\n\s*\{",
        "JSON in lines, not a table: pandas.read_json('{name}', lines=True)" + _TO_CSV,
    ),
    (".json", rb"\{|\[\s*[{[]", "JSON, not a table: pandas.read_json('{name}')" + _TO_CSV),
    (
        ".npz",
        rb"PK\x03\x04.{26}[^/]*\.npy",
        "arrays of numpy: pandas.DataFrame({{**numpy.load('{name}')}})" + _TO_CSV,
    ),
    (
        ".npy",
        rb"\x93NUMPY",
        "an array of numpy: pandas.DataFrame(numpy.load('{name}'), columns=['t', 'x', ...])" + _TO_CSV,
    ),
    (".mat", rb"MATLAB", "a MATLAB file: write the table as CSV with writetable"),
    (".h5 .hdf5 .hdf", rb"\x89HDF", "an HDF5 file: pandas.read_hdf('{name}')" + _TO_CSV),
    (
        ".pkl .pickle",
        rb"\x80[\x02-\x05][\x95c}\](]",
        "a pickle, which is not opened because it can run any code: save the table as CSV instead",
    ),
    (
        ".zst .7z .rar .tar .tgz .tar.gz .tar.xz .tar.bz2",
        rb"\x28\xb5\x2f\xfd|7z\xbc\xaf|Rar!",
        "packed: unpack it and name the log",
    ),
    (
        ".active",
        rb"#ROSBAG",
        "a ROS 1 bag: give it a name that ends in .bag, after `rosbag reindex` if it is open",
    ),
    ("", rb"\x89MCAP|SQLite format 3\0", "a ROS 2 bag: give it a name that ends in .mcap or .db3"),
    ("", rb".tick\(I\),", "a micro-SD log in the format before 2020: its firmware's tools/usdlog decodes it"),
    ("", rb"version https://git-lfs", "a pointer of Git LFS, not the log: `git lfs pull` fetches that"),
    ("", rb"<", "a web page or XML, not a log: download the file itself, or save it as CSV"),
)


def check(path: Path) -> None:
    """Raise UserError, with a remedy, for a file of a known kind that is not supported."""
    with path.open("rb") as file:
        start = file.read(4096).removeprefix(b"\xef\xbb\xbf")
    called = [remedy for ends, _, remedy in _KINDS if path.name.lower().endswith(tuple(ends.split()))]
    begun = [remedy for _, begins, remedy in _KINDS if re.match(begins, start, re.DOTALL)]
    for remedy in (begun + called)[:1]:
        raise UserError(f"{path}: {remedy.format(name=shown(path.name, 60))}")
