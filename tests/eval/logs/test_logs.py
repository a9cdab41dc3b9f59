"""Readers of flight logs: what is written comes back, in this package's units and convention."""

import bz2
import contextlib
import gzip
import lzma
import os
import re
import shlex
import sqlite3
import zipfile
from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags import rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from inclined_landing.eval.cli import main
from inclined_landing.eval.gap import diagnose, measure_gap
from inclined_landing.eval.gap.answer.identification import identify
from inclined_landing.eval.logs import FlightLog, check_log, read_log, write_log
from inclined_landing.eval.logs.read import log_table
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.log_files import a_log, firmware_values, sd_card, write_bag

HEADER = "t,x,y,z,roll,pitch,yaw,cmd_thrust_pwm,cmd_roll,cmd_pitch,cmd_yaw_rate"


def read(path, **options):
    return read_log(path, check=False, **options)


def table(path: Path, header: str, *columns) -> Path:
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in zip(*columns))
    path.write_text(f"{header}\n{rows}\n")
    return path


# --- the form in memory -----------------------------------------------------------------------------


def test_a_log_that_contradicts_itself_is_refused():
    with pytest.raises(UserError, match=r"position has shape \(39, 3\), expected \(40, 3\)"):
        a_log(position=np.zeros((39, 3)))
    t = np.arange(40) / 100
    t[7] = t[6]
    with pytest.raises(UserError, match="time does not increase at row 7"):
        a_log(t=t)


@pytest.mark.parametrize("wrong", [3, None, object(), 1.5, b"x", [3], {}, int])
def test_arguments_that_are_not_logs_are_refused(wrong, tmp_path):
    good = tmp_path / "good.csv"
    write_log(good, a_log())
    for call in (
        lambda: read_log(wrong),
        lambda: check_log(wrong),
        lambda: write_log(tmp_path / "a.csv", wrong),
        lambda: diagnose(wrong, load_vehicle()),
        lambda: identify(wrong, load_vehicle()),
        lambda: measure_gap(load_vehicle(), wrong),
        lambda: measure_gap(3, []),
        lambda: read_log(good, units=3),
        lambda: read_log(good, mapping=3),
    ):
        with pytest.raises(UserError):
            call()
    assert list(tmp_path.iterdir()) == [good]


def test_pieces_are_what_lies_between_holes():
    t = np.arange(40) / 100
    t[20:] += 0.5
    log = a_log(t=t)
    assert [len(piece) for piece in log.pieces()] == [20, 20]
    assert [piece.t[0] for piece in log.pieces()] == [t[0], t[20]]
    assert log.pieces(shortest=0.3) == ()


@given(rate=st.sampled_from([20.0, 50.0, 73.0, 100.0, 250.0]), seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_resampling_interpolates_measurements_and_holds_commands(rate, seed):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.004, 0.016, 40))
    line = np.stack([t, 2 * t, -t], axis=1)
    log = a_log(t=t, position=line, contact=np.arange(40) >= 20)
    even = log.resampled(rate)
    assert np.allclose(np.diff(even.t), 1 / rate) and even.t[0] == t[0] and even.t[-1] <= t[-1]
    assert np.allclose(even.position[:, 1], 2 * even.t)  # a straight line survives
    for time, command, contact in zip(even.t, even.command, even.contact):
        sent = np.flatnonzero(t <= time + 1e-9)[-1]
        assert np.array_equal(command, log.command[sent]) and contact == log.contact[sent]


# --- CSV --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_what_is_written_comes_back(tmp_path, suffix):
    m = 40
    log = a_log(
        m,
        voltage=np.linspace(4.1, 3.6, m),
        contact=np.arange(m) > 30,
    )
    write_log(tmp_path / f"a{suffix}", log)
    back = read(tmp_path / f"a{suffix}")
    assert back.name == "a" and back.notes == ()
    for field in ("t", "position", "attitude", "command", "voltage"):
        assert np.allclose(getattr(back, field), getattr(log, field), atol=1e-12), field
    assert np.array_equal(back.contact, log.contact)


def test_a_row_of_units_or_the_option_says_degrees(tmp_path):
    log = a_log()
    tilt = np.degrees(log.attitude[:, 0])
    columns = [log.t, *log.position.T, tilt, *log.attitude[:, 1:].T, *log.command.T]
    path = table(tmp_path / "option.csv", HEADER, *columns)
    assert np.allclose(read(path, units={"roll": "deg"}).attitude, log.attitude)
    columns[0] = 1e3 * log.t
    path = table(tmp_path / "row.csv", f"{HEADER}\nms,m,m,m,deg,rad,rad,PWM,rad,rad,rad/s", *columns)
    back = read(path)
    assert np.allclose(back.attitude, log.attitude) and np.allclose(back.t, log.t)
    with pytest.raises(UserError, match="unit 'furlong' of column x is unknown; choose from m, cm, mm"):
        read(path, units={"x": "furlong"})


def test_a_commanded_yaw_angle_is_not_made_into_a_rate(tmp_path):
    log = a_log()
    header = HEADER.replace("cmd_yaw_rate", "cmd_yaw")
    path = table(tmp_path / "a.csv", header, log.t, *log.position.T, *log.attitude.T, *log.command.T)
    back = read(path)
    assert np.isnan(back.command[:, 3]).all() and "there is no yaw rate command" in back.notes[0]


def test_quaternions_become_roll_pitch_and_yaw(tmp_path):
    log = a_log()
    roll, pitch, yaw = log.attitude.T
    rotation = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1))
    header = HEADER.replace("roll,pitch,yaw,", "qw,qx,qy,qz,", 1)
    quaternion = rotation.as_quat(scalar_first=True)
    path = table(tmp_path / "a.csv", header, log.t, *log.position.T, *quaternion.T, *log.command.T)
    assert np.allclose(read(path).attitude, log.attitude)
    path = table(tmp_path / "b.csv", header, log.t, *log.position.T, *(2 * quaternion).T, *log.command.T)
    with pytest.raises(UserError, match="length 2 instead of 1"):
        read(path)


def test_zyx_angles_are_converted_as_rotations(tmp_path):
    """A mapping with euler = "ZYX": the same rotation matrix, in attitude and in commands."""
    attitude = np.random.default_rng(2).uniform(-0.9, 0.9, (40, 3))
    sent = np.roll(attitude[:, :2], -1, axis=0)  # a row before
    log = a_log(attitude=attitude, command=np.c_[np.full(40, 4e4), sent, np.zeros(40)])
    mapping = tmp_path / "m.toml"
    mapping.write_text('inherit = "documented"\neuler = "ZYX"\n')
    write_log(tmp_path / "a.csv", log)
    back = read(tmp_path / "a.csv", mapping=mapping)
    roll, pitch, yaw = log.attitude.T
    written = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    roll, pitch, yaw = back.attitude.T
    found = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1)).as_matrix()
    assert np.allclose(found, written)
    # A vehicle that does as it is told is told what it does, in this convention as in the other.
    assert np.allclose(back.command[:-1, 1:3], back.attitude[1:, :2])


def test_empty_cells_are_bridged_briefly_and_dropped_beyond(tmp_path):
    log = a_log(position=np.tile(np.arange(40.0)[:, None], (1, 3)))
    rows = [HEADER + ",vbat"]
    for i in range(40):
        cells = [log.t[i], *log.position[i], *log.attitude[i], *log.command[i]]
        cells = [repr(float(cell)) for cell in cells] + [f"{4 - 0.01 * i}" if i % 10 == 0 or i == 39 else ""]
        if i == 5:
            cells[4] = "nan"  # roll
        if 15 <= i < 30:
            cells[2] = ""  # y
        if i % 2:
            cells[8] = ""  # cmd_roll, sent every second row
        rows.append(",".join(cells))
    (tmp_path / "a.csv").write_text("\n".join(rows))
    log = read(tmp_path / "a.csv")
    assert len(log) == 25 and log.gap_starts.tolist() == [14]
    assert any("y (y) is empty or not a number in 15 of 40 rows" in note for note in log.notes)
    assert any("15 rows inside the flight lack part of the pose" in note for note in log.notes)
    assert np.array_equal(log.command[1:15:2, 1], log.command[0:14:2, 1])  # held
    assert np.allclose(log.voltage[:15], 4 - 0.01 * np.arange(15))  # 10 Hz, interpolated


A_ROW, POSE = "0,0,0,0,0,1", "t,x,y,z,roll,cmd_thrust_pwm"
PX4 = b"ULog\x01\x12\x35\x01" + bytes(99)
REFUSED = [  # file, its content, what is said
    ("a.csv", "", "empty; expected a line of column names"),
    ("a.csv", "0,1,2\n0.1,1,2\n", "the first line contains numbers"),
    ("a.csv", f"{HEADER}\n", "a header and no rows|no time column"),
    ("a.csv", "t,roll,pitch,yaw,cmd_thrust_pwm\n0,0,0,0,1\n1,0,0,0,1\n", "match no known log format"),
    ("a.csv", f"{POSE}\n0,0,0,,0,1\n1,0,0,,0,1\n", "no position column z"),
    ("a.csv", "t,x,y,z,cmd_thrust_pwm\n0,0,0,0,1\n1,0,0,0,1\n", "no attitude column roll, pitch, yaw"),
    ("a.csv", "t,x,y,z,roll\n0,0,0,0,0\n1,0,0,0,0\n", "no thrust command column cmd_thrust_pwm"),
    ("a.csv", f"{POSE}\n{A_ROW}\n1,o,0,0,0,1\n2,0,0,0,0,1\n", "line 3, column x: 'o' is not"),
    ("a.csv", f"{POSE}\n{A_ROW}\n1,0,0,0,True,1\n2,0,0,0,0,1\n", "line 3, column roll: 'True' is not"),
    ("a.csv", "t,x,x,z\n0,0,0,0\n", "column x appears twice"),
    ("a.csv", "t,x,y,z\n0,0,0,0\n0,0,0,0,0,0\n", "rows of different length"),
    ("a.csv", "t,x,y\n0,0,0,1,0,2\n", "rows of different length"),
    ("a.csv", f"{POSE}\n{A_ROW}\n2,0,0,0,0,1\n1,0,0,0,0,1\n",
     "column t goes back from 2 to 1 s in row 3 of the data: correct that row"),
    ("a.csv", f"{POSE}\n" + "0,0,0,0,0,1\n1,0,0,0,0,1\n2,0,0,0,0,1\n" * 2,
     "column t goes back from 2 to 0 s in row 4 of the data: .* cut the file"),
    ("a.csv", f"{POSE}\n{A_ROW}\n,0,0,0,0,1\n", "column t is not a number in row 2"),
    ("a.csv", f"{POSE}\n{A_ROW}\n1,0,0,0,12,1\n", "column roll .* look like degrees"),
    ("a.csv", "t,x,y,z,roll,yaw,cmd_thrust_pwm\n0,0,0,0,0,179,1\n1,0,0,0,0,-179,1\n", "column yaw .* deg"),
    ("a.csv", f"{POSE} [N]\n{A_ROW}\n1,0,0,0,0,1\n", "full = 0.6"),
    ("a.csv", f"t,x,y,z,q.0,cmd_thrust_pwm\n{A_ROW}\n1,0,0,0,0,1\n", 'for example qw = "q.3"'),
    ("a.csv", None, r"a\.csv: no such flight log"),
    ("a.csv.gz", gzip.compress(HEADER.encode() * 99, mtime=0)[:40], "not a readable text table"),
    ("a.csv", bytes(range(128, 256)), "not a readable text table"),
    ("a.ulg", PX4, "`ulog2csv a.ulg`"),
    ("a.csv", PX4, "a log of PX4"),
    ("a.BIN", b"\xa3\x95\x80\x80" + bytes(99), "mavlogdump.py"),
    ("a.bbl", b"H Product:Blackbox flight data recorder\n", "blackbox_decode"),
    ("a.xlsx", b"PK\x03\x04" + bytes(99), "a spreadsheet: save it as CSV"),
    ("a.parquet", b"PAR1" + bytes(99), r"read_parquet\(.*a.parquet'\).to_csv"),
    ("a.npz", b"PK\x03\x04" + bytes(99), r"numpy.load\(.*a.npz'\)"),
    ("a.pkl", b"\x80\x04\x95" + bytes(99), "a pickle, which is not opened"),
    ("a.csv", "<!DOCTYPE html>", "a web page"),
    ("a.csv", "version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    ("log07", bytes(4096), "only zero bytes"),
    ("no.bag", b"#ROSBAG V9.9\n", "not a readable bag"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "words"), REFUSED)
def test_a_file_that_is_not_a_log_is_refused_with_a_remedy(tmp_path, capsys, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(UserError, match=words) as caught:
        read_log(path)
    assert str(path) in str(caught.value)
    assert main(["logs", str(path)]) == 2 and capsys.readouterr().err.count("\n") == 1


def written(folder: Path, log: FlightLog) -> str:
    write_log(folder / "good.csv", log)
    return (folder / "good.csv").read_text()


def semicolons(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


def thousands(text: str) -> str:
    """Thrust as 37,721.880; the numbers have three places behind the point, in quotes."""
    return re.sub(r"\b(\d\d)(\d{3}\.\d+)", r'"\1,\2"', text)


HABITS = {
    "decimal comma": semicolons,
    "decimal comma and tabs": lambda text: text.replace(",", "\t").replace(".", ","),
    "decimal comma in quotes": lambda text: re.sub(r"(-?\d+)\.([\d]+)", r'"\1,\2"', text),
    "decimal comma under units": lambda text: semicolons(
        text.replace("\n", "\ns,m,m,m,rad,rad,rad,PWM,rad,rad,rad/s\n", 1)
    ),
    "thousands separators": thousands,
    "first line of a spreadsheet": lambda text: "sep=;\r\n" + text.replace(",", ";").replace("\n", "\r\n"),
    "comments above": lambda text: "# a, b\n#\n\n" + text,
    "comments among the rows": lambda text: text.replace("\n", "\n# mark, 1\n", 3),
    "a title": lambda text: "Flight of 3 March\nvehicle,seven\n\n" + text,
    "header of numpy.savetxt": lambda text: "# " + text,
    "blanks": lambda text: "# " + text.replace(",", " "),
    "bars": lambda text: text.replace(",", "|"),
    "a header twice": lambda text: text + text.partition("\n")[0] + "\n",
    "Latin-1": lambda text: re.sub("\n", ",é\n", text).replace("é", "Höhe", 1).encode("latin-1"),
    "zeros at the end": lambda text: text.encode() + bytes(5000),
    "a note in one row": lambda text: re.sub(r"(?m)^0\.2,.*", r"\g<0>,mark", text).replace(
        "\n", ",note\n", 1
    ),
    "a velocity": lambda text: re.sub("\n", ",slow\n", text).replace("slow", "vx", 1),
    "upper case": lambda text: text.replace(text.partition("\n")[0], text.partition("\n")[0].upper()),
    "units in the names": lambda text: text.replace("t,x,", "t [s],x (m),", 1).replace(
        "roll,", "roll_rad,", 1
    ),
    "units with a gap": lambda text: text.replace("\n", "\ns,m,m,m,rad,rad,rad,,rad,rad,\n", 1),
    "packed with another name": lambda text: gzip.compress(text.encode(), mtime=0),
    "xz": lambda text: lzma.compress(text.encode()),
    "bzip2": lambda text: bz2.compress(text.encode()),
}


@pytest.mark.parametrize("habit", HABITS)
def test_tables_as_programs_and_people_write_them(tmp_path, habit):
    log = a_log()
    made = HABITS[habit](written(tmp_path, log))
    (tmp_path / "a.csv").write_bytes(made if isinstance(made, bytes) else made.encode())
    back = read(tmp_path / "a.csv")
    assert len(back) == len(log)
    for key in ("t", "position", "attitude", "command"):
        # pandas' fast parser is exact to the last bit or two.
        assert np.allclose(getattr(back, key), getattr(log, key), rtol=1e-12, atol=1e-12), key


def test_a_zip_file_of_one_table_is_read_and_of_several_is_not(tmp_path):
    text = written(tmp_path, a_log())
    for count in (1, 2):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            for k in range(count):
                archive.writestr(f"{k}.csv", text)
        if count == 1:
            assert len(read(tmp_path / "a.zip")) == 40
    with pytest.raises(UserError, match="contains 2 files; unpack it"):
        read(tmp_path / "a.zip")


@pytest.mark.parametrize(
    ("mark", "missing"), [("-", True), ("---", True), ("nan(ind)", True), ("\\N", True), ("o", False)]
)
def test_marks_of_missing_values_are_gaps_and_other_text_is_refused(tmp_path, mark, missing):
    text = re.sub(r"(?m)^0\.2,[^,]*", f"0.2,{mark.replace(chr(92), chr(92) * 2)}", written(tmp_path, a_log()))
    (tmp_path / "a.csv").write_text(text)
    if missing:
        assert len(read(tmp_path / "a.csv")) == 39
        return
    with pytest.raises(UserError, match=r"line 22, column x: 'o' is not a number"):
        read(tmp_path / "a.csv")


def test_what_cannot_be_read_and_is_not_needed_is_left_out(tmp_path):
    text = written(tmp_path, a_log(voltage=np.linspace(4.1, 3.6, 40)))
    (tmp_path / "a.csv").write_text(re.sub(r"(?m)^(0\.2,.*),[^,]*$", r"\1,flat", text))
    back = read(tmp_path / "a.csv")
    assert back.voltage is None
    assert "vbat is left out: line 22, column vbat: 'flat' is not a number" in back.notes


ENDS = {  # what follows the rows, and how many of the lines are no comments
    "a word": ("END\n", 1),
    "a sentence": ("landed, battery low\n", 1),
    "a line that is cut": ("0.4,1.0,2.0,-", 0),
    "sums without a name": (",0.1,0.2,0.3\n", 0),
    "sums": ("mean,0.1,0.2,0.3\nmax,1,1,1\n\n", 2),
}


@pytest.mark.parametrize("end", ENDS)
def test_words_and_sums_below_a_log_are_cut(tmp_path, end):
    log = a_log()
    text, count = ENDS[end]
    (tmp_path / "a.csv").write_text(written(tmp_path, log) + text)
    back = read(tmp_path / "a.csv")
    assert np.array_equal(back.t, log.t)
    assert count == 0 or any(f"the last {count} rows hold words" in note for note in back.notes)
    # More of them are no end, and a column of words is a column of words.
    (tmp_path / "a.csv").write_text(written(tmp_path, log) + "END\n" * 11)
    with pytest.raises(UserError, match="line 42, column t: 'END' is not a number"):
        read(tmp_path / "a.csv")


@pytest.mark.parametrize("word", ["True", "false"])
def test_a_word_among_numbers_is_none_and_of_a_flag_it_is_one(tmp_path, word):
    log = a_log(contact=np.arange(40) % 3 == 0)
    table = pandas.DataFrame(log_table(log))
    table["contact"] = table["contact"].map({0: "False", 1: "True"}).where(np.arange(40) != 5, "")
    table.to_csv(tmp_path / "a.csv", index=False)
    assert np.array_equal(np.delete(read(tmp_path / "a.csv").contact, 5), np.delete(log.contact, 5))
    table["roll"] = table["roll"].astype(object).where(np.arange(40) != 7, word)
    table.to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(UserError, match=f"line 9, column roll: '{word}' is not a number"):
        read(tmp_path / "a.csv")


CLOCKS = {  # name of the column, and its cells
    "time": lambda t: t,
    "Time [s]": lambda t: t,
    "tick": lambda t: np.round(1e3 * t),
    "timestamp": lambda t: np.round(1e6 * t),
    "Timestamp": lambda t: np.round(1e9 * (t + 1.7e9)),
    "t_ms": lambda t: np.round(1e3 * t),
    "us": lambda t: np.round(1e6 * t),
    "t": lambda t: np.round(1e3 * t),
    "tick of 32 bits": lambda t: np.round(1e6 * t - 2e5) % 2**32,
    "time of day": lambda t: [f"{h:02}:{m:02}:{s:09.6f}" for h, m, s in map(_of_day, t + 86399.8)],
    "date": lambda t: [f"2024-02-29T10:20:{s:09.6f}Z" for s in t],
    "header.stamp.secs,header.stamp.nsecs": lambda t: [
        f"{int(s + 99.8)},{round(1e9 * ((s + 99.8) % 1))}" for s in t
    ],
}


def _of_day(s: float) -> tuple[int, int, float]:
    s = round(s % 86400, 6)
    return int(s // 3600), int(s % 3600 // 60), s % 60


@pytest.mark.parametrize("kind", CLOCKS)
def test_time_by_other_names_and_in_other_units(tmp_path, kind):
    log = a_log()
    rows = written(tmp_path, log).splitlines()
    name = {"tick of 32 bits": "tick", "time of day": "time", "date": "t"}.get(kind, kind)
    lines = [name + rows[0][1:]]
    lines += [f"{cell},{row.partition(',')[2]}" for cell, row in zip(CLOCKS[kind](log.t), rows[1:])]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    back = read(tmp_path / "a.csv")
    # Nanoseconds since 1970 have 61 bits; a number has 53.
    assert np.allclose(back.t, log.t, atol=1e-6) and np.allclose(back.position, log.position)
    assert kind == "date" or any(word in " ".join(back.notes) for word in ("time is the column", "t = t_ms"))


def test_rows_in_order_of_arrival_are_sorted_and_two_flights_are_not(tmp_path):
    log = a_log(400)
    head, *rows = written(tmp_path, log).splitlines()

    def order(order) -> FlightLog:
        (tmp_path / "a.csv").write_text("\n".join([head, *(rows[k] for k in order)]) + "\n")
        return read(tmp_path / "a.csv")

    random = np.random.default_rng(0)
    for late in (0.02, 0.3):  # s that a row comes late at most
        back = order(np.argsort(log.t + random.uniform(0.0, late, 400)))
        assert np.array_equal(back.t, log.t) and np.allclose(back.position, log.position)
        assert any("sorted by time" in note for note in back.notes)
    with pytest.raises(UserError, match="cut the file where the next flight begins"):
        order([*range(60), *range(400)])  # 0.6 s, then another recording
    with pytest.raises(UserError, match=r"and in \d+ more: correct that row, sort the rows by it"):
        order(random.permutation(400))


def test_log_blocks_that_share_a_table_are_each_in_order(tmp_path):
    log = a_log()
    pose, sent = HEADER.split(",")[1:7], HEADER.split(",")[7:]
    rows = [
        f"{t!r},{','.join(map(repr, map(float, [*p, *a])))},,,,"
        for t, p, a in zip(log.t.tolist(), log.position, log.attitude)
    ]
    rows += [
        f"{t!r},,,,,,,{','.join(map(repr, map(float, c)))}"
        for t, c in zip((log.t - 0.003).tolist(), log.command)
    ]
    (tmp_path / "a.csv").write_text("\n".join([",".join(["t", *pose, *sent]), *rows]) + "\n")
    back = read(tmp_path / "a.csv")
    assert np.allclose(back.position, log.position) and np.array_equal(back.command, log.command)


@pytest.mark.parametrize("folder", ["plain", "2024+wind", "a+b+c"])
def test_files_of_one_flight_are_joined_by_a_plus_wherever_they_are(tmp_path, folder):
    log = a_log()
    (tmp_path / folder).mkdir()
    pose, sent = tmp_path / folder / "pose.csv", tmp_path / folder / "sent+1.csv"
    table(pose, ",".join(HEADER.split(",")[:7]), log.t, *log.position.T, *log.attitude.T)
    table(sent, ",".join(["t", *HEADER.split(",")[7:]]), log.t, *log.command.T)
    assert np.array_equal(read(f"{pose}+{sent}").command, log.command)
    with pytest.raises(UserError, match=re.escape(f"{sent}x: no such flight log")):
        read(f"{pose}+{sent}x")


# --- several vehicles, instants, frames ---------------------------------------------------------------


def two_vehicles(shift: float) -> pandas.DataFrame:
    """The rows of two vehicles 1 m apart, the second `shift` seconds later."""
    t = np.arange(400) / 100
    log = a_log(400, position=np.stack([np.sin(t), np.cos(t), 1.0 + 0.1 * t], axis=1))
    one = log_table(log)
    other = one.assign(x=one["x"] + 1.0, t=one["t"] + shift)
    return pandas.concat([one.assign(id=7, body="cf 7"), other.assign(id=9, body="cf 9")])


@pytest.mark.parametrize("shift", [0.0, 0.001])
@pytest.mark.parametrize("column", ["id", "body"])
def test_one_of_several_vehicles_in_a_table_must_be_chosen(tmp_path, shift, column):
    table = two_vehicles(shift)[["t", "x", "y", "z", "roll", "pitch", "cmd_thrust_pwm", column]]
    chosen = {"id": 7, "body": "cf 7"}[column]
    for order in (["t"], [column]):  # row by row, and one after the other
        table.sort_values(order, kind="stable").to_csv(tmp_path / "a.csv", index=False)
        option = shlex.quote(f"{column}={chosen}")
        with pytest.raises(
            UserError, match=f"column {column} has 2 values .*; choose one with --where {option}"
        ):
            read(tmp_path / "a.csv")
        assert main(["logs", str(tmp_path / "a.csv"), "--where", f"{column}={chosen}"]) == 0
        (tmp_path / "m.toml").write_text(f"inherit = 'documented'\nwhere = {{ {column} = {chosen!r} }}\n")
        by_file = read(tmp_path / "a.csv", mapping=tmp_path / "m.toml")
        by_option = read(tmp_path / "a.csv", where={column: str(chosen)})
        assert np.array_equal(by_file.position, by_option.position)
        np.testing.assert_allclose(by_file.position[:, 0], np.sin(by_file.t), atol=1e-12)
    with pytest.raises(UserError, match=f"column {column} is never 8; choose from {chosen}"):
        read(tmp_path / "a.csv", where={column: "8"})
    with pytest.raises(UserError, match="no column vehicle to choose rows by; choose from"):
        read(tmp_path / "a.csv", where={"vehicle": "8"})


def test_modes_and_counters_of_one_vehicle_choose_nothing(tmp_path):
    t = np.arange(400) / 100
    table = log_table(a_log(400, position=np.stack([np.sin(t), np.cos(t), 1.0 + 0.1 * t], axis=1)))
    mode = np.where(np.sin(20.0 * t) > 0.0, "hover", "manual")
    table.assign(mode=mode, tick=np.arange(400) % 4, id=np.arange(400) // 10).to_csv(
        tmp_path / "a.csv", index=False
    )
    assert len(read(tmp_path / "a.csv")) == 400


@pytest.mark.parametrize(("change", "words"), [
    (lambda table: table.assign(t=np.floor(table["t"])),
     "396 of 400 rows .* a clock in steps of 1 s is too coarse"),
    (lambda table: two_vehicles(0.0).drop(columns=["id", "body"]).sort_values("t"), "several vehicles"),
    (lambda table: table.assign(t=np.arange(400)), r"t increases by exactly 1 per row.*--unit t='0\.01 s'"),
    (lambda table: table.rename(columns={"t": "time"}).assign(t=np.arange(400)), "omit it for time"),
])  # fmt: skip
def test_instants_that_repeat_and_frames_are_refused(tmp_path, change, words):
    log = a_log(400)
    change(log_table(log)).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(UserError, match=words):
        read(tmp_path / "a.csv")


def test_frames_are_read_with_their_unit_and_rows_that_stand_twice_once(tmp_path):
    log = a_log(400)
    log_table(log).assign(t=np.arange(400)).to_csv(tmp_path / "a.csv", index=False)
    np.testing.assert_allclose(read(tmp_path / "a.csv", units={"t": "0.01 s"}).t, log.t)
    table = log_table(log)
    pandas.concat([table, table]).sort_values("t").to_csv(tmp_path / "a.csv", index=False)
    assert np.array_equal(read(tmp_path / "a.csv").position, log.position)


# --- remedies ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("column", ["roll", "cmd_pitch"])
def test_angles_from_0_to_360_degrees_are_read_once_their_unit_is_stated(tmp_path, column):
    log = a_log()
    table = log_table(log)
    table[column] = np.degrees(table[column]) % 360.0
    table.to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(UserError, match="these look like degrees; state the unit"):
        read(tmp_path / "a.csv")
    back = read(tmp_path / "a.csv", units={column: "deg"})
    np.testing.assert_allclose(log_table(back)[column], log_table(log)[column], atol=1e-9)
    table[column] += 360.0
    table.to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(UserError, match=f"column {column} .* is its unit, deg, right?"):
        read(tmp_path / "a.csv", units={column: "deg"})


def test_events_of_another_recording_at_the_end_of_a_card_are_left_out(tmp_path):
    log = a_log()
    data = sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0})
    start = data.index(b"slow") + len(b"slow\0") + 2 + len(b"pm.state(f)\0")
    for shift in (-3.0, 200.0):  # s, of an earlier recording of 0.2 s
        other = sd_card(firmware_values(log), log.t[:20] + shift, 2, {"pm.state": 1.0})
        (tmp_path / "log").write_bytes(data[:-4] + other[start:-4] + bytes(4))
        back = read(tmp_path / "log")
        assert len(back) == 40 and np.allclose(back.position, log.position, atol=1e-5)
        assert any("the clock jumps from" in note for note in back.notes)


# --- mapping files ----------------------------------------------------------------------------------


def test_a_mapping_names_scales_turns_shifts_and_derives(tmp_path):
    mapping = tmp_path / "mine.toml"
    mapping.write_text(
        """
        notes = ["a note"]
        [columns]
        t = { column = "time", unit = "us" }
        x = "north"
        y = { column = "east", sign = -1 }
        z = { column = "down", sign = -1, unit = "cm", add = 0.5 }
        roll = "phi"
        pitch = ["absent", { column = "theta", sign = -1 }]
        cmd_thrust_pwm = { mean = ["m1", "m2"], late = 0.02 }
        """
    )
    t, sent, ones = np.arange(10) / 100, 4e4 + np.arange(10), np.ones(10)
    columns = [1e6 * t, t, 2 * t, 100 * t, 0.1 * ones, 0.2 * ones, sent, sent + 2]
    path = table(tmp_path / "a.csv", "time,north,east,down,phi,theta,m1,m2", *columns)
    log = read(path, mapping=mapping)
    assert np.allclose(log.position, np.stack([t, -2 * t, 0.5 - t], axis=1))
    assert np.allclose(log.attitude[:, :2], [0.1, -0.2])
    assert np.allclose(log.command[:8, 0], 4e4 + np.arange(2, 10) + 1)  # sent two rows earlier
    assert log.notes[0] == "a note"
    assert any("cmd_thrust_pwm is derived: the mean of m1, m2" in note for note in log.notes)
    assert any("dated 20 ms earlier" in note for note in log.notes)


MOTIVE = (("Type", "Rigid Body"), ("Name", "cf1"), ("ID", "A1"))  # lines 3 to 5 of a take


def test_names_in_other_lines_than_the_first(tmp_path):
    """Tables of motion capture, y up, beside a file of commands, and of pandas with two rows of names."""
    log = a_log()
    roll, pitch, yaw = log.attitude.T
    x, y, z = log.position.T
    upper = ["Format Version,1.23,Take Name,a", "", *(f",{k}" + f",{v}" * 6 for k, v in MOTIVE)]
    upper += [",,Rotation,Rotation,Rotation,Position,Position,Position", "Frame,Time (Seconds),X,Y,Z,X,Y,Z"]
    rows = zip(range(40), log.t, roll, yaw, -pitch, x, z, -y)
    take = "\n".join([*upper, *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n"
    (tmp_path / "take.csv").write_text(take)
    table(tmp_path / "sent.csv", ",".join(["t", *HEADER.split(",")[7:]]), log.t, *log.command.T)
    with pytest.raises(UserError, match=r"names are in lines 6, 7, .*: header = \[6, 7\]"):
        read(tmp_path / "take.csv")
    for lines, prefix, time in (([6, 7], "", ""), ([4, 6, 7], "cf1.", "t = 'Name.Time (Seconds)'\n")):
        turned = {"roll": ("X", 1), "yaw": ("Y", 1), "pitch": ("Z", -1)}
        named = {key: (f"{prefix}Rotation.{axis}", sign) for key, (axis, sign) in turned.items()}
        named |= {
            k: (f"{prefix}Position.{v}", s) for k, v, s in (("x", "X", 1), ("y", "Z", -1), ("z", "Y", 1))
        }
        columns = "".join(f"{k} = {{ column = '{v}', sign = {s} }}\n" for k, (v, s) in named.items())
        (tmp_path / "m.toml").write_text(
            f"inherit = 'documented'\nheader = {lines}\n[columns]\n{time}{columns}"
        )
        back = read(f"{tmp_path}/take.csv+{tmp_path}/sent.csv", mapping=tmp_path / "m.toml")
        for key in ("t", "position", "attitude", "command"):
            np.testing.assert_allclose(getattr(back, key), getattr(log, key), rtol=1e-12, atol=1e-12)
    (tmp_path / "m.toml").write_text("inherit = 'documented'\nheader = [6, 7]\n")
    with pytest.raises(UserError, match=r"header = \[6, 7\] names no column of the mapping, but Frame, Time"):
        read(tmp_path / "take.csv", mapping=tmp_path / "m.toml")

    head, _, rest = written(tmp_path, log).partition("\n")
    groups = ",".join("command" if name.startswith("cmd") else "state" for name in head.split(","))
    (tmp_path / "two.csv").write_text("\n".join([groups, head, rest]))
    with pytest.raises(UserError, match=r"column state appears twice; .*: header = \[2\]"):
        read(tmp_path / "two.csv")
    (tmp_path / "m.toml").write_text("inherit = 'documented'\nheader = [2]\n")
    assert np.array_equal(read(tmp_path / "two.csv", mapping=tmp_path / "m.toml").position, log.position)


GAINS = """inherit = "documented"
[attitude_pid]
kp = {kp}
ki = 0.0
roll = [{{ column = "cmd_roll" }}, {{ column = "cmd_yaw_rate" }}]
pitch = [{{ column = "cmd_pitch" }}, {{ column = "cmd_yaw_rate" }}]
"""


@pytest.mark.parametrize(("text", "words"), [
    ("header = [2, 1]\n[columns]\nz = 'z'", "header must list line numbers in their order"),
    ("[columns]\nheight = 'z'", r"\[columns\] height is not one of t, x"),
    ("[columns]\nz = { unit = 'm' }", r"\[columns\] z needs exactly one of column, mean, mean_square"),
    ("[columns]\nz = { column = 'z', unit = 's' }", "unit 's' of column z is unknown"),
    ("", r"no \[columns\]"),
    ("[columns]\ncmd_thrust_pwm = { mean_square = ['a', 'b'] }", "mean_square needs full"),
    ("[columns]\nx = { column = 'x', full = 2.0 }", "full is only for a thrust command or a request"),
    ("inherit = 'mine'", "inherit mine: choose from"),
    *((GAINS.format(kp=kp), r"column cmd_roll by \[attitude_pid\] \(roll\)") for kp in ("1e-300", "1e-10")),
])  # fmt: skip
def test_bad_mappings_are_refused_in_words(tmp_path, text, words):
    (tmp_path / "m.toml").write_text(text)
    write_log(tmp_path / "a.csv", a_log())
    with pytest.raises(UserError, match=words):
        read_log(tmp_path / "a.csv", mapping=tmp_path / "m.toml")
    with pytest.raises(UserError, match="neither a file nor one of arp_sysid"):
        read_log(tmp_path / "a.csv", mapping="no_such_mapping")


def test_a_documented_log_stays_one_whatever_an_imu_adds(tmp_path):
    """A format of accelerations alone, which is refused, has these columns too."""
    table = log_table(a_log()).assign(imu_ax=0.0, imu_az=9.8, imu_wz=0.0, m1_pwm=4e4)
    table.to_csv(tmp_path / "a.csv", index=False)
    np.testing.assert_allclose(read_log(tmp_path / "a.csv", check=False).position, a_log().position)
    table[["t", "imu_ax", "imu_az", "imu_wz", "m1_pwm"]].to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(UserError, match="no position and no attitude were logged"):
        read_log(tmp_path / "b.csv")


# --- Crazyflie: client CSV and micro-SD -------------------------------------------------------------


def assert_is(back: FlightLog, log: FlightLog, atol: float):
    assert np.allclose(back.t, log.t, atol=1e-6)
    assert np.allclose(back.position, log.position, atol=atol)
    assert np.allclose(back.attitude, log.attitude, atol=atol)
    assert np.allclose(back.command, log.command, rtol=1e-6, atol=atol)
    assert np.allclose(back.voltage, np.linspace(4.0, 3.7, len(log)), atol=1e-6)


def test_the_clients_log_blocks_make_one_flight(tmp_path):
    log = a_log()
    values = firmware_values(log)
    stamp = 7000 + 1e3 * log.t
    pose = [key for key in values if key.startswith("sta")]
    rest = [key for key in values if key not in pose]
    table(tmp_path / "pose.csv", ",".join(["Timestamp", *pose]), stamp, *(values[k] for k in pose))
    table(tmp_path / "commands.csv", ",".join(["Timestamp", *rest]), stamp, *(values[k] for k in rest))
    back = read(f"{tmp_path / 'pose.csv'}+{tmp_path / 'commands.csv'}")
    assert_is(back, log, atol=1e-9)
    assert read([tmp_path / "pose.csv", tmp_path / "commands.csv"]).name == "pose"


@pytest.mark.parametrize("version", [1, 2])
def test_micro_sd_logs(tmp_path, version):
    log = a_log()
    path = tmp_path / "log00"
    path.write_bytes(
        sd_card(firmware_values(log), log.t, version, {"pm.state": 1.0, "stateEstimate.x": 99.0})
    )
    back = read(path)
    assert_is(back, log, atol=1e-5)  # single precision, degrees
    assert back.notes == ()


@pytest.mark.parametrize("lost", [0, 4, 200])  # bytes before the zeros: the checksum, several events
def test_zeros_behind_a_micro_sd_log_are_not_part_of_it(tmp_path, lost):
    log = a_log()
    # An event of number 0 is what zeros look like.
    data = sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0}, number=0)
    (tmp_path / "log").write_bytes(data[: len(data) - lost] + bytes(5000))
    back = read(tmp_path / "log")
    assert np.allclose(back.position, log.position[: len(back)], atol=1e-5)
    assert len(back) > 35 and (len(back) == 40 or lost == 200)
    notes = " ".join(back.notes)
    assert "zero bytes and is read up to there" in notes and ("the checksum is wrong" in notes) == (lost > 0)


# --- bags -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ros", [1, 2])
def test_bags(tmp_path, ros):
    log = a_log()
    path = write_bag(tmp_path / ("a.bag" if ros == 1 else "a"), log, ros)
    back = read(path)
    assert np.allclose(back.t, log.t, atol=1e-6) and np.allclose(back.position, log.position)
    assert np.allclose(back.attitude, log.attitude)
    assert np.allclose(back.command, log.command)
    assert any("have no time stamp; the time of recording is used" in note for note in back.notes)


def test_bags_that_do_not_fit_are_refused_in_words(tmp_path):
    path = write_bag(tmp_path / "two", a_log(), 2, vehicles=("cf1", "cf2"))
    with pytest.raises(
        UserError, match=r"\*/pose matches /cf1/pose, /cf2/pose; a mapping file must name one"
    ):
        read(path)
    mapping = tmp_path / "m.toml"
    mapping.write_text("[columns]\nx = '/cf1/pose:pose.position.height'\n")
    with pytest.raises(UserError, match=r"field pose\.position\.height of topic /cf1/pose is not a number"):
        read(path, mapping=mapping)
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match=r"a ROS 2 bag is a folder with metadata\.yaml"):
        read(tmp_path / "folder")
    os.mkfifo(tmp_path / "folder" / "metadata.yaml")
    with pytest.raises(UserError, match=r"metadata\.yaml in it is not a regular file"):
        read(tmp_path / "folder")


def humble_bag(path: Path, log: FlightLog, *, status=None, defined=True, stamp=lambda t: t, lost=()) -> Path:
    """A ROS 2 bag with an array of poses, empty where `lost`, and a topic */status of some type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 stamp", "a/msg/Header"))
    store.register(get_types_from_msg("a/Header header\nfloat64 battery_voltage", "a/msg/Status"))
    make = {name.rpartition("/")[2]: kind for name, kind in store.types.items() if not name.startswith("a/")}
    mine = {name: kind for name, kind in store.types.items() if name.startswith("a/")}
    roll, pitch, yaw = log.attitude.T
    quaternion = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1)).as_quat()
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        topics = {}

        def put(topic: str, message, now: float) -> None:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], round(1e9 * now), store.serialize_cdr(message, kind))

        for i, now in enumerate(1000.0 + log.t):
            dated = round(1e9 * stamp(now))
            header = make["Header"](stamp=make["Time"](*divmod(dated, 10**9)), frame_id="")
            point, turn = make["Point"](*log.position[i]), make["Quaternion"](*quaternion[i])
            poses = [] if i in lost else [make["Pose"](position=point, orientation=turn)]
            put("/cf/poses", make["PoseArray"](header=header, poses=poses), now + 0.03)
            zero = make["Vector3"](0.0, 0.0, 0.0)
            put(
                "/cf/cmd",
                make["Twist"](linear=make["Vector3"](0.0, 0.0, log.command[i, 0]), angular=zero),
                now,
            )
            if status == "text":
                put("/cf/status", make["String"](data="flying"), now)
            elif status:
                header = mine["a/msg/Header"](stamp=1.0 + i)
                put("/cf/status", mine["a/msg/Status"](header=header, battery_voltage=4.0 - 0.01 * i), now)
    if not defined:
        with contextlib.closing(sqlite3.connect(next(path.glob("*.db3")))) as database:
            database.execute("delete from message_definitions")
            database.commit()
    return path


HUMBLE = """[columns]
cmd_thrust_pwm = "/cf/cmd:linear.z"
vbat = "*/status:battery_voltage"
""" + "\n".join(
    f'{name} = "/cf/poses:poses[0].{field}"'
    for name, field in {
        **{axis: f"position.{axis}" for axis in "xyz"},
        **{f"q{axis}": f"orientation.{axis}" for axis in "xyzw"},
    }.items()
)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        # A stamp that is no Time.
        ({"status": "own"}, "/cf/status have no time stamp; the time of recording is used"),
        ({"status": "own", "defined": False}, r"vbat is left out: .*\(a/msg/Status\) cannot be decoded"),
        ({"status": "text"}, "vbat is left out: field battery_voltage of topic /cf/status is not a number"),
        ({"lost": (7, 8, 30)}, "is empty or not a number in 3 of 40 rows"),
        (
            {"stamp": lambda t: t - 900.0},
            "time stamps of /cf/poses differ from the times of recording by 900 s",
        ),
        ({"stamp": lambda t: 0.0}, "/cf/poses have no time stamp"),
        ({"stamp": lambda t: t - 1001.0}, "/cf/poses have no time stamp"),  # negative
    ],
)
def test_bags_are_read_without_what_a_flight_can_do_without(tmp_path, options, words):
    log = a_log()
    path = humble_bag(tmp_path / "bag", log, **options)
    (tmp_path / "m.toml").write_text(HUMBLE)
    back = read(path, mapping=tmp_path / "m.toml")
    assert re.search(words, " ".join(back.notes))
    kept = np.delete(np.arange(40), options.get("lost", ()))
    assert np.allclose(back.position, log.position[kept])
