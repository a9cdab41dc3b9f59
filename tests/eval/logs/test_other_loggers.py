"""Logs of others: rotor speeds, requests of the motors, lists."""

from pathlib import Path

import numpy as np
import pandas
import pytest

from inclined_landing.eval import logs
from inclined_landing.eval.logs import mapping, read_log
from inclined_landing.eval.logs.read import write_log
from inclined_landing.models.base.errors import UserError
from tests import ROOT
from tests.log_files import sd_card as sd_card_log

MOTORS = ROOT / "tests/eval/logs/nanobench_motors.toml"


def sd_log(columns: dict[str, np.ndarray], step: float = 0.004) -> bytes:
    """A log of the current micro-SD format, a row each `step` [s]."""
    return sd_card_log(columns, step * np.arange(len(next(iter(columns.values())))), 2, {})


def motion(n: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) and a sideways swing (n,) of 0.3 m."""
    t = dt * np.arange(n)
    return t, 0.3 * np.sin(3.0 * t)


def test_newtons_and_repeated_positions_of_the_lee_controller(tmp_path):
    t, x = motion(2000, 0.004)
    held = np.repeat(x[::2], 2)  # measured every second row
    tilt = np.arctan(-9.0 * x / 9.81)
    columns = {f"stateEstimateZ.{a}": 1000.0 * v for a, v in zip("xyz", (held, 0 * t, 0 * t + 1.0))}
    columns |= {f"ctrlLee.rpy{a}": v for a, v in zip("xyz", (0 * t + 1e-3 * x, tilt, 0 * t))}
    columns |= {f"ctrlLee.rpyd{a}": 1.1 * v for a, v in zip("xyz", (1e-3 * x, tilt, 0 * t))}
    columns["ctrlLee.thrustSi"] = 0.311 / np.cos(tilt)
    path = tmp_path / "log158"
    path.write_bytes(sd_log(columns))
    log = read_log(path)
    assert len(log) == 1000 and any("measured less often than written" in note for note in log.notes)
    np.testing.assert_allclose(log.command[0, 0], 65535 * 0.311 / 0.62278, rtol=1e-4)
    np.testing.assert_allclose(log.attitude[:, 1], tilt[::2], atol=1e-4)
    assert not log.thrust_is_measured


def test_a_vehicle_that_stands_was_measured_and_a_frozen_position_was_not(tmp_path):
    t, x = motion(2000, 0.004)
    x = np.where(t < 1.0, 0.0, 0.3 - 0.3 * np.cos(3.0 * (t - 1.0)))
    frozen = (t >= 4.0) & (t < 4.4)
    x[frozen] = x[np.argmax(frozen)]
    tilt = np.arctan(-9.0 * x / 9.81)
    millimetres = np.round(1000.0 * np.repeat(x[::2], 2))  # as the firmware logs it
    columns = {f"stateEstimateZ.{a}": v for a, v in zip("xyz", (millimetres, 0 * t, 0 * t + 1000.0))}
    columns |= {f"ctrlLee.rpy{a}": v for a, v in zip("xyz", (0 * t, tilt, 0 * t))}
    columns |= {f"ctrlLee.rpyd{a}": 1.1 * v for a, v in zip("xy", (0 * t, tilt))}
    columns["ctrlLee.thrustSi"] = 0.311 / np.cos(tilt)
    path = tmp_path / "log158"
    path.write_bytes(sd_log(columns))
    log = read_log(path, check=False)
    # The vehicle stands for 1 s and turns three times; only where it is frozen in motion is there a gap.
    (gap,) = log.gap_starts
    np.testing.assert_allclose(log.t[[gap, gap + 1]], [4.0, 4.4], atol=0.01)
    # Whatever is kept lies within the rounding and what it moves in one measurement (0.9 m/s in 8 ms).
    np.testing.assert_allclose(log.position[:, 0], np.interp(log.t, t, x), atol=5e-4 + 0.9 * 0.008)


def test_thrust_by_measured_rotor_speeds(tmp_path):
    t, x = motion(1500, 0.004)
    tilt = np.arctan(-9.0 * x / 9.81)
    columns = {f"locSrv.{a}": v for a, v in zip("xyz", (x, 0 * t, 0 * t + 1.0))}
    columns |= {
        f"stateEstimate.q{a}": v for a, v in zip("xyzw", (0 * t, np.sin(tilt / 2), 0 * t, np.cos(tilt / 2)))
    }
    columns |= {f"rpm.m{k}": (14000.0 + 500.0 * k) / np.sqrt(np.cos(tilt)) for k in (1, 2, 3, 4)}
    columns |= {"acc.z": 1.0 / np.cos(tilt), "pm.vbatMV": 3700.0 - t}
    path = tmp_path / "eckart00"
    path.write_bytes(sd_log(columns))
    log = read_log(path)
    assert log.thrust_is_measured and np.isnan(log.command[:, 1:]).all()
    speeds = 14000.0 + 500.0 * np.arange(1, 5)
    middle = np.argmin(np.abs(tilt))
    np.testing.assert_allclose(log.rotor_speed[middle], speeds * np.pi / 30, rtol=1e-5)
    np.testing.assert_allclose(log.command[middle, 0], 65535 * np.mean(speeds**2) / 21219.0**2, rtol=1e-5)
    write_log(tmp_path / "tidy.csv", log)
    again = read_log(tmp_path / "tidy.csv")
    assert again.thrust_is_measured
    np.testing.assert_allclose(again.command[:, 0], log.command[:, 0])
    np.testing.assert_allclose(again.rotor_speed, log.rotor_speed)


def test_attitude_and_requests_from_the_controllers(tmp_path):
    """The attitude that makes the commanded rates of the firmware's PID, and its power distribution."""
    dt = 0.01
    t, x = motion(1000, dt)
    pitch = np.degrees(np.arctan(-9.0 * x / 9.81))
    roll, wanted = 0.2 * pitch, 1.1 * pitch
    rates = {}
    for name, angle in (("roll", roll), ("pitch", pitch)):
        error = wanted - angle
        rates[name] = 6.0 * error + 3.0 * dt * np.r_[0.0, np.cumsum(error)[:-1]]
    columns = {f"stateEstimate.{a}": v for a, v in zip("xyz", (x, 0 * t, 0 * t + 1.0))}
    columns |= {"controller.roll": wanted, "controller.pitch": -wanted}
    columns |= {"controller.rollRate": rates["roll"], "controller.pitchRate": -rates["pitch"]}
    turning = {"roll": np.radians(roll), "pitch": -np.radians(pitch), "yaw": 0 * t}
    columns |= {f"controller.r_{a}": np.gradient(angle, dt) for a, angle in turning.items()}
    columns |= {"controller.cmd_thrust": 40000.0 + 100.0 * x}
    columns |= {"controller.cmd_roll": 0 * t + 2000.0, "controller.cmd_pitch": 0 * t + 600.0}
    columns |= {"controller.cmd_yaw": 0 * t + 50.0}
    path = tmp_path / "E8_log00"
    path.write_bytes(sd_log(columns, 0.01))
    log = read_log(path, check=False)
    # Convention ZYX to ZXY at angles of 0.05 rad: second order.
    np.testing.assert_allclose(log.attitude[:, :2], np.radians(np.c_[roll, pitch]), atol=5e-3)
    by_hand = 40000.0 + np.array([-1000 + 300 + 50, -1000 - 300 - 50, 1000 - 300 + 50, 1000 + 300 - 50])
    np.testing.assert_allclose(log.requests[0], by_hand, atol=0.1)
    # The same columns in a table, whose one clock is a column.
    pandas.DataFrame({"t": t} | columns).to_csv(tmp_path / "table.csv", index=False)
    shipped = (Path(logs.__file__).parent / "mappings" / "crazypad_controller.toml").read_text()
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(shipped.replace("[columns]\n", '[columns]\nt = "t"\n'))
    again = read_log(tmp_path / "table.csv", mapping=mapping, check=False)
    # 24 bits of a float32: angles of a radian, requests of 40 000 PWM.
    np.testing.assert_allclose(again.attitude, log.attitude, atol=1e-5)
    np.testing.assert_allclose(again.requests, log.requests, atol=0.01)


def test_derived_angles_that_the_gyro_contradicts_are_left_out(tmp_path):
    t = np.arange(0.0, 6.0, 0.01)
    roll, pitch = 3.0 * np.sin(2.0 * t), 2.0 * np.sin(3.0 * t)  # deg; set-points 0, gains kp 6, ki 3
    # r = -kp angle - ki integral of the angle
    rates = {
        "roll": -6.0 * roll - 3.0 * 1.5 * (1.0 - np.cos(2.0 * t)),
        "pitch": -6.0 * pitch - 3.0 * 2.0 / 3.0 * (1.0 - np.cos(3.0 * t)),
    }
    turning = {"roll": 6.0 * np.cos(2.0 * t), "pitch": 6.0 * np.cos(3.0 * t)}  # deg/s
    columns = {f"stateEstimate.{axis}": 0.01 * t + 0.5 for axis in "xyz"}
    columns |= {"controller.cmd_thrust": 40000.0 + 500 * np.sin(t)}
    columns |= {f"controller.cmd_{name}": 0 * t for name in ("roll", "pitch", "yaw")}
    for name, rate in rates.items():
        columns |= {f"controller.{name}": 0 * t, f"controller.{name}Rate": rate}
        columns |= {f"controller.r_{name}": np.radians(turning[name])}
    path = tmp_path / "E8_log00"
    path.write_bytes(sd_log(columns, 0.01))
    log = read_log(path, check=False)
    # An integral of rows of 10 ms: 3/6 of 3 deg 2 rad/s (0.01 s)/2 at most.
    np.testing.assert_allclose(log.attitude[:, 0], np.radians(roll), atol=np.radians(0.1))
    notes = [note for note in log.notes if "gyro" in note]
    assert len(notes) == 2 and all("correlation 1.00" in note for note in notes)

    path.write_bytes(sd_log(columns | {"controller.r_roll": columns["controller.r_pitch"]}, 0.01))
    log = read_log(path, check=False)
    assert "roll" in log.missing and "pitch" not in log.missing
    assert any(note.startswith("roll is derived") and note.endswith("left out") for note in log.notes)

    wrong = {f"controller.r_{name}": -columns[f"controller.r_{name}"] for name in rates}
    path.write_bytes(sd_log(columns | wrong, 0.01))
    with pytest.raises(UserError, match="roll and pitch cannot be derived"):
        read_log(path, check=False)


def test_a_thrust_command_beyond_the_full_one_is_the_full_one(tmp_path):
    (tmp_path / "map.toml").write_text(
        '[columns]\nt = "t"\nx = "x"\ny = "x"\nz = "x"\nroll = "r"\n'
        'cmd_thrust_pwm = { column = "u", full = 2.0 }\n'
    )
    t = np.arange(200) * 0.02
    u = np.where(np.arange(200) % 40 == 5, 2.2, 1.0 + 0.1 * np.sin(t))  # 5 of 200 rows beyond full
    rows = [f"{a},{b},{c},{d}" for a, b, c, d in zip(t, np.sin(t), 0.1 * np.cos(t), u)]
    (tmp_path / "a.csv").write_text("t,x,r,u\n" + "\n".join(rows))
    log = read_log(tmp_path / "a.csv", mapping=tmp_path / "map.toml", check=False)
    np.testing.assert_allclose(log.command[:, 0], 65535 * np.minimum(u, 2.0) / 2.0)
    assert any("beyond the full command in 5 rows" in note for note in log.notes)
    # Twice as much in every row is another unit, not saturation.
    rows = [f"{a},{b},{c},{3 * d}" for a, b, c, d in zip(t, np.sin(t), 0.1 * np.cos(t), u)]
    (tmp_path / "a.csv").write_text("t,x,r,u\n" + "\n".join(rows))
    with pytest.raises(UserError, match="PWM is 0 to 65535"):
        read_log(tmp_path / "a.csv", mapping=tmp_path / "map.toml")


def test_columns_of_lists(tmp_path):
    t, x = motion(400, 0.02)
    tilt = np.arctan(-9.0 * x / 9.81)
    path = tmp_path / "custom_figure8_baseline_nowind.csv"
    rows = [",t,p,v,q,T_sp,q_sp,hover_throttle"]
    for k in range(len(t)):
        half = 0.5 * tilt[k]
        q = f'"[0.0, {np.sin(half):.6f}, 0.0, {np.cos(half):.6f}]"'
        q_sp = f'"[0.0, {np.sin(1.1 * half):.6f}, 0.0, {np.cos(1.1 * half):.6f}]"'
        thrust = 0.48 / np.cos(tilt[k])
        rows.append(
            f'{k},{t[k]:.3f},"[{x[k]:.5f}, {1e-4 * x[k]:.7f}, 2.0]","[0, 0, 0]",{q},'
            f"[{thrust:.5f}],{q_sp},[0.48]"
        )
    path.write_text("\n".join(rows) + "\n")
    log = read_log(path, check=False)
    np.testing.assert_allclose(log.command[:, 0], 65535 * 0.48 / np.cos(tilt), rtol=1e-4)
    np.testing.assert_allclose(log.command[:, 2], 1.1 * tilt, atol=1e-5)
    np.testing.assert_allclose(log.position[:, 0], x, atol=1e-5)
    path.write_text(path.read_text().replace('"[0, 0, 0]"', '"[0, 0]"', 1))
    with pytest.raises(UserError, match="the lists in column v differ in length"):
        read_log(path)


# --- files in the layouts of the public sets, with made-up rows ---


def published(path, name, **columns):
    """Write a flight of 3 s in the columns of a set, zero where nothing is given."""
    known = mapping.shipped()[name]
    table = {one: np.zeros(300) for one in (*known.detect, *mapping.patterns(known))} | columns
    pandas.DataFrame(table).to_csv(path, index=False)
    return path


def wave(size):
    return size * np.sin(0.04 * np.arange(300))


def test_nanobench_is_turned_into_si_units_and_the_documented_frame(tmp_path):
    path = published(
        tmp_path / "B1_hover_rep1.csv",
        "nanobench_original",
        t=1.7e9 + 0.01 * np.arange(300),
        px=wave(-0.05),
        pz=1.0 + 0.0003 * np.arange(300),
        qw=np.ones(300),
        qy=wave(0.04),
        pid_controller_pitch=wave(-5.0),
        pid_controller_cmd_thrust=45000.0 + wave(100.0),
        pwr_pm_vbat=4.0 - wave(0.01),
        **{f"motor_motor_m{k}": 50000.0 + wave(100.0) for k in range(1, 5)},
    )
    log = read_log(path, check=False)
    assert log.t[0] == 0.0 and any("27 g is doubtful" in note for note in log.notes)
    np.testing.assert_allclose(log.position[:, 0], wave(-0.05), atol=1e-12)
    np.testing.assert_allclose(log.attitude[:, 1], 2 * np.arcsin(wave(0.04)), atol=1e-4)
    np.testing.assert_allclose(log.command[:, 2], np.radians(wave(5.0)), atol=1e-9)
    np.testing.assert_allclose(log.command[:, 0], 45000.0 + wave(100.0))
    np.testing.assert_allclose(log.voltage, 4.0 - wave(0.01))
    motors = read_log(path, mapping=MOTORS, check=False)
    np.testing.assert_allclose(motors.command[:, 0], 50000.0 + wave(100.0))
    assert np.array_equal(motors.position, log.position)


@pytest.mark.parametrize("name", ["utias_fmpc", "utias_fmpc_original"])
def test_motion_capture_of_utias_is_taken_not_the_estimate(tmp_path, name):
    """Columns of the documented CSV, which are the vehicle's estimate, may stand next to it."""
    known = mapping.shipped()[name]
    t, x, z, pwm = (known.columns[key] for key in ("t", "x", "z", "cmd_thrust_pwm"))
    given = {t: 5.0 + 0.02 * np.arange(300), x: wave(0.1), z: 1.0 + wave(0.1), pwm: 40000.0 + wave(9.0)}
    estimate = {key: np.full(300, 7.0) for key in ("x", "y", "z", "roll", "pitch", "yaw")}
    log = read_log(published(tmp_path / "data_1_2.csv", name, **estimate, **given), check=False)
    np.testing.assert_allclose(log.position[:, 0], wave(0.1), atol=1e-12)
    assert any("marker" in note for note in log.notes)


def test_neural_swarm_has_microseconds_and_grams(tmp_path):
    given = {"time[ms]": 1e4 * np.arange(300), "z[m]": 1.0 + wave(0.1), "qw": np.ones(300)}
    given |= {"thrust_des[g]": 31.7421 + wave(1.0), "torquex[Nm]": wave(1e-3), "u1[PWM]": wave(0.1)}
    log = read_log(published(tmp_path / "cf50_00.csv", "neural_swarm", **given), check=False)
    np.testing.assert_allclose(log.t, 0.01 * np.arange(300), atol=1e-12)
    # 0.311 N (31.7 g) is half of what the shipped vehicle gives at full command.
    np.testing.assert_allclose(log.command[:, 0], 65535 * (0.5 + wave(1.0) / 63.4842), rtol=1e-6)
