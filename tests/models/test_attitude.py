"""R = Rz(yaw) Rx(roll) Ry(pitch): its three forms agree, with MuJoCo and with the vehicle's signs."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inclined_landing.models import attitude
from inclined_landing.models.attitude import PITCH, ROLL, STATE_SIZE
from inclined_landing.models.equations import derivative
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant

ROUNDING = 1e-14  # a dozen operations on numbers of size 1, each 1.1e-16
angle = st.floats(-math.pi, math.pi)
roll_angle = st.floats(-math.radians(80), math.radians(80))  # the chart ends at 90 deg
rate = st.floats(-30, 30)


def rx(a):
    return np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])


def ry(a):
    return np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])


def rz(a):
    return np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])


@given(angle, angle, angle)
def test_the_matrix_is_a_rotation_and_the_product_of_three(roll, pitch, yaw):
    r = attitude.rotation(roll, pitch, yaw)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(r) == pytest.approx(1.0, abs=ROUNDING)
    np.testing.assert_allclose(r, rz(yaw) @ rx(roll) @ ry(pitch), atol=ROUNDING)


@given(angle, angle, angle)
def test_mujoco_makes_the_same_matrix_of_the_quaternion(roll, pitch, yaw):
    quat, matrix = np.array(attitude.quaternion(roll, pitch, yaw)), np.zeros(9)
    assert np.linalg.norm(quat) == pytest.approx(1.0, abs=ROUNDING)
    mujoco.mju_quat2Mat(matrix, quat)
    np.testing.assert_allclose(matrix.reshape(3, 3), attitude.rotation(roll, pitch, yaw), atol=ROUNDING)


@given(roll_angle, angle, angle)
def test_euler_angles_survive_the_quaternion(roll, pitch, yaw):
    back = attitude.euler_angles(*attitude.quaternion(roll, pitch, yaw))
    # asin magnifies rounding by 1/cos(80 deg) = 5.8; pitch and yaw may come back a turn away.
    assert back[0] == pytest.approx(roll, abs=10 * ROUNDING)
    for found, wanted in zip(back[1:], (pitch, yaw)):
        assert math.remainder(found - wanted, 2 * math.pi) == pytest.approx(0, abs=10 * ROUNDING)


@given(roll_angle, angle, rate, rate, rate)
def test_body_and_euler_rates_are_inverse(roll, pitch, a, b, c):
    there = attitude.body_rates(roll, pitch, a, b, c)
    # rates of 30 rad/s, 1/cos(80 deg) = 5.8
    np.testing.assert_allclose(attitude.euler_rates(roll, pitch, *there), (a, b, c), atol=200 * ROUNDING)
    there = attitude.euler_rates(roll, pitch, a, b, c)
    np.testing.assert_allclose(attitude.body_rates(roll, pitch, *there), (a, b, c), atol=200 * ROUNDING)


@given(roll_angle, angle, angle, st.tuples(rate, rate, rate))
def test_body_rates_turn_the_matrix(roll, pitch, yaw, rates):
    """dR/dt = R [omega]x, by a central difference along the Euler rates."""
    angles, h = np.array([roll, pitch, yaw]), 1e-6
    step = h * np.array(rates)
    difference = (attitude.rotation(*(angles + step)) - attitude.rotation(*(angles - step))) / (2 * h)
    wx, wy, wz = attitude.body_rates(roll, pitch, *rates)
    cross = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    # Truncation h^2 (90 rad/s)^3 / 6 = 1.2e-7; cancellation 1e-16 / h = 1e-10.
    np.testing.assert_allclose(difference, attitude.rotation(roll, pitch, yaw) @ cross, atol=5e-7)


def test_rates_stay_finite_where_the_chart_ends():
    assert np.isfinite(attitude.euler_rates(math.pi / 2, 0.3, 1.0, 2.0, 3.0)).all()


@pytest.mark.parametrize("column, along", [(PITCH, (1.0, 0.0)), (ROLL, (0.0, -1.0))])
def test_positive_pitch_accelerates_forward_and_positive_roll_to_the_right(column, along):
    """y points left, so a roll's acceleration is negative (the authors' public code has it positive)."""
    v, state = load_vehicle(), np.zeros(STATE_SIZE)
    state[attitude.LAG], state[column] = v.hover_lag, 0.2
    found = derivative(state, [v.hover_pwm, 0, 0, 0], v)["acceleration"][:2]
    wanted = v.environment_gravity * math.sin(0.2) * np.array(along)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=0.0)


def test_the_engine_turns_the_thrust_by_yaw_then_roll_then_pitch():
    """In MuJoCo and in SciPy, whose intrinsic order is ZXY; every other order is 5 deg or more away."""
    v, angles = dataclasses.replace(load_vehicle(), drag_coefficients=(0.0, 0.0, 0.0)), (0.5, -0.6, 2.0)
    plant = MujocoPlant(1, v, attitude="kinematic", contacts=False)
    data = mujoco.MjData(plant.model)
    data.mocap_pos[:, 2] = -100.0  # the platform, out of the way
    data.qpos[:] = [0, 0, 50, *attitude.quaternion(*angles)]
    data.act[0], data.ctrl[0] = v.hover_lag, v.hover_pwm
    mujoco.mj_forward(plant.model, data)
    up = (data.qacc[:3] + [0, 0, v.environment_gravity]) / v.environment_gravity
    named, apart = dict(zip("XYZ", angles)), {}
    for order in ("ZXY", "ZYX", "XYZ", "XZY", "YXZ", "YZX"):
        turned = Rotation.from_euler(order, [named[axis] for axis in order]).apply([0.0, 0.0, 1.0])
        apart[order] = np.linalg.norm(up - turned)
    assert apart.pop("ZXY") < 10 * ROUNDING
    assert min(apart.values()) > math.radians(5.0)


@pytest.mark.parametrize("largest", [math.pi / 4, 4.0, 1e5])
def test_sine_and_cosine_are_exact_to_rounding(largest):
    angles = np.random.default_rng(0).uniform(-largest, largest, 2000)
    found = np.array([attitude.sine_cosine(angle) for angle in angles]).T
    np.testing.assert_allclose(found, (np.sin(angles), np.cos(angles)), rtol=0, atol=4 * ROUNDING)
