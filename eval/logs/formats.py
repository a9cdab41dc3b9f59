"""Files that are no flight log that is read here, by what they begin with or how they are called."""

from __future__ import annotations

from pathlib import Path

from inclined_landing.models.errors import UserError, shown

_TO_CSV = ".to_csv('flight.csv', index=False) makes a CSV file of it"
_PICKLES = tuple(
    b"\x80" + bytes([k]) + rest for k in range(2, 6) for rest in (b"\x95", b"c", b"}", b"]", b"(")
)
# Suffixes, first bytes, and what to do with such a file, where {name} is its name.
_KINDS: tuple[tuple[tuple[str, ...], tuple[bytes, ...], str], ...] = (
    (
        (".ulg",),
        (b"ULog\x01\x12\x35",),
        "a log of PX4: `ulog2csv {name}` (pip install pyulog) writes CSV files",
    ),
    (
        (".bin", ".tlog", ".px4log"),
        (b"\xa3\x95", b"FMT, 128"),
        "a binary log, of ArduPilot perhaps: `mavlogdump.py --format csv --types TYPE {name}` "
        "(pip install pymavlink) writes the messages of a type as CSV",
    ),
    (
        (".bbl", ".bfl", ".bbs"),
        (b"H Product:Blackbox",),
        "a blackbox log of Betaflight: `blackbox_decode {name}` (blackbox-tools) writes CSV",
    ),
    ((".xlsx", ".xlsm", ".xls", ".ods"), (b"\xd0\xcf\x11\xe0",), "a spreadsheet: save it as CSV there"),
    ((".parquet",), (b"PAR1",), "a Parquet table: pandas.read_parquet('{name}')" + _TO_CSV),
    (
        (".feather", ".arrow"),
        (b"ARROW1", b"FEA1"),
        "a Feather table: pandas.read_feather('{name}')" + _TO_CSV,
    ),
    (
        (".jsonl", ".ndjson", ".json"),
        (b"{", b"[{", b"[["),
        "JSON, no table: pandas.read_json('{name}')" + _TO_CSV,
    ),
    (
        (".npy", ".npz"),
        (b"\x93NUMPY",),
        "arrays of numpy: pandas.DataFrame(numpy.load('{name}'), columns=['t', 'x', ...])" + _TO_CSV,
    ),
    ((".mat",), (b"MATLAB",), "a file of MATLAB: writetable there makes a CSV file of a table"),
    ((".h5", ".hdf5", ".hdf"), (b"\x89HDF",), "an HDF5 file: pandas.read_hdf('{name}')" + _TO_CSV),
    (
        (".pkl", ".pickle"),
        _PICKLES,
        "a pickle, which could run anything and is not opened: write the table as CSV where you made it",
    ),
    (
        (".zst", ".7z", ".rar", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2"),
        (b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf", b"Rar!"),
        "packed: unpack it and name the log",
    ),
    (
        (".active",),
        (b"#ROSBAG",),
        "a ROS 1 bag: give it a name that ends in .bag, after `rosbag reindex` if it is open",
    ),
    ((), (b"\x89MCAP", b"SQLite format 3\0"), "a ROS 2 bag: give it a name that ends in .mcap or .db3"),
    ((), (b"version https://git-lfs",), "a pointer of Git LFS, not the log: `git lfs pull` fetches that"),
    ((), (b"<",), "a web page or XML, not a log: download the file itself, or save it as CSV"),
)


def check(path: Path) -> None:
    """Raise UserError, with what to do, for a file of a kind that is known and not read."""
    with path.open("rb") as file:
        start = file.read(64).removeprefix(b"\xef\xbb\xbf")
    called = [remedy for suffixes, _, remedy in _KINDS if path.name.lower().endswith(suffixes)]
    begun = [remedy for _, starts, remedy in _KINDS if start.startswith(starts)]
    for remedy in (called + begun)[:1]:
        raise UserError(f"{path}: {remedy.format(name=shown(path.name, 60))}")
