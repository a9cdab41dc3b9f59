"""Files in the layouts of the public sets, with made-up rows, are read as their authors publish them."""

import numpy as np
import pandas as pd
import pytest

from inclined_landing.eval.logs import mapping, read_log
from tests import ROOT

MOTORS = ROOT / "tests/validation/nanobench_motors.toml"


def published(path, name, **columns):
    """Write a flight of 3 s in the columns of a set, zero where nothing is given."""
    known = mapping.shipped()[name]
    table = {one: np.zeros(300) for one in (*known.detect, *mapping.patterns(known))} | columns
    pd.DataFrame(table).to_csv(path, index=False)
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
    """Whatever columns of the documented CSV, which are the vehicle's estimate, stand beside it."""
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
