"""inclined_landing.attitude: closed form, every attribute, hook and refusal."""

import math

import mujoco
import numpy as np
import pytest

from inclined_landing.models.attitude import euler_angles

COMMAND = np.array([0.4, -0.3, 1.5])  # roll [rad], pitch [rad], yaw rate [rad/s]
DURATION = 0.3  # s: well inside the transient of every loop tested
# RK4 loses (B h)^5/120 of a transient's amplitude per step, over the 1/(B h) steps it lives:
# (B h)^4/120 = 1e-6 at B = 100 1/s, h = 1 ms, times amplitudes below 0.5.
TOLERANCE = 1e-6


def angle_response(command, t, gain, tau, bandwidth, damping):
    """Step response of gain B/tau / ((s + 1/tau)(s + B)) times `command`, at time t."""
    first, second = np.roots([1.0, damping * (bandwidth + 1 / tau), bandwidth / tau]).astype(complex)
    decay = (first * np.exp(second * t) - second * np.exp(first * t)) / (first - second)
    return gain * command * (1 - decay.real)


def expected(build, command=COMMAND, t=DURATION, **changed):
    """(roll, pitch, yaw) [rad] after a command step from rest, in closed form."""
    v = build.vehicle
    values = {
        "gain": v.attitude_gain,
        "time_constant": v.attitude_time_constant,
        "bandwidth": v.attitude_bandwidth,
        "damping": v.attitude_damping,
        "yaw_gain": v.attitude_yaw_gain,
        "yaw_bandwidth": v.attitude_yaw_bandwidth,
    } | changed
    loop = (values["gain"], values["time_constant"], values["bandwidth"], values["damping"])
    b = values["yaw_bandwidth"]
    yaw = values["yaw_gain"] * command[2] * (t + math.expm1(-b * t) / b)
    return (*(angle_response(c, t, *loop) for c in command[:2]), yaw)


def flown(build, model, command=COMMAND, duration=DURATION):
    """(roll, pitch, yaw) [rad] after the same step in the engine."""
    data = build.data(model, [0, *command])
    build.run(model, data, duration)
    return euler_angles(*data.qpos[3:7])


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"gain": 0.8},
        {"yaw_gain": 0.9},
        {"time_constant": 0.1},
        {"bandwidth": 100.0},
        {"damping": 0.4},
        {"yaw_bandwidth": 30.0},
    ],
    ids=lambda changed: next(iter(changed), "defaults"),
)
def test_poles_are_the_loop_and_the_bandwidth(build, changed):
    model = build(attitude={key: repr(value) for key, value in changed.items()})
    assert flown(build, model) == pytest.approx(expected(build, **changed), abs=TOLERANCE)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_hook_trim(build, axis):
    model = build()
    model.actuator_biasprm[1 + axis, 0] = 0.05
    trimmed = COMMAND + 0.05 * np.eye(3)[axis]
    assert flown(build, model) == pytest.approx(expected(build, trimmed), abs=TOLERANCE)


def test_inertia_is_read_from_the_model_at_every_call(build):
    model = build()
    before = build.data(model, [0, 0.1, 0, 0]).actuator_force[1]
    model.body("crazyflie").inertia[:] *= 3
    assert build.data(model, [0, 0.1, 0, 0]).actuator_force[1] == pytest.approx(3 * before)
    assert flown(build, model) == pytest.approx(expected(build), abs=TOLERANCE)


def test_inertia_with_tilted_principal_axes(build):
    full = "2e-5 3e-5 4e-5 2e-6 -3e-6 4e-6"
    model = build(inertial=f'pos="0 0 0" mass="0.03" fullinertia="{full}"')
    assert abs(model.body("crazyflie").iquat[0]) < 1 - 1e-3
    assert flown(build, model) == pytest.approx(expected(build), abs=TOLERANCE)


def test_gear_names_the_axis_and_divides_the_force(build):
    gears = {"yaw_rate": "0 0 0 0 0 -2", "pitch": "0 0 0 0 3 0", "roll": "0 0 0 0.5 0 0"}
    actuators = "".join(build.actuator(name, gear=gear) for name, gear in gears.items())
    model = build(actuators=build.actuator("thrust") + actuators)
    data = build.data(model, [0, *COMMAND[::-1]])
    straight = build.data(build(), [0, *COMMAND])
    want = straight.actuator_force[:0:-1] / [-2, 3, 0.5]
    np.testing.assert_allclose(data.actuator_force[1:], want, rtol=1e-12)
    np.testing.assert_allclose(data.qacc, straight.qacc, rtol=1e-9, atol=1e-12)


def test_axis_without_actuator_gets_no_torque(build):
    model = build(actuators=build.actuator("thrust") + build.actuator("pitch"))
    data = build.data(model, [0, 0.2])
    np.testing.assert_allclose(data.qfrc_actuator[[3, 5]], 0, atol=0)
    build.run(model, data, DURATION)
    pitch = euler_angles(*data.qpos[3:7])[1]
    assert pitch == pytest.approx(expected(build, [0, 0.2, 0])[1], abs=TOLERANCE)


def test_torque_is_bounded_at_90_degrees_of_roll(build):
    model = build()
    data = build.data(model, [0, 0.1, 0.1, 1], quat=(1, 1, 0, 0))
    data.qvel[3:6] = 1, 2, 3
    mujoco.mj_forward(model, data)
    # the Euler rates stay below |w|/0.05 = 75 rad/s, their products times the inertia below 0.2 N m
    assert np.abs(data.actuator_force).max() < 0.5
    build.run(model, data, 1.0)
    assert np.abs(euler_angles(*data.qpos[3:7])[:2]).max() < 0.2  # recovered


def test_forcerange_limits_the_torque(build):
    actuators = build.actuator("thrust") + build.actuator("roll", forcerange="-1e-3 1e-3")
    data = build.data(build(actuators=actuators), [0, 0.5])
    assert data.actuator_force[1] == 1e-3
