"""Readers of flight logs: what is written comes back, in this package's units and convention."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inclined_landing.eval.cli import main
from inclined_landing.eval.logs import FlightLog, read_log, write_log
from inclined_landing.eval.logs.mapping import shipped
from inclined_landing.models.errors import UserError
from tests import ROOT
from tests.log_files import a_log, firmware_values, sd_card, write_bag

DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured flights are not in {DATA}")

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
        velocity=np.random.default_rng(1).normal(size=(m, 3)),
        voltage=np.linspace(4.1, 3.6, m),
        contact=np.arange(m) > 30,
    )
    write_log(tmp_path / f"a{suffix}", log)
    back = read(tmp_path / f"a{suffix}")
    assert back.name == "a" and back.notes == ()
    for field in ("t", "position", "attitude", "command", "velocity", "voltage"):
        assert np.allclose(getattr(back, field), getattr(log, field), atol=1e-12), field
    assert np.array_equal(back.contact, log.contact)


def test_columns_that_were_not_logged_stay_away(tmp_path):
    log = a_log()
    log.command[:, 3] = np.nan
    write_log(tmp_path / "a.csv", log)
    back = read(tmp_path / "a.csv")
    assert back.missing == ("cmd_yaw_rate",)
    assert back.velocity is None and back.voltage is None and back.contact is None


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
    with pytest.raises(UserError, match="unit 'furlong' of column x is not known; one of m, cm, mm"):
        read(path, units={"x": "furlong"})


def test_a_commanded_yaw_angle_is_not_made_into_a_rate(tmp_path):
    log = a_log()
    header = HEADER.replace("cmd_yaw_rate", "cmd_yaw")
    path = table(tmp_path / "a.csv", header, log.t, *log.position.T, *log.attitude.T, *log.command.T)
    back = read(path)
    assert np.isnan(back.command[:, 3]).all() and "no yaw rate command was logged" in back.notes[0]


def test_quaternions_become_the_houses_angles(tmp_path):
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
    log = a_log(attitude=attitude, command=np.c_[np.full(40, 4e4), attitude[:, :2], np.zeros(40)])
    mapping = tmp_path / "m.toml"
    mapping.write_text('inherit = "documented"\neuler = "ZYX"\n')
    write_log(tmp_path / "a.csv", log)
    back = read(tmp_path / "a.csv", mapping=mapping)
    roll, pitch, yaw = log.attitude.T
    given = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    roll, pitch, yaw = back.attitude.T
    cx, sx, cy, sy, cz, sz = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    zero, one = np.zeros(40), np.ones(40)
    x = np.array([[one, zero, zero], [zero, cx, -sx], [zero, sx, cx]])
    y = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]])
    z = np.array([[cz, -sz, zero], [sz, cz, zero], [zero, zero, one]])
    assert np.allclose(np.einsum("ijm,jkm,klm->mil", z, x, y), given)
    # A vehicle that does as it is told is told what it does, in this convention as in the other.
    assert np.allclose(back.command[:, 1:3], back.attitude[:, :2])


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


BAD = {
    "nothing": ("", "empty; expected a line of column names"),
    "no header": ("0,1,2\n0.1,1,2\n", "the first line holds numbers"),
    "header only": (HEADER + "\n", "a header and no rows|no time column"),
    "no position": (
        "t,roll,pitch,yaw,cmd_thrust_pwm\n0,0,0,0,1\n1,0,0,0,1\n",
        "are those of no known kind of log",
    ),
    "no height": ("t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,,0,1\n1,0,0,,0,1\n", "no position column z"),
    "no attitude": ("t,x,y,z,cmd_thrust_pwm\n0,0,0,0,1\n1,0,0,0,1\n", "no attitude column roll, pitch, yaw"),
    "no thrust": ("t,x,y,z,roll\n0,0,0,0,0\n1,0,0,0,0\n", "no thrust command column cmd_thrust_pwm"),
    "text": (
        "t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,0,0,1\n1,o,0,0,0,1\n2,0,0,0,0,1\n",
        "line 3, column x: 'o' is not",
    ),
    "twice": ("t,x,x,z\n0,0,0,0\n", "column x appears twice"),
    "ragged": ("t,x,y,z\n0,0,0,0\n0,0,0,0,0,0\n", "rows of different length"),
    "time back": (
        "t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,0,0,1\n2,0,0,0,0,1\n1,0,0,0,0,1\n",
        "column t holds 2 s in row 2 of the data, between 0 and 1 s",
    ),
    "two flights": (
        "t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,0,0,1\n1,0,0,0,0,1\n2,0,0,0,0,1\n0,0,0,0,0,1\n1,0,0,0,0,1\n",
        "column t goes back from 2 to 0 s in row 4 of the data; are two flights in one file",
    ),
    "time nan": ("t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,0,0,1\n,0,0,0,0,1\n", "column t has no number in row 2"),
    "degrees": (
        "t,x,y,z,roll,cmd_thrust_pwm\n0,0,0,0,0,1\n1,0,0,0,12,1\n",
        "column roll .* look like degrees",
    ),
    "yaw degrees": (
        "t,x,y,z,roll,yaw,cmd_thrust_pwm\n0,0,0,0,0,179,1\n1,0,0,0,0,-179,1\n",
        "column yaw .* degrees",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_tables_are_refused_in_words(tmp_path, case, capsys):
    text, words = BAD[case]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=words) as caught:
        read_log(path)
    assert str(path) in str(caught.value)
    assert main(["logs", str(path)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_files_that_are_no_tables_are_refused_in_words(tmp_path):
    with pytest.raises(UserError, match=r"missing\.csv: no such flight log"):
        read_log(tmp_path / "missing.csv")
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(HEADER.encode() * 99)[:40])
    with pytest.raises(UserError, match=r"cut\.csv\.gz: not a readable text table"):
        read_log(tmp_path / "cut.csv.gz")
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)))
    with pytest.raises(UserError, match=r"binary\.csv: not a readable text table"):
        read_log(tmp_path / "binary.csv")


@given(data=st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_damage_to_a_table_is_answered_with_a_traceback(tmp_path, data):
    write_log(tmp_path / "a.csv", a_log(8))
    text = bytearray((tmp_path / "a.csv").read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(text) - 1))
        text[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    (tmp_path / "damaged.csv").write_bytes(bytes(text))
    try:
        read_log(tmp_path / "damaged.csv")
    except UserError as error:
        assert str(error)


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
    t = np.arange(10) / 100
    ones = np.ones(10)
    columns = [
        1e6 * t,
        t,
        2 * t,
        100 * t,
        0.1 * ones,
        0.2 * ones,
        4e4 + np.arange(10),
        4e4 + np.arange(10) + 2,
    ]
    path = table(tmp_path / "a.csv", "time,north,east,down,phi,theta,m1,m2", *columns)
    log = read(path, mapping=mapping)
    assert np.allclose(log.position, np.stack([t, -2 * t, 0.5 - t], axis=1))
    assert np.allclose(log.attitude[:, :2], [0.1, -0.2])
    assert np.allclose(log.command[:8, 0], 4e4 + np.arange(2, 10) + 1)  # sent two rows earlier
    assert log.notes[0] == "a note"
    assert any("cmd_thrust_pwm is derived: the mean of m1, m2" in note for note in log.notes)
    assert any("dated 20 ms earlier" in note for note in log.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1", "unknown entry 'x' in the file"),
        ("[columns]\nheight = 'z'", r"\[columns\] height is not one of t, x"),
        ("[columns]\nz = { unit = 'm' }", r"\[columns\] z needs exactly one of column, mean, sum"),
        ("[columns]\nz = { column = 'z', unit = 's' }", "unit 's' of column z is not known"),
        ("[columns]\nz = { column = 'z', sign = 2 }", "sign must be 1 or -1"),
        ("euler = 'XYZ'\n[columns]\nz = 'z'", "euler must be 'ZXY' or 'ZYX', not 'XYZ'"),
        ("[columns", "is not TOML"),
        ("", r"no \[columns\]"),
    ],
)
def test_bad_mappings_are_refused_in_words(tmp_path, text, words):
    (tmp_path / "m.toml").write_text(text)
    write_log(tmp_path / "a.csv", a_log())
    with pytest.raises(UserError, match=words):
        read_log(tmp_path / "a.csv", mapping=tmp_path / "m.toml")
    with pytest.raises(UserError, match="neither a file nor one of arp_sysid"):
        read_log(tmp_path / "a.csv", mapping="no_such_mapping")


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


@given(cut=st.integers(1, 3000), damage=st.integers(5, 3000))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_micro_sd_logs_are_read_as_far_as_they_go(tmp_path, cut, damage):
    log = a_log()
    data = sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0})
    path = tmp_path / "cut"
    path.write_bytes(data[: max(len(data) - cut, 1)])
    try:
        back = read(path)
    except UserError as error:
        assert str(path) in str(error)
    else:
        assert len(back) <= 40 and "the checksum is wrong" in " ".join(back.notes)
    path.write_bytes(data[: damage % len(data)] + b"\xa5" + data[damage % len(data) + 1 :])
    try:
        read(path)
    except UserError as error:
        assert str(error)


# --- bags -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ros", [1, 2])
def test_bags(tmp_path, ros):
    log = a_log()
    path = write_bag(tmp_path / ("a.bag" if ros == 1 else "a"), log, ros)
    back = read(path)
    assert np.allclose(back.t, log.t, atol=1e-6) and np.allclose(back.position, log.position)
    assert np.allclose(back.attitude, log.attitude)
    assert np.allclose(back.command, log.command)
    assert any("have no stamp: dated by when they were recorded" in note for note in back.notes)


def test_bags_that_do_not_fit_are_refused_in_words(tmp_path):
    path = write_bag(tmp_path / "two", a_log(), 2, vehicles=("cf1", "cf2"))
    with pytest.raises(UserError, match=r"\*/pose fits /cf1/pose, /cf2/pose; a mapping file must say which"):
        read(path)
    mapping = tmp_path / "m.toml"
    mapping.write_text("[columns]\nx = '/cf1/pose:pose.position.height'\n")
    with pytest.raises(UserError, match=r"topic /cf1/pose has no number pose\.position\.height"):
        read(path, mapping=mapping)
    (tmp_path / "no.bag").write_bytes(b"#ROSBAG V9.9\n")
    with pytest.raises(UserError, match=r"no\.bag: not a readable bag"):
        read(tmp_path / "no.bag")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match=r"a ROS 2 bag is a folder with metadata\.yaml"):
        read(tmp_path / "folder")


# --- measured flights -------------------------------------------------------------------------------


@needs_data
@pytest.mark.parametrize(
    ("folder", "missing"),
    [
        ("utias_fmpc", ("cmd_yaw_rate",)),
        ("nanobench", ("cmd_yaw_rate",)),
        ("crazypad", ("pitch", "cmd_roll", "cmd_pitch", "cmd_yaw_rate")),
    ],
)
def test_measured_flights_are_recognised_and_used(folder, missing):
    files = sorted((DATA / folder).glob("*.csv.gz"))[-3:]
    assert files
    for file in files:
        log = read_log(file)
        assert log.missing == missing and log.notes
        assert np.isfinite(log.position).all() and log.command[:, 0].max() > 3e4
        assert log.duration > 20


@needs_data
def test_a_flight_without_pose_is_refused_and_says_what_it_is_good_for(capsys):
    assert main(["logs", str(DATA / "arp_sysid" / "arp_log10a.csv.gz")]) == 2
    error = capsys.readouterr().err
    assert "no position and no attitude were logged" in error and "the motors' lag" in error


def test_every_shipped_mapping_says_what_it_is_for():
    assert set(shipped()) >= {"documented", "crazyflie", "crazyswarm2", "utias_fmpc", "nanobench", "crazypad"}
    assert all(column_map.description for column_map in shipped().values())
    # What was commanded in flights that are read by their rotor speeds otherwise: only when asked for.
    undetected = {name for name, column_map in shipped().items() if not column_map.detect}
    assert undetected == {"crazyflie_data_collection_command"}
