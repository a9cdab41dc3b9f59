"""NanoBench's metrics on motions whose errors are known, and on a flight of the model itself."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from inclined_landing.models import equations, forces
from inclined_landing.models.attitude import PITCH, ROLL, VX, WX, YAW
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.perturbation import neutral
from tests.proof.__main__ import main
from tests.proof.nanobench import Flown, Motion, naive


def test_errors_of_the_naive_model_are_what_moved():
    steps = np.arange(51)
    moved = 0.01 * steps[None, :, None] * np.array([0.6, 0.0, 0.8])  # 1 m/s
    turned = Rotation.from_euler("z", 0.002 * steps[:, None]).as_matrix()[None]  # 0.2 rad/s
    still = np.zeros((1, 51, 3))
    measured = Motion(moved, 2.0 * moved, turned, still)
    flown = Flown(SimpleNamespace(rows=50), measured, np.zeros((1, 3)))
    position, velocity, attitude, rates = flown.errors(naive(flown))
    np.testing.assert_allclose(position, [0.01, 0.1, 0.5, 12.75])  # 12.75: sum of 0.01 h to h = 50
    np.testing.assert_allclose(velocity, [0.02, 0.2, 1.0, 25.5])
    np.testing.assert_allclose(attitude, [0.002, 0.02, 0.1, 2.55])
    np.testing.assert_allclose(rates, 0.0)


@pytest.fixture
def flight(tmp_path):
    """Four seconds of the model under thrust and angle commands, as a tidy flight of NanoBench."""
    vehicle, m, dt = load_vehicle(), 400, 0.01
    t = np.arange(m) * dt
    pwm = vehicle.hover_pwm * (1.0 + 0.05 * np.sin(3.0 * t))
    commands = np.stack([pwm, 0.1 * np.sin(5.0 * t), 0.1 * np.cos(4.0 * t), 0.0 * t], axis=1)
    state = np.zeros((1, 13))
    state[0, 2], state[0, 12] = 5.0, vehicle.hover_pwm / vehicle.thrust_lag_rate
    states = np.empty((m, 13))
    for k in range(m):
        states[k] = state[0]
        conditions = equations.Conditions(forces.pack(vehicle), neutral(1), forces.free_air(1))
        equations.advance(state, commands[k : k + 1], conditions, True, dt / 2, 2)
    angles = states[:, [YAW, ROLL, PITCH]]
    quaternion = Rotation.from_euler("ZXY", angles).as_quat()
    asked = Rotation.from_euler("XY", commands[:, 1:3]).as_euler("ZYX")
    table = {"t": t, "x": states[:, 0], "y": states[:, 1], "z": states[:, 2]}
    table |= dict(zip(("qx", "qy", "qz", "qw"), quaternion.T))
    table |= dict(zip(("vx", "vy", "vz"), states[:, VX : VX + 3].T))
    table |= dict(zip(("imu_wx", "imu_wy", "imu_wz"), states[:, WX : WX + 3].T))
    table |= {"cmd_roll": asked[:, 2], "cmd_pitch": asked[:, 1], "cmd_thrust_pwm": pwm}
    table |= {f"m{k}_pwm": pwm for k in (1, 2, 3, 4)}
    table |= {"vbat": 4.0 - 0.01 * t, "ekf_vx": 0.0 * t, "imu_az": 9.81 + 0.0 * t}
    pd.DataFrame(table).to_csv(tmp_path / "nb_model.csv", index=False)
    write_vehicle(tmp_path / "vehicle.toml", vehicle)
    return tmp_path


def test_the_models_own_flight_is_predicted(flight, capsys):
    vehicle = str(flight / "vehicle.toml")
    words = ["nanobench", str(flight / "nb_model.csv"), "--vehicle", vehicle, "--motors", vehicle, "--json"]
    assert main(words) == 0
    here = json.loads(capsys.readouterr().out)["here"]
    # What is left by commands is the smoothing of the start's velocity, 0.1 s to either side.
    for k in (0, 1, 2):
        assert here["commands"][k][2] < 0.03 * here["naive"][k][2]
    # The motors alone do not say how the vehicle turns, but what it does while it has not.
    assert here["motors"][0][1] < 0.05 * here["naive"][0][1]
    np.testing.assert_allclose(here["motors"][3], here["naive"][3], rtol=1e-9)


def test_wrong_flights_are_refused_in_a_sentence(flight, capsys):
    assert main(["nanobench"]) == 2
    assert "at least one flight" in capsys.readouterr().err
    table = pd.read_csv(flight / "nb_model.csv").drop(columns="imu_wz")
    table.to_csv(flight / "without.csv", index=False)
    assert main(["nanobench", str(flight / "without.csv")]) == 2
    assert "imu_wz" in capsys.readouterr().err
