"""Files that are no flight log that is read here, by what they begin with or how they are called."""

from __future__ import annotations

from pathlib import Path

from inclined_landing.models.errors import UserError, shown

_PANDAS = "pandas.{}('{{name}}').to_csv('flight.csv', index=False) makes a CSV file of it"
_NUMPY = (
    "pandas.DataFrame({}, columns=['t', 'x', ...]).to_csv('flight.csv', index=False) makes a CSV file of it"
)
_TOPICS = "; a mapping file then names their columns and turns north-east-down into z up"
# Suffixes, first bytes, and what to do with such a file, where {name} is its name.
_KINDS: tuple[tuple[tuple[str, ...], tuple[bytes, ...], str], ...] = (
    (
        (".ulg",),
        (b"ULog\x01\x12\x35",),
        f"a log of PX4: `ulog2csv {{name}}` (pip install pyulog) writes a CSV file per topic{_TOPICS}",
    ),
    (
        (".bin", ".tlog", ".px4log"),
        (b"\xa3\x95", b"FMT, 128"),
        "a binary log, of ArduPilot perhaps: `mavlogdump.py --format csv --types TYPE {name}` "
        f"(pip install pymavlink) writes the messages of a type as CSV{_TOPICS}",
    ),
    (
        (".bbl", ".bfl", ".bbs"),
        (b"H Product:Blackbox",),
        "a blackbox log of Betaflight: `blackbox_decode {name}` (blackbox-tools) writes CSV; a mapping file "
        "then names its columns; position has to come from another log",
    ),
    ((".xlsx", ".xlsm", ".xls", ".ods"), (b"\xd0\xcf\x11\xe0",), "a spreadsheet: save it as CSV there"),
    ((".parquet",), (b"PAR1",), f"a Parquet table: {_PANDAS.format('read_parquet')}"),
    ((".feather", ".arrow"), (b"ARROW1", b"FEA1"), f"a Feather table: {_PANDAS.format('read_feather')}"),
    (
        (".jsonl", ".ndjson"),
        (b'{"',),
        "JSON, no table: pandas.read_json('{name}', lines=True).to_csv('flight.csv', index=False) makes a "
        "CSV file of one object per line; leave out lines=True where all is one object",
    ),
    ((".json",), (b"{", b"[{", b"[["), f"JSON, no table: {_PANDAS.format('read_json')}"),
    ((".npy",), (b"\x93NUMPY",), "an array without names: " + _NUMPY.format("numpy.load('{name}')")),
    (
        (".npz",),
        (),
        "arrays of numpy: pandas.DataFrame(dict(numpy.load('{name}'))).to_csv('flight.csv', index=False) "
        "makes a CSV file of arrays with one value per row",
    ),
    (
        (".mat",),
        (b"MATLAB",),
        "a file of MATLAB: writetable(table(t, x, y, z, ...), 'flight.csv') there makes a CSV file of its "
        "variables",
    ),
    (
        (".h5", ".hdf5", ".hdf"),
        (b"\x89HDF",),
        f"an HDF5 file: {_PANDAS.format('read_hdf')} if pandas wrote it; otherwise h5py reads its arrays",
    ),
    (
        (".pkl", ".pickle"),
        tuple(b"\x80" + bytes([k]) + rest for k in range(2, 6) for rest in (b"\x95", b"c", b"}", b"]", b"(")),
        "a pickle, which could run anything and is not opened: write the table as CSV where you made it",
    ),
    (
        (".zst", ".7z", ".rar", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2"),
        (b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf", b"Rar!"),
        "packed: unpack it and name the log",
    ),
    (
        (".active",),
        (),
        "a ROS 1 bag that was not closed: `rosbag reindex {name}`, and a name that ends in .bag",
    ),
    ((), (b"#ROSBAG",), "a ROS 1 bag: give it a name that ends in .bag"),
    ((), (b"\x89MCAP",), "a ROS 2 bag: give it a name that ends in .mcap"),
    ((), (b"SQLite format 3\0",), "a database: if it is a ROS 2 bag, give it a name that ends in .db3"),
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
