"""The MuJoCo vehicle flies the paper's equations: free flight, both plants, full command bounds.

24 random command sequences of 6 s, RK4 at 4 ms in the engine, far above floor and platform.
"""

import mujoco
import numpy as np
import pytest

from inclined_landing.models import perturbation
from inclined_landing.models.analytic import derivative
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, body_rates, quaternion
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plant import AnalyticPlant, MujocoPlant

V = load_vehicle()
N, STEPS = 24, 300
HEIGHT = 500.0  # m; full thrust up or none at all moves 6 s x up to 60 m/s
FINE = 20  # RK4 steps of 1 ms


def random_commands(seed: int, hold: int = 10) -> np.ndarray:
    """(STEPS, N, 4) commands over the full bounds, new ones every `hold` control steps."""
    low = [V.command_pwm_range[0], -V.command_angle_limit, -V.command_angle_limit, -V.command_yaw_rate_limit]
    high = [V.command_pwm_range[1], *(-x for x in low[1:])]
    draws = np.random.default_rng(seed).uniform(low, high, (STEPS // hold, N, 4))
    return np.repeat(draws, hold, axis=0)


def start_states() -> np.ndarray:
    state = np.zeros((N, 13))
    state[:, 2], state[:, LAG] = HEIGHT, V.hover_lag
    return state


def fly(plant, commands, **changes) -> np.ndarray:
    """States (STEPS, N, 13) under `commands`, with perturbations."""
    plant.set_platform(np.arange(N), V.platform_inclination, False)
    plant.reset(np.arange(N), start_states())
    if changes:
        plant.perturb(**changes)
    history = []
    for row in commands:
        plant.step(row)
        history.append(plant.state.copy())
    return np.array(history)


def largest_errors(a, b) -> tuple[float, float]:
    """(m, deg) largest differences in position and in Euler angles."""
    position = np.abs(a[..., :3] - b[..., :3]).max()
    turns = a[..., ROLL : YAW + 1] - b[..., ROLL : YAW + 1]
    return position, np.degrees(np.abs(np.arctan2(np.sin(turns), np.cos(turns))).max())


def in_mujoco(attitude):
    return MujocoPlant(N, attitude=attitude, torque_limit=False)


def in_equations(attitude, substeps):
    return AnalyticPlant(N, attitude=attitude, substeps=substeps)


@pytest.mark.parametrize("seed", [0, 1])
def test_kinematic_mode_against_fine_equations(seed):
    commands = random_commands(seed)
    pair = fly(in_mujoco("kinematic"), commands), fly(in_equations("kinematic", FINE), commands)
    position, angle = largest_errors(*pair)
    # Measured 1.3e-6 m and 2e-5 deg: RK4's error at 4 ms over 6 s of command steps, times a margin of 10.
    assert position < 2e-5 and angle < 2e-4
    assert np.ptp(pair[0][..., VX : VZ + 1]) > 10  # m/s: the sequences really fly about
    # The lag state obeys the same linear equation; (a h)^5/120 at 4 ms is 7e-9 of 2000 PWM s a step.
    np.testing.assert_allclose(pair[0][..., LAG], pair[1][..., LAG], atol=1e-3)


def test_kinematic_mode_against_the_equations_at_the_control_period():
    commands = random_commands(2)
    position, _ = largest_errors(
        fly(in_mujoco("kinematic"), commands), fly(in_equations("kinematic", 1), commands)
    )
    # 1.4e-4 m measured: the error of RK4 at 0.02 s itself, times a margin of 3.5.
    assert position < 5e-4


@pytest.mark.parametrize("seed", [0, 1])
def test_rate_loop_against_the_extended_equations(seed):
    """Without the torque limit, which the equations do not have."""
    commands = random_commands(seed)
    position, angle = largest_errors(
        fly(in_mujoco("rate_loop"), commands), fly(in_equations("rate_loop", FINE), commands)
    )
    # Measured 6e-6 m at B = 50 1/s: (B h)^5/120 = 2.7e-6 of a rate jump of 6 rad/s per command change,
    # which is 1e-6 rad over 1/B; the limit leaves room for B = 100, five times worse.
    assert position < 1e-4 and angle < 2e-3


def test_the_torque_limit_leaves_roll_and_pitch_alone_at_the_nominal_bandwidth():
    """Full steps about one axis need J B 2 k 30 deg / tau = 5.3 of the 8.5 mN m. (About both axes at once
    the coupling into yaw can exceed the yaw rotor authority for a moment.)"""
    commands = random_commands(3)
    commands[:, : N // 2, 1] = 0.0
    commands[:, N // 2 :, 2] = 0.0
    commands[..., 3] = 0.0
    free = fly(MujocoPlant(N, torque_limit=False), commands)
    np.testing.assert_array_equal(free, fly(MujocoPlant(N), commands))


@pytest.mark.parametrize("rate_loop", [False, True])
def test_accelerations_at_random_states(rate_loop):
    """One mj_forward against one evaluation of the equations."""
    rng = np.random.default_rng(5)
    plant = MujocoPlant(1, torque_limit=False)
    model, data = plant.model, mujoco.MjData(plant.model)
    data.mocap_pos[:, 2] = -100
    for _ in range(100):
        state = np.zeros(13)
        state[:3] = rng.uniform(-1, 1, 3) + [0, 0, 50]
        state[VX : VZ + 1] = rng.uniform(-8, 8, 3)
        state[ROLL : YAW + 1] = rng.uniform([-1.2, -3, -3], [1.2, 3, 3])
        state[LAG] = rng.uniform(500, 4000)
        command = rng.uniform([0, -0.5, -0.5, -3], [60_000, 0.5, 0.5, 3])
        roll, pitch, yaw = state[ROLL : YAW + 1]
        rates = rng.uniform(-3, 3, 3)
        state[WX : WZ + 1] = body_rates(roll, pitch, *rates)
        data.qpos[:], data.qvel[:] = [*state[:3], *quaternion(roll, pitch, yaw)], 0
        data.qvel[:3], data.qvel[3:6], data.act[0] = state[VX : VZ + 1], state[WX : WZ + 1], state[LAG]
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        wanted = derivative(state, command, V, rate_loop)
        # Rounding: accelerations up to 100 m/s2, a few dozen operations.
        np.testing.assert_allclose(data.qacc[:3], wanted["acceleration"], atol=1e-11)
        assert data.act_dot[0] == pytest.approx(wanted["lag_rate"], rel=1e-12, abs=1e-8)
        if rate_loop:
            # d(body rates)/dt by a central difference of body_rates along the Euler motion.
            h, second = 1e-5, wanted["euler_accelerations"]
            ends = [
                body_rates(roll + s * rates[0] * h, pitch + s * rates[1] * h, *(rates + s * second * h))
                for s in (1, -1)
            ]
            body = (np.array(ends[0]) - ends[1]) / (2 * h)
            # Truncation h^2 x third derivatives (3 rad/s x 600 rad/s2 x ...) ~ 1e-6; cancellation 1e-10.
            np.testing.assert_allclose(data.qacc[3:6], body, atol=1e-5, rtol=1e-7)


CHANGES = {
    "thrust_scale": (0.88, 1.05),
    "thrust_bias": (-0.02, 0.03),
    "lag_scale": (0.5, 2.0),
    "drag_change": (-0.8, 1.5),
    "gain_scale": (0.8, 1.2),
    "time_constant_scale": (0.7, 1.5),
    "mass_scale": (0.9, 1.2),
}


def test_every_perturbation_is_covered():
    assert set(CHANGES) == set(perturbation.NAMES)


@pytest.mark.parametrize("attitude", ["kinematic", "rate_loop"])
@pytest.mark.parametrize("name", CHANGES)
def test_perturbations_mean_the_same_in_both_plants(name, attitude):
    commands = random_commands(7)
    values = np.linspace(*CHANGES[name], N)  # one value per vehicle
    changed = fly(in_mujoco(attitude), commands, **{name: values})
    equations = fly(in_equations(attitude, FINE), commands, **{name: values})
    position, angle = largest_errors(changed, equations)
    # The nominal tolerances: a perturbation changes coefficients by less than a factor of two.
    assert (
        (position < 2e-5 and angle < 2e-4) if attitude == "kinematic" else (position < 1e-4 and angle < 2e-3)
    )
    nominal = fly(in_equations(attitude, FINE), commands)
    assert largest_errors(equations, nominal)[0] > 0.01  # and it does change the flight


@pytest.mark.parametrize("build", [in_mujoco, lambda a: in_equations(a, 1)], ids=["mujoco", "analytic"])
def test_the_neutral_perturbation_changes_no_bit(build):
    commands = random_commands(8)[:60]
    plain = fly(build("rate_loop"), commands)
    neutral = dict(zip(perturbation.NAMES, perturbation.NEUTRAL))
    np.testing.assert_array_equal(fly(build("rate_loop"), commands, **neutral), plain)
    plant = build("rate_loop")
    plant.perturb(thrust_scale=1.1, mass_scale=1.1)  # there and back: the engine's fields are expanded now
    np.testing.assert_array_equal(fly(plant, commands, **neutral), plain)


@pytest.mark.parametrize("integrator, orders", [("RK4", 4), ("implicitfast", 1)])
def test_order_of_the_engines_integrators(integrator, orders):
    """Halving the time step divides the position error by 2^order."""
    commands = random_commands(9)[:50]

    def end(timestep):
        plant = MujocoPlant(N, integrator=integrator, timestep=timestep, torque_limit=False)
        return fly(plant, commands)[-1, :, :3]

    fine = fly(in_equations("rate_loop", 80), commands)[-1, :, :3]
    errors = [np.abs(end(step) - fine).max() for step in (0.004, 0.002, 0.001)]
    measured = np.log2(np.divide(errors[:-1], errors[1:]))
    # Asymptotic orders; at 4 ms B h = 0.2 and the next term is of that relative size.
    assert np.all(np.abs(measured - orders) < 0.5), (errors, measured)


@pytest.mark.parametrize("changes, sentence", [
    ({"wind": 1.0}, "unknown perturbation 'wind'; known are thrust_scale"),
    ({"mass_scale": 0.0}, "perturbation mass_scale must be finite and scales must be positive"),
    ({"lag_scale": -1.0}, "lag_scale"),
    ({"thrust_bias": np.nan}, "thrust_bias"),
])  # fmt: skip
def test_wrong_perturbations_are_refused(changes, sentence):
    from inclined_landing.models.errors import UserError

    plant = AnalyticPlant(2)
    with pytest.raises(UserError, match=sentence):
        plant.perturb(**changes)
    assert (plant.perturbation == perturbation.NEUTRAL).all()
