"""The equations against exact solutions and invariants.

Their lag against the paper's discrete motor function: tests/eval/truth/test_equivalence.py.
"""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inclined_landing.models import attitude_loops, equations, forces
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ, WX, YAW, Z, body_rates, rotation
from inclined_landing.models.equations import derivative
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
G = V.environment_gravity
HOVER = np.array([V.hover_pwm, 0.0, 0.0, 0.0])


def hovering() -> np.ndarray:
    state = np.zeros((1, 13))
    state[0, Z], state[0, LAG] = 1.6, V.hover_lag
    return state


def fly(state, commands, duration, steps, rate_loop=False, vehicle=V) -> np.ndarray:
    """Copy of `state` (n, 13) after `duration` [s] in `steps` RK4 steps."""
    state = np.array(state)
    commands = np.broadcast_to(np.asarray(commands, float), (len(state), 4)).copy()
    n = len(state)
    conditions = equations.Conditions(forces.pack(vehicle), np.ones(n), forces.free_air(n))
    equations.advance(state, commands, conditions, rate_loop, duration / steps, steps)
    return state


@pytest.mark.parametrize("rate_loop", [False, True])
def test_hover_is_an_equilibrium(rate_loop):
    # 500 steps, weight and thrust cancel to 2e-16 g each: 10 s of that is 1e-13 m.
    np.testing.assert_allclose(
        fly(hovering(), HOVER, 10.0, 500, rate_loop), hovering(), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("rate_loop", [False, True])
def test_without_thrust_it_falls_freely(rate_loop):
    """At PWM 0 and no lag the rotors stand, so that there is no drag either."""
    state = np.zeros((1, 13))
    state[0, Z], state[0, VX] = 50.0, 3.0
    end = fly(state, np.zeros(4), 2.0, 100, rate_loop)[0]
    # RK4 is exact for parabolas, up to rounding.
    np.testing.assert_allclose(end[[0, Z, VX, VZ]], [6.0, 50 - 2 * G, 3.0, -2 * G], rtol=1e-13)


@pytest.mark.parametrize("rate_loop", [False, True])
def test_halving_the_step_divides_the_error_by_sixteen(rate_loop):
    """The integrator is of fourth order: log2 of the ratio of the errors at 2.5 and 1.25 ms is 4.

    The next term has a relative size of B h = 0.06 to 0.13, which shifts the logarithm by up to 0.2.
    """
    command = [50_000.0, 0.3, -0.4, 1.5]
    coarse, fine, exact = (fly(hovering(), command, 0.1, steps, rate_loop) for steps in (40, 80, 800))
    errors = [np.abs(end - exact)[0, [0, 1, 2]].max() for end in (coarse, fine)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)
    assert errors[1] > 1e-12  # m, far above rounding


@pytest.mark.parametrize("column, command", [(ROLL, 1), (PITCH, 2)])
def test_attitude_steps_follow_the_exponential(column, command):
    commands, tau = HOVER.copy(), V.attitude_time_constant
    commands[[command, 3]] = 0.3, 1.5
    final = V.attitude_gain * 0.3
    at_tau = fly(hovering(), commands, tau, 10)[0]
    # Ten RK4 steps of h = tau/10 err by (h/tau)^5/120 of the deviation each: 10 x 8e-8.
    assert at_tau[column] == pytest.approx(final * (1 - math.exp(-1)), rel=1e-6)
    assert at_tau[column] / final == pytest.approx(0.63, abs=0.005)
    other = PITCH if column == ROLL else ROLL
    assert at_tau[other] == 0 and at_tau[YAW] == pytest.approx(1.5 * tau, rel=1e-13)


def test_body_rates_of_the_kinematic_model_are_those_of_its_loops():
    command = np.array([V.hover_pwm, 0.2, -0.3, 1.0])
    end = fly(hovering(), command, 0.1, 5)[0]
    wanted = derivative(end, command, V)["euler_rates"]
    np.testing.assert_allclose(end[WX : WX + 3], body_rates(end[ROLL], end[PITCH], *wanted), rtol=1e-12)


def column(values):
    """Values as a column of a wider array, which the gap workflow's compiled functions take."""
    return np.column_stack([values, values])[:, 0]


def test_the_exact_steps_are_the_equations():
    """Lag, angle and yaw under held commands, as the gap workflow steps them, against RK4."""
    v = dataclasses.replace(
        V, effects_spin_down=0.4, effects_attitude_trim=(0.02, -0.03), effects_yaw_drift=0.05
    )
    rng, dt, packed = np.random.default_rng(3), 0.02, forces.pack(v)
    commands = rng.uniform([2e4, -0.4, 0, -2], [5e4, 0.4, 0, 2], (30, 4))
    commands[:, 2] = 0.03  # against the trim: pitch stays 0, where roll and yaw are decoupled
    state = hovering()
    state[0, ROLL], state[0, LAG] = 0.1, commands[0, 0] / v.thrust_lag_rate
    state[0, WX : WX + 3] = body_rates(0.1, 0.0, 0.0, 0.0, commands[0, 3] + 0.05)
    flown = [state[0]]
    for command in commands:
        state = fly(state, command, dt, 40, rate_loop=True, vehicle=v)
        flown.append(state[0])
    flown = np.array(flown)
    # RK4 with B h = 0.025 errs by 4e-10 of each change; 30 periods of changes up to 0.5 rad, 2 rad/s.
    still = column(np.zeros(len(commands)))
    roll = attitude_loops.angle_steps(0, commands[:, 1].copy(), still, 0.1, dt, packed)
    np.testing.assert_allclose(flown[:, ROLL], roll, atol=1e-8)
    np.testing.assert_allclose(flown[:, YAW], attitude_loops.yaw_steps(commands[:, 3], dt, packed), atol=1e-8)
    lag, _ = forces.lags(commands[:, 0], dt, packed)
    np.testing.assert_allclose(flown[:, LAG], lag, rtol=1e-8)


@pytest.mark.parametrize("damping", [0.4, 0.7, 1.0, 1.3])
def test_damping_moves_the_poles_to_the_roots_of_its_equation(damping):
    """Of the derivative and of the exact step: s^2 + damping (B + 1/tau) s + B/tau."""
    v = dataclasses.replace(V, attitude_time_constant=0.06, attitude_damping=damping)
    a, b = 1 / v.attitude_time_constant, v.attitude_bandwidth
    poles = np.roots([1.0, damping * (a + b), a * b])
    assert np.iscomplex(poles).all() == (damping < 0.85)
    t, k = np.arange(31) * 0.02, v.attitude_gain
    residues = poles[::-1] / (poles - poles[::-1])  # of the step response 1 + sum of residue exp(pole t)
    exact = 0.3 * k * (1.0 + (residues[:, None] * np.exp(poles[:, None] * t)).sum(axis=0).real)
    steps = attitude_loops.angle_steps(1, np.full(30, 0.3), column(np.zeros(30)), 0.0, 0.02, forces.pack(v))
    np.testing.assert_allclose(steps, exact, atol=1e-12)
    end = fly(hovering(), [v.hover_pwm, 0, 0.3, 0], 0.6, 1200, rate_loop=True, vehicle=v)[0]
    assert end[PITCH] == pytest.approx(exact[-1], rel=1e-8)  # (B h)^4 / 120 of each step's change


@pytest.mark.parametrize(
    "damping, integral, hold, saturation, error",
    [
        (0.6, 2.0, 0.0, 0.0, 1e-8),
        (1.0, 0.0, 1.5, 0.0, 1e-8),
        (0.8, 0.5, 2.0, 0.0, 1e-8),
        (1.0, 2.0, 1.0, 1.0, 4e-4),
    ],
)
def test_the_angle_step_of_any_loop_follows_the_equations(damping, integral, hold, saturation, error):
    """Against the integrator with 40 steps a period, from an integral that holds the centre of mass."""
    v = dataclasses.replace(
        V,
        effects_attitude_integral=integral,
        effects_attitude_hold=hold,
        effects_attitude_saturation=saturation,
        effects_com_offset=(0.0, 0.0005),
        attitude_damping=damping,
    )
    a, b, dt, packed = 1 / v.attitude_time_constant, v.attitude_bandwidth, 0.02, forces.pack(v)
    commands = np.random.default_rng(3).uniform(-0.4, 0.4, 30)
    moment = -v.effects_com_offset[1] * v.body_mass * v.environment_gravity / v.body_inertia[0]
    twist = column(np.full(30, moment))
    angle, held_by = attitude_loops.integrated_steps(0, commands, twist, 0.1, dt, packed).T
    state, held = hovering(), np.array([[(hold * 0.1 - moment / b) / (a * (integral + hold)), 0.0]])
    state[0, ROLL], flown = 0.1, []
    conditions = equations.Conditions(packed, np.ones(1), forces.free_air(1), integral=held)
    for command in commands:
        row = np.array([[v.hover_pwm, command, 0.0, 0.0]])
        equations.advance(state, row, conditions, True, dt / 40, 40)
        flown.append([state[0, ROLL], held[0, 0]])
    # The one is exact, the other errs by (B h)^4/120 = 1e-9 of each step's change. A saturation that begins
    # within a step of 4 ms errs by 4 ms of 1 rad/s / tau, over B 4e-4 rad.
    np.testing.assert_allclose(np.array(flown), np.array([angle, held_by]).T[1:], atol=error)


def test_the_exact_angle_step_where_the_poles_meet():
    """It is continuous in the bandwidth, with a torque too."""
    tau, rng = V.attitude_time_constant, np.random.default_rng(4)
    command, twist = rng.uniform(-0.4, 0.4, 50), column(rng.uniform(-1, 1, 50))
    angles = [
        attitude_loops.angle_steps(
            1, command, twist, 0.1, 0.02, forces.pack(dataclasses.replace(V, attitude_bandwidth=b / tau))
        )
        for b in (1 - 1e-7, 1.0, 1 + 1e-7)
    ]
    np.testing.assert_allclose(angles[0], angles[1], atol=1e-6)
    np.testing.assert_allclose(angles[2], angles[1], atol=1e-6)
    assert np.ptp(angles[1]) > 0.05


@given(
    st.tuples(*[st.floats(-10, 10)] * 3),
    st.tuples(*[st.floats(-1.4, 1.4)] * 3),
    st.floats(0, 60_000),
    st.floats(0, 4_000),
)
@settings(max_examples=200)
def test_drag_never_adds_power(velocity, angles, pwm, lag):
    state = np.zeros(13)
    state[VX : VZ + 1], state[ROLL : YAW + 1], state[LAG] = velocity, angles, lag
    acceleration = derivative(state, [pwm, 0, 0, 0], V)["acceleration"]
    thrust = forces.total_thrust(lag, pwm, 1.0, forces.pack(V)[0])
    without_drag = rotation(*angles)[:, 2] * thrust / V.body_mass - [0, 0, G]
    power = V.body_mass * (acceleration - without_drag) @ velocity
    # m |v| times the rounding of accelerations of about 50 m/s2
    assert power <= V.body_mass * 17.4 * 50 * 1e-15


def test_rotor_speeds_are_continuous_and_zero_without_thrust():
    v = forces.pack(V)[0]
    a, b, floor = V.motor_pwm_to_force
    slope, offset = V.motor_pwm_to_speed
    assert forces.rotor_speed_sum(0.0, v) == forces.rotor_speed_sum(-1.0, v) == 0.0
    below, above = (forces.rotor_speed_sum(4 * floor * (1 + e), v) for e in (-1e-9, 1e-9))
    assert below == pytest.approx(4 * offset, rel=1e-6) and above == pytest.approx(4 * offset, rel=1e-6)
    for pwm in (1_000.0, 30_000.0, 60_000.0):
        force = a * pwm**2 + b * pwm + floor
        assert forces.rotor_speed_sum(4 * force, v) == pytest.approx(4 * (slope * pwm + offset), rel=1e-12)


def test_vehicles_do_not_influence_each_other():
    """Nor where each has a record of its own."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, (7, 13))
    commands = rng.uniform([0, -0.5, -0.5, -3], [60_000, 0.5, 0.5, 3], (7, 4))
    others = [V.changed(body_mass=V.body_mass * (1 + 0.1 * i), effects_wind=(0.5 * i, 0.0)) for i in range(7)]
    for vehicles, packed in (
        ([V] * 7, forces.pack(V)),
        (others, np.concatenate([forces.pack(v) for v in others])),
    ):
        together, conditions = states.copy(), equations.Conditions(packed, np.ones(7), forces.free_air(7))
        equations.advance(together, commands, conditions, True, 0.004, 5)
        for i, v in enumerate(vehicles):
            alone = fly(states[i : i + 1], commands[i], 0.02, 5, True, v)[0]
            np.testing.assert_array_equal(alone, together[i])
