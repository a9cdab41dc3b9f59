"""Checks of flight logs: each mistake people make is found, named and decided upon."""

import dataclasses
import re

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

from inclined_landing.eval.cli import main
from inclined_landing.eval.logs import FlightLog, check_log, read_log, write_log
from inclined_landing.eval.logs.checks import check_fleet, enforce, hover_command
from inclined_landing.eval.logs.log import FIELDS, GAP_SECONDS
from inclined_landing.eval.logs.motion import standing
from inclined_landing.eval.logs.read import log_table
from inclined_landing.models.base.errors import UserError

ATTITUDE_LAG, THRUST_LAG = 0.08, 0.05  # s


def flight(
    seed=0, seconds=12.0, hover=42_000.0, heading=0.5, noise=1e-3, planar=False, level=False, name="flight"
) -> FlightLog:
    """An ordinary flight, 100 Hz: slow sines in each axis; tilt and thrust follow from the motion.

    1 mm and 0.3 deg of noise; commands are what attitude and thrust become ATTITUDE_LAG and THRUST_LAG
    later; voltage falls from 4.1 to 3.7 V.
    """
    random = np.random.default_rng(seed)
    t = np.arange(int(100 * seconds)) / 100

    def motion(at):
        phase = np.random.default_rng(seed + 1).uniform(0, 6, (3, 2))
        rate, size = np.array([1.1, 2.3]), np.array([[0.8, 0.25], [0.7, 0.2], [0.3, 0.1]])
        size[1] *= not planar
        size[2] *= 0.05 if level else 1.0
        angle = rate * at[:, None, None] + phase
        return (
            (size * np.sin(angle)).sum(-1) + [0, 0, 1],
            -(size * rate**2 * np.sin(angle)).sum(-1),
        )

    def attitude(at):
        """Roll and pitch of Rz(heading) Rx(roll) Ry(pitch) whose z axis is along the specific force."""
        force = motion(at)[1] + [0, 0, 9.81]
        x = np.cos(heading) * force[:, 0] + np.sin(heading) * force[:, 1]
        y = -np.sin(heading) * force[:, 0] + np.cos(heading) * force[:, 1]
        roll = np.arctan2(-y, force[:, 2])
        return roll, np.arctan2(x, np.hypot(y, force[:, 2])), np.linalg.norm(force, axis=1)

    position, _ = motion(t)
    roll, pitch, _ = attitude(t)
    roll_sent, pitch_sent, _ = attitude(t + ATTITUDE_LAG)
    pwm = hover * (attitude(t + THRUST_LAG)[2] / 9.81) ** 0.8
    return FlightLog(
        name=name,
        t=t,
        position=position + random.normal(0, noise, position.shape),
        attitude=np.stack([roll, pitch, np.full(len(t), heading)], axis=1)
        + random.normal(0, 0.005, (len(t), 3)),
        command=np.stack([pwm, roll_sent, pitch_sent, np.zeros(len(t))], axis=1),
        voltage=np.linspace(4.1, 3.7, len(t)),
    )


def change(log: FlightLog, **columns) -> FlightLog:
    """The flight with changed columns, by their names in the CSV."""
    table = log_table(log).assign(**columns)
    changed = {field: list(names) for field, names in FIELDS.items() if set(names) & set(columns)}
    return dataclasses.replace(log, **{f: table[names].to_numpy(float) for f, names in changed.items()})


def found(log: FlightLog, decision: str) -> list[str]:
    return [finding.text for finding in check_log(log) if finding.decision == decision]


@pytest.mark.parametrize("seed, heading", [(0, 0.0), (1, 2.5), (2, -1.0)])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 3e-3])
def test_nothing_is_wrong_with_an_ordinary_flight(seed, heading, noise):
    log = flight(seed, heading=heading, noise=noise)
    findings = check_log(log)
    assert {finding.decision for finding in findings} == {"info"}
    notes = " ".join(finding.text for finding in findings)
    # To a row and the noise: the estimate is in steps of 10 ms.
    assert any(f"attitude follows its command after {ms} ms" in notes for ms in (70, 80, 90)), notes
    assert any(f"thrust follows its command after {ms} ms" in notes for ms in (30, 40, 50, 60, 70)), notes
    assert enforce(log).notes == ()


def mistakes(log: FlightLog) -> dict[str, tuple[FlightLog, str]]:
    x, y, z = log.position.T
    roll, pitch, _ = log.attitude.T
    pwm, cmd_roll, cmd_pitch, _ = log.command.T
    holes = log.rows((np.arange(len(log)) // 80) % 2 == 0)
    jumping = log.position.copy()
    jumping[::30] += 1.0
    logs = {
        "half a second": (log.rows(log.t <= 0.5), "lasts only 0.5 s; at least 1 s"),
        "only holes": (holes, "7 gaps in time, the longest of 0.81 s .*; between them, no interval"),
        "lost tracking": (dataclasses.replace(log, position=jumping), "x, y, z jump in 39 of 1200 rows"),
        "millivolt": (dataclasses.replace(log, voltage=1e3 * log.voltage),
                      "vbat reaches 4100 V at t = 0.00 s: millivolt"),
    }  # fmt: skip
    columns = {
        "NaN": ({"roll": np.where(log.t > 5, np.nan, roll)}, "column roll is not a number in 699 rows"),
        "standing": ({"x": 0, "y": 0, "z": 0}, "x, y, z never change"),
        "millimetres": ({"x": 1e3 * x, "y": 1e3 * y, "z": 1e3 * z}, "wrong unit .millimetres"),
        "no attitude": ({"roll": 0, "pitch": 0}, "neither roll nor pitch ever changes"),
        "roll sign": ({"roll": -roll}, "roll and pitch mirror .* roll has the wrong sign"),
        "pitch sign": ({"pitch": -pitch}, "roll and pitch mirror .* pitch has the wrong sign"),
        "both signs": ({"roll": -roll, "pitch": -pitch}, "both signs are wrong, or the frames are turned"),
        "swapped": ({"roll": pitch, "pitch": roll}, "roll and pitch .*(swapped|mirror)"),
        "turned": ({"roll": pitch, "pitch": -roll}, "turned by .?90 deg .* columns are swapped and one sign"),
        "x and z swapped": ({"x": z, "z": x}, "x moves up and down with the thrust command"),
        "x and y swapped": ({"x": y, "y": x}, "roll and pitch mirror the horizontal acceleration"),
        "degrees": ({"roll": np.degrees(roll), "pitch": np.degrees(pitch)}, "degrees taken for radians"),
        "z down": ({"z": -z}, "z must point up"),
        "upside down": ({"roll": roll + np.pi}, "upside down in most of the rows"),
        "command roll sign": ({"cmd_roll": -cmd_roll}, "cmd_roll has the wrong sign"),
        "thrust and roll swapped": ({"cmd_thrust_pwm": cmd_roll, "cmd_roll": pwm}, "cmd_thrust_pwm holds -"),
        "commands swapped": ({"cmd_roll": cmd_pitch, "cmd_pitch": cmd_roll}, "cmd_roll and cmd_pitch mirror"),
        "command degrees": ({"cmd_roll": np.degrees(cmd_roll), "cmd_pitch": np.degrees(cmd_pitch)},
                            "column cmd_roll reaches .* degrees"),
        "rate degrees": ({"cmd_yaw_rate": 30 * np.sin(log.t)}, "cmd_yaw_rate reaches 30 rad/s .*: degrees/s"),
        "too much PWM": ({"cmd_thrust_pwm": pwm * 1.6}, "cmd_thrust_pwm holds .*, but PWM is 0 to 65535"),
        "fraction": ({"cmd_thrust_pwm": pwm / 65535}, r"a fraction\? State its unit"),
        "newton": ({"cmd_thrust_pwm": pwm / 65535 * 0.6}, "newton, gram or m/s2 need a mapping file"),
        "millinewton": ({"cmd_thrust_pwm": pwm / 110}, "full = 0.6"),
        "constant thrust": ({"cmd_thrust_pwm": 42_000}, "cmd_thrust_pwm is always 42000"),
        "on the ground": ({"cmd_thrust_pwm": pwm / 10}, "never exceeds .* this is not a flight"),
    }  # fmt: skip
    return logs | {name: (change(log, **changed), words) for name, (changed, words) in columns.items()}


@pytest.mark.parametrize("mistake", mistakes(flight()))
def test_mistakes_are_refused_in_words(mistake, tmp_path, capsys):
    log, words = mistakes(flight())[mistake]
    with pytest.raises(UserError, match=words):
        enforce(log)
    if mistake == "half a second":
        write_log(tmp_path / "bad.csv", log)
        assert main(["logs", str(tmp_path / "bad.csv")]) == 2
        captured = capsys.readouterr()
        assert "bad.csv: lasts only 0.5 s" in captured.err and captured.err.count("\n") == 1


def test_limits_are_noted_and_what_cannot_be_believed_is_left_out():
    log = flight()
    cases = {
        "vbat is always 3.8 V": dataclasses.replace(log, voltage=np.full(len(log), 3.8)),
        "not logged: cmd_yaw_rate": change(log, cmd_yaw_rate=np.nan),
        "1 gap in time, the longest of 0.52 s": log.rows(np.abs(log.t - 6) > 0.255),
        "column cmd_roll is always 0": change(log, cmd_roll=0),
        "hovers at 32 % of the full command": change(log, cmd_thrust_pwm=log.command[:, 0] / 2),
        "saturated": change(log, cmd_thrust_pwm=np.minimum(log.command[:, 0] * 1.5, 65535)),
        "lasts only 3 s": log.rows(log.t <= 3),
        "only 10 rows per second": log.rows(slice(None, None, 10)),
    }
    for words, changed in cases.items():
        used = enforce(changed)
        assert any(words in note for note in used.notes), (words, used.notes)
        assert (used.voltage is None) == words.startswith("vbat")


IMPOSSIBLE = {"x": 500.0, "z": -1e5, "roll": 500.0, "yaw": 500.0, "cmd_roll": 3.0, "cmd_thrust_pwm": -1e5}
IMPOSSIBLE |= {"vbat": 500.0, "cmd_yaw_rate": 1e3}


@pytest.mark.parametrize("column", IMPOSSIBLE)
def test_a_lone_impossible_value_is_named_and_left_out(column, tmp_path):
    """It decides nothing about the unit of its column, and all else is as without it."""
    path, log = tmp_path / "a.csv", flight()
    write_log(path, log)
    table = pandas.read_csv(path)
    table.loc[[300, 700], column] = IMPOSSIBLE[column]
    table.to_csv(path, index=False)
    used = read_log(path)
    words = f"column {column} ({column}) holds {IMPOSSIBLE[column]:.4g}, which is impossible in flight"
    assert f"{words}, in 2 rows, first in row 301 of the data (t = 3 s): left out" in used.notes
    others = [note for note in used.notes if column not in note and "different clocks" not in note]
    assert others == [] and len(used) == len(log) - 2 * (column == "x")
    near = np.isin(log.t, used.t)
    assert np.abs(used.position - log.position[near]).max() < 0.01
    assert np.abs(used.attitude - log.attitude[near]).max() < 0.05
    np.testing.assert_allclose(used.voltage, log.voltage[near], rtol=0, atol=1e-9)


def test_a_stretch_far_away_was_not_measured_and_says_nothing_about_the_unit():
    log = flight()
    position = log.position.copy()
    position[300:340, 0] += 500.0
    refused = found(dataclasses.replace(log, position=position), "refuse")
    assert len(refused) == 1 and "500 m from the flight in" in refused[0]
    assert "(t = 3.0" in refused[0] and "unit" not in refused[0]


def with_rotor_speeds(log: FlightLog) -> FlightLog:
    """The flight with four rotors that turn 1000 rad/s at the mean thrust command, M2 by 8 % faster."""
    speed = 1000.0 * np.sqrt(log.command[:, 0] / log.command[:, 0].mean())
    return dataclasses.replace(log, rotor_speed=speed[:, None] * [1.0, 1.08, 1.001, 0.999])


@pytest.mark.parametrize(("rotor", "factor", "since"), [(2, 0.54, 0.0), (0, 0.0, 9.0), (3, 2.0, 5.0)])
def test_a_rotor_speed_sensor_that_fails_is_named(rotor, factor, since):
    log = with_rotor_speeds(flight())
    log.rotor_speed[log.t >= since, rotor] *= factor
    (text,) = [text for text in found(log, "limit") if "rotor speed" in text]
    # 12 s of flight: the sensor contradicts the others from `since` on, to the percent that is printed.
    assert f"M{rotor + 1}" in text and f"in {100 * (1 - since / 12):.0f} % of the rows" in text
    assert "wrong then" not in text
    (text,) = [
        text for text in found(dataclasses.replace(log, thrust_is_measured=True), "limit") if "M" in text
    ]
    assert text.endswith("Thrust by rotor speeds is wrong then")
    measured = dataclasses.replace(log, thrust_is_measured=True)
    assert any(text in note for note in enforce(measured).notes)
    # Thrust that is wrong makes no other vehicle.
    assert np.isnan(hover_command(measured)) and np.isfinite(hover_command(log))


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_rotors_that_differ_as_much_as_vehicles_fly_are_believed(factor):
    # 1.4: a rotor that gives half the thrust of the others per speed squared. 0.5 s: a manoeuvre.
    log = with_rotor_speeds(flight())
    log.rotor_speed[:, 2] *= factor
    log.rotor_speed[log.t < 0.5, 0] *= 0.1
    standing = dataclasses.replace(log, rotor_speed=np.where(log.t[:, None] < 2.0, 0.0, log.rotor_speed))
    for each in (log, standing):
        assert not [text for text in found(each, "limit") if "rotor speed" in text]


def test_jumps_of_the_position():
    log = flight()
    position = log.position.copy()
    position[[300, 700]] += 0.5
    used = enforce(dataclasses.replace(log, position=position))
    assert len(used) == len(log) - 2
    assert "jumps away and back in 2 rows, first in row 301 (t = 3.00 s)" in used.notes[0]
    position = log.position.copy()
    position[500:, 0] += 0.2
    used = enforce(dataclasses.replace(log, position=position))
    assert "jumps for good once at t = 5.00 s" in used.notes[0]
    before, after = used.pieces()
    assert before.t[-1] < 5.0 < after.t[0] and len(used) > len(log) - 20


@pytest.mark.parametrize("late", [-0.3, 0.15])
def test_commands_on_another_clock_are_noticed(late):
    """Attitude follows its command after 80 ms: dated 150 ms late, the command follows it."""
    log = flight()
    rows = round(100 * abs(late))
    command = np.roll(log.command, rows if late > 0 else -rows, axis=0)
    words = " ".join(enforce(dataclasses.replace(log, command=command).rows(slice(40, -40))).notes)
    if late > 0:
        assert "attitude leads its command by 70 ms: the commands are stamped too late" in words
    else:
        assert "attitude follows its command after 380 ms" in words and "stamped too early" in words


def test_flights_of_two_vehicles():
    one = [flight(seed, hover=42_000 + 300 * seed, name=f"a{seed}") for seed in range(3)]
    other = [flight(seed, hover=50_000 - 300 * seed, name=f"b{seed}") for seed in range(2)]
    assert check_fleet(one) == () and check_fleet(one[:1]) == () and check_fleet([]) == ()
    (mixed,) = check_fleet([*one, *other])
    assert mixed.decision == "refuse"
    assert "different vehicles are mixed: a0, a1, a2 hover at" in mixed.text and "b1, b0 at" in mixed.text
    (unlike,) = check_fleet([one[0], flight(5, hover=45_500, name="c")])
    assert unlike.decision == "limit" and "are they of one vehicle with one load?" in unlike.text


def test_a_battery_that_empties_makes_no_other_vehicle():
    """Thrust follows command times voltage: what hovers at 42 000 at 4 V takes 46 700 at 3.6 V."""

    def at(volts, hover):
        log = flight(hover=hover * 4.0 / volts, name=f"{volts:g} V")
        return dataclasses.replace(log, voltage=np.full(len(log), volts))

    full, empty, other = at(4.2, 42_000), at(3.6, 42_000), at(3.6, 48_000)
    assert check_fleet([full, empty]) == ()
    (mixed,) = check_fleet([dataclasses.replace(log, voltage=None) for log in (full, empty)])
    assert mixed.decision == "refuse" and mixed.text.endswith("PWM")
    (mixed,) = check_fleet([full, empty, dataclasses.replace(other, name="other")])
    assert mixed.decision == "refuse" and re.search(r"other at \d+ PWM at 4 V$", mixed.text)


def on_the_floor(log: FlightLog, rows: slice) -> FlightLog:
    """The flight, standing still at a third of its command in some rows; noise as it was."""
    position, attitude, command = log.position.copy(), log.attitude.copy(), log.command.copy()
    position[rows] = np.random.default_rng(2).normal([0, 0, position[:, 2].min()], 1e-3, position[rows].shape)
    attitude[rows, :2] = np.random.default_rng(3).normal(0.02, 0.005, attitude[rows, :2].shape)
    command[rows] = [14_000.0, 0.0, 0.0, 0.0]
    return dataclasses.replace(log, position=position, attitude=attitude, command=command)


@pytest.mark.parametrize("seed", range(5))
def test_flights_that_hold_their_height_are_judged(seed):
    """All rows within 6 cm of height; 3 % is what the force's 0.8th power leaves of a line."""
    held = flight(seed, level=True)
    assert np.ptp(held.position[:, 2]) < 0.06
    assert hover_command(held) == pytest.approx(42_000, rel=0.03)
    assert np.isnan(hover_command(on_the_floor(held, slice(None))))
    # What climbs is judged above the floor alone.
    landed = on_the_floor(flight(seed), slice(0, 400))
    assert hover_command(landed) == pytest.approx(42_000, rel=0.03)
    (mixed,) = check_fleet([held, flight(seed + 1, level=True), flight(seed, hover=55_000, level=True)])
    assert mixed.decision == "refuse" and "different vehicles are mixed" in mixed.text


@pytest.mark.parametrize("seconds, pwm", [(3, 12_000.0), (3, np.linspace(0.0, 33_000.0, 300)), (1, 28_000.0)])
@pytest.mark.parametrize("begin", [0, 500, 900])
def test_motors_that_run_on_the_floor_are_no_flight(begin, seconds, pwm):
    """A vehicle that stands drifts by noise alone; the edges are blurred by half the smoothing, 0.25 s."""
    log, rows = flight(), slice(begin, begin + 100 * seconds)
    log = on_the_floor(log, rows)
    log.command[rows, 0] = pwm
    first, last = log.position[rows][0], log.position[rows][-1]
    log.position[: rows.start] += first - log.position[max(rows.start - 1, 0)]
    log.position[rows.stop :] += last - log.position[min(rows.stop, len(log) - 1)]
    stood = np.flatnonzero(standing(log))
    assert rows.start - 25 <= stood[0] <= rows.start + 25 and rows.stop - 25 <= stood[-1] < rows.stop + 25
    assert len(stood) == stood[-1] - stood[0] + 1
    assert any("with its motors running" in text for text in found(log, "info"))


@pytest.mark.parametrize("level", [True, False])
def test_a_hover_is_not_taken_for_standing(level):
    """As still as the noise lets one see, at nearly the command that it flies with."""
    for share in (0.85, 1.15):
        log = flight(level=level)
        log.position[400:900], log.command[400:900, 0] = log.position[400], share * 42_000
        assert not standing(log).any()
    assert not standing(flight(level=level)).any()


@pytest.mark.parametrize(
    "named, order", [(("qw", "qx", "qy", "qz"), "xyzw"), (("qx", "qy", "qz", "qw"), "wxyz")]
)
@pytest.mark.parametrize("heading", [0.0, -0.2, 1.5])
def test_a_quaternion_in_another_order_is_refused(named, order, heading, tmp_path):
    log = flight(heading=heading)
    w_first = Rotation.from_euler("ZXY", log.attitude[:, [2, 0, 1]]).as_quat(scalar_first=True)
    right, wrong = tmp_path / "right.csv", tmp_path / "wrong.csv"
    table = log_table(log).drop(columns=["roll", "pitch", "yaw", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"])
    table.assign(**dict(zip(("qw", "qx", "qy", "qz"), w_first.T))).to_csv(right, index=False)
    numbers = w_first if order == "wxyz" else w_first[:, [1, 2, 3, 0]]
    table.assign(**dict(zip(named, numbers.T))).to_csv(wrong, index=False)
    assert not any("order" in note for note in read_log(right).notes)
    with pytest.raises(UserError, match=r"numbers lie in the order|upside down .* order of the quaternion"):
        read_log(wrong)


POSE = ["x", "y", "z", "roll", "pitch", "yaw"]


def written(path, table: pandas.DataFrame) -> FlightLog:
    table.to_csv(path, index=False)
    return read_log(path)


@pytest.mark.parametrize("held", ["last", "zero"])
@pytest.mark.parametrize("span", [(5.0, 5.4), (4.0, 8.0), (-1.0, 3.0), (9.0, 99.0)])
@pytest.mark.parametrize("columns", [POSE, POSE[3:], ["z"], ["roll"]], ids="-".join)
def test_a_value_that_stands_for_a_missing_measurement_is_read_as_an_empty_cell(
    tmp_path, columns, span, held
):
    table = log_table(flight()).drop(columns=["vbat"])
    hidden = table.t.between(*span)
    missing, last = table.copy(), np.flatnonzero(hidden)[0]
    missing.loc[hidden, columns] = np.nan
    table.loc[hidden, columns] = table.loc[last, columns].to_numpy() if held == "last" else 0.0
    used, expected = written(tmp_path / "a.csv", table), written(tmp_path / "b.csv", missing)
    for field in ("t", "position", "attitude", "command"):
        assert np.array_equal(getattr(used, field), getattr(expected, field)), field
    note = next(note for note in used.notes if "one value to the last digit" in note)
    assert note.startswith(", ".join(columns)) and f"in {100 * hidden.mean():.0f} % of the rows" in note


def waits(table: pandas.DataFrame, thrust: float) -> pandas.DataFrame:
    """The flight after 2 s in which the vehicle stands with that thrust, then leaves at 0.6 m/s2."""
    rest, since = table.t < 2.0, np.maximum(table.t - 2.0, 0.0)
    table.loc[rest, POSE] = table.loc[200, POSE].to_numpy()
    table.loc[rest, "cmd_thrust_pwm"] = thrust
    if not thrust:
        table.loc[rest, "vbat"] = 4.2
    for name in POSE:
        turns = np.minimum(since, 1.0) ** 2  # what else moves begins as slowly
        table[name] = (
            table[name][200] + turns * (table[name] - table[name][200]) + 0.3 * since**2 * (since < 1)
        )
    return table


RESTS = {
    "rounded, slow": lambda table: table.assign(t=3 * table.t).round(
        {name: 3 if name in "xyz" else 2 for name in POSE}
    ),
    "on the ground": lambda table: waits(table, 20_000.0),
    "motors off": lambda table: waits(table, 0.0),
}


@pytest.mark.parametrize("kind", RESTS)
def test_a_value_that_rests_is_a_measurement(tmp_path, kind):
    plain = log_table(flight(noise=0.0, level=True))
    for k, name in enumerate(("roll", "pitch", "yaw")):
        plain[name] = 0.1 * np.sin(plain.t + k)
    table = RESTS[kind](plain)
    assert (table[POSE].diff().eq(0.0).rolling(8).sum() == 8).any(axis=None)  # more than five steps
    table.to_csv(tmp_path / "a.csv", index=False)
    used = read_log(tmp_path / "a.csv", check=False)
    assert used.notes == () and len(used) == len(table) and used.voltage is not None


@pytest.mark.parametrize("zero", [False, True])
def test_a_voltage_that_is_no_longer_measured_is_not_used(tmp_path, zero):
    table = log_table(flight())
    table.loc[300:600, "vbat"] = 0.0 if zero else table.vbat[300]
    used = written(tmp_path / "a.csv", table)
    assert used.voltage is None and len(used) == len(table)
    assert any(note.startswith("vbat keeps one value") for note in used.notes)


@pytest.mark.parametrize("column", ["cmd_thrust_pwm", "cmd_roll"])
def test_a_command_is_held_as_long_as_a_measurement_is_bridged(tmp_path, column):
    table = log_table(flight()).drop(columns=["vbat"])
    table.loc[600:800, column] = np.nan
    used = written(tmp_path / "a.csv", table)
    (gap,) = used.gap_starts
    np.testing.assert_allclose(used.t[[gap, gap + 1]], [5.99 + GAP_SECONDS, 8.01])
    table.loc[~table.index.isin([3, 900]), column] = np.nan
    with pytest.raises(UserError, match="between them, no interval is as long as 1 s"):
        written(tmp_path / "a.csv", table)


@pytest.mark.parametrize("rows", [[300], range(300, 325), range(60)])
def test_a_quaternion_of_zeros_is_none_and_so_is_the_position_with_it(tmp_path, rows):
    log = flight()
    yaw, roll, pitch = (log.attitude[:, k] for k in (2, 0, 1))
    turned = Rotation.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=1)).as_quat() * [[1], [-1]][0]
    table = log_table(log).drop(columns=["vbat", "roll", "pitch", "yaw"])
    table[["qx", "qy", "qz", "qw"]] = turned * np.where(np.arange(len(log)) % 7, 1.0, -1.0)[:, None]
    table.loc[list(rows), ["x", "y", "z", "qx", "qy", "qz", "qw"]] = 0.0
    used = written(tmp_path / "a.csv", table)
    assert any(note.startswith("qw, qx, qy, qz are zeros or no rotation in") for note in used.notes)
    kept = np.isin(np.arange(len(log)), list(rows), invert=True)
    assert np.array_equal(used.t, log.t[kept] - log.t[kept][0])
    np.testing.assert_allclose(used.attitude, log.attitude[kept], atol=1e-9)
    np.testing.assert_array_equal(used.position, log.position[kept])


def test_spikes_of_the_attitude_are_left_out():
    log = flight()
    log.attitude[[100, 300, 500], 0] = -1.0
    used = enforce(log)
    assert len(used) == len(log) - 3 and np.abs(used.attitude[:, 0]).max() < 0.5
    assert "attitude jumps away and back in 3 of 1200 rows, first in row 101 (t = 1.00 s)" in used.notes[0]
    log.attitude[::20, 0] = -1.0
    assert "attitude jumps away and back in 59 of 1200 rows" in found(log, "refuse")[0]  # and row 0 alone


def test_a_vehicle_that_lies_upside_down_has_no_spikes():
    """Its pitch is 180 deg, with either sign from row to row."""
    log = flight()
    log.attitude[-300:, 1] = np.pi * (-1.0) ** np.arange(300)
    assert not any("jumps" in text for kind in ("refuse", "limit") for text in found(log, kind))
    assert any(text.startswith("pitch reaches 180 deg") for text in found(log, "limit"))


def test_an_axis_that_never_changes_is_judged_by_how_the_vehicle_leans():
    log = flight()
    assert found(change(log, x=0), "refuse") == [
        "column x never changes, although the vehicle leans along it: not measured"
    ]
    still = change(flight(planar=True, heading=0.0), y=0, roll=0.001 * np.sin(log.t))
    assert "column y never changes: this axis cannot be checked" in found(still, "limit")


@pytest.mark.parametrize("column", ["cmd_thrust_pwm", "cmd_roll"])
def test_a_command_that_is_no_longer_logged_is_named(column):
    log = flight()
    k = ["cmd_thrust_pwm", "cmd_roll"].index(column)
    log.command[700:, k] = log.command[700, k]
    assert any(f"column {column} stays at" in text for text in found(log, "limit"))


@pytest.mark.parametrize("flies", [True, False])
def test_a_log_that_stops_is_noticed_in_flight(tmp_path, flies):
    log = flight()
    for values in (log.position, log.attitude, log.command):
        values[700:] = values[700]
    log.command[700:, 0] *= flies
    assert len(written(tmp_path / "a.csv", log_table(log))) == (700 if flies else len(log))
    if flies:
        with pytest.raises(UserError, match=r"lasts only 0\.59 s"):
            written(tmp_path / "a.csv", log_table(log.rows(slice(640, None))))


def test_the_command_names_two_vehicles(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    for file, hover in zip(files, (40_000, 50_000)):
        write_log(file, flight(hover=hover))
    assert main(["logs", files[0]]) == 0
    assert "1200 rows, 12.0 s, 100 rows per second" in capsys.readouterr().out
    assert main(["logs", *files, "--json"]) == 2
    captured = capsys.readouterr()
    assert "flights of different vehicles are mixed" in captured.err
    assert '"decision": "refuse"' in captured.out
    assert read_log(files[0]).notes == ()


@pytest.mark.parametrize("factor", [50.0, 20.0, 0.1])
def test_a_clock_that_attitude_and_acceleration_contradict_is_refused(factor):
    """Rows that are 0.01 s apart, read in another unit; 5 % of the step for noise and smoothing."""
    log = flight(seconds=20.0)
    (finding,) = [f for f in check_log(dataclasses.replace(log, t=factor * log.t)) if f.decision == "refuse"]
    step = float(re.search(r"if rows are ([\d.]+) s apart", finding.text)[1])
    assert step == pytest.approx(0.01, rel=0.05) and "state the unit of time" in finding.text


TWICE = {
    "roll": ("roll", "cmd_roll"),
    "both angles": ("pitch", "cmd_pitch"),
    "with the wrong sign": ("roll", "-cmd_roll"),
    "swapped": ("pitch", "cmd_roll"),
    "heading": ("yaw", "cmd_yaw"),
    "position": ("y", "setpoint.y"),
    "requests": ("m2_cmd", "m1_cmd"),
    "rotor speeds": ("m4_speed", "m3_speed"),
}


@pytest.mark.parametrize("kind", TWICE)
def test_two_columns_that_are_one_signal_are_refused_with_both_names(tmp_path, kind):
    one, other = TWICE[kind]
    log = flight()
    speeds = 1000.0 + np.random.default_rng(5).normal(0.0, 10.0, (len(log), 4))
    log = dataclasses.replace(log, requests=40 * speeds, rotor_speed=speeds)
    table = log_table(log).assign(cmd_yaw=0.5 + 0.1 * np.sin(log.t))
    table["setpoint.y"] = table.y + 0.1
    assert written(tmp_path / "a.csv", table).notes == ()
    table[one] = -table[other[1:]] if other.startswith("-") else table[other]
    table.loc[::30, one] += 0.01 * table[one].abs().max()  # nearly every row
    with pytest.raises(UserError, match=r"hold the same numbers in 9\d % of the rows") as refused:
        written(tmp_path / "a.csv", table)
    assert one in str(refused.value) and other.lstrip("-") in str(refused.value)


def test_columns_that_are_alike_for_a_reason_are_used(tmp_path):
    """Motors of a flight of one axis, a measurement under two names, and a heading that is kept."""
    log = flight()
    speeds = 1000.0 + np.random.default_rng(5).normal(0.0, 10.0, (len(log), 2))
    log = dataclasses.replace(log, requests=40 * speeds[:, [0, 1, 1, 0]])
    table = log_table(log).assign(x_measured=log.position[:, 0], heading_ref=0.5)
    assert written(tmp_path / "a.csv", table).requests is not None


def test_a_column_is_no_measurement_and_a_command(tmp_path):
    table = log_table(flight()).rename(columns={"cmd_roll": "controller.roll"}).drop(columns="roll")
    table.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "m.toml").write_text(
        'inherit = "documented"\n[columns]\nroll = "controller.roll"\ncmd_roll = "controller.roll"\n'
    )
    with pytest.raises(UserError, match=r"controller\.roll is read as roll and as a command"):
        read_log(tmp_path / "a.csv", mapping=tmp_path / "m.toml")
