"""inclined_landing.rotors: thrust, lag and drag, every attribute, hook and refusal."""

import math

import mujoco
import numpy as np
import pytest

INTEGRATORS = ("RK4", "Euler", "implicit", "implicitfast", "discrete")
# Both sides evaluate the same few double-precision operations in another order.
ROUNDING = 1e-12


def speed_sum(force, a, b, c, slope, idle, motors):
    """Sum of rotor speeds [rad/s] at total thrust `force` [N], by the textbook quadratic root."""
    each = force / motors
    if each < c:
        return motors * idle * each / c
    pwm = (-b + math.sqrt(b * b - 4 * a * (c - each))) / (2 * a)
    return motors * (slope * pwm + idle)


def drag(build, data, **changed):
    """World drag force (3,) [N] from the equation in plugin/README.md, for `data` as it stands."""
    v = build.vehicle
    values = {
        "state_gain": v.thrust_state_gain,
        "direct_gain": v.thrust_direct_gain,
        "drag": v.drag_coefficients,
        "pwm_to_force": v.motor_pwm_to_force,
        "pwm_to_speed": v.motor_pwm_to_speed,
        "motors": v.motor_count,
    } | changed
    thrust = values["state_gain"] * data.act[0] + values["direct_gain"] * data.ctrl[0]
    speeds = speed_sum(thrust, *values["pwm_to_force"], *values["pwm_to_speed"], values["motors"])
    rotation = data.body("crazyflie").xmat.reshape(3, 3)
    return rotation @ (np.array(values["drag"]) * speeds * (rotation.T @ data.qvel[:3]))


def moving(build, model, pwm=30000.0):
    """The vehicle tilted and under way, lag settled at `pwm`."""
    act = pwm / build.vehicle.thrust_lag_rate
    return build.data(model, [pwm, 0, 0, 0], act, velocity=(1.0, -2.0, 0.5), quat=(0.9, 0.2, -0.3, 0.1))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_step_response_reaches_63_percent_after_one_time_constant(build, integrator):
    rate = build.vehicle.thrust_lag_rate
    model = build(integrator=integrator, timestep=1 / rate / 16)
    data = build.data(model, [20000, 0, 0, 0])
    mujoco.mj_step(model, data, 16)
    # RK4 loses (lambda h)^5/120 per step, 16 (1/16)^5/120 = 1.3e-7 at most; the others are exact
    tolerance = 1.3e-7 if integrator == "RK4" else ROUNDING
    assert data.act[0] * rate / 20000 == pytest.approx(1 - math.exp(-1), abs=tolerance)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"drag": (-1e-6, -2e-6, -3e-6)},
        {"pwm_to_force": (4e-11, 5e-7, 1e-4)},
        {"pwm_to_speed": (0.02, 100.0)},
        {"motors": 6},
    ],
    ids=lambda changed: next(iter(changed), "defaults"),
)
@pytest.mark.parametrize("pwm", [45000.0, 30.0], ids=["above idle force", "below idle force"])
def test_drag_and_its_attributes(build, changed, pwm):
    text = {key: " ".join(map(repr, np.atleast_1d(v).tolist())) for key, v in changed.items()}
    data = moving(build, build(rotors=text), pwm)
    expected = drag(build, data, **changed)
    # the textbook root loses half the digits near PWM 0 (difference of nearly equal numbers)
    np.testing.assert_allclose(data.qfrc_passive[:3], expected, rtol=1e-9)
    np.testing.assert_allclose(data.qfrc_passive[3:], 0, atol=1e-15)


def test_static_map_without_quadratic_term(build):
    data = moving(build, build(rotors={"pwm_to_force": "0 2e-6 1e-4"}), 30000.0)
    expected = drag(build, data, pwm_to_force=(1e-20, 2e-6, 1e-4))
    np.testing.assert_allclose(data.qfrc_passive[:3], expected, rtol=1e-3)
    assert np.isfinite(data.qfrc_passive).all()


def test_drag_acts_at_the_centre_of_mass(build):
    model = build(inertial='pos="0.02 0.01 -0.03" mass="0.03" diaginertia="1e-5 2e-5 3e-5"')
    data = moving(build, model)
    centre = np.array([0.02, 0.01, -0.03])
    force = data.qfrc_passive[:3]
    rotation = data.body("crazyflie").xmat.reshape(3, 3)
    torque = np.cross(centre, rotation.T @ force)
    assert np.linalg.norm(force) > 1e-3
    np.testing.assert_allclose(data.qfrc_passive[3:6], torque, atol=1e-15)
    # turning about the centre of mass leaves it in place: the origin's velocity changes, drag not
    force, spin = force.copy(), np.array([3.0, -2.0, 1.0])
    data.qvel[3:6] = spin
    data.qvel[:3] -= rotation @ np.cross(spin, centre)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_passive[:3], force, rtol=ROUNDING)


def test_drag_is_relative_to_the_wind(build):
    model = build()
    model.opt.wind[:] = (1.0, -2.0, 0.5)
    data = moving(build, model)
    np.testing.assert_allclose(data.qfrc_passive, 0, atol=1e-18)


def test_ground_effect_sees_any_named_surface_with_its_nearest_upper_face(build):
    """A box on the floor under two of the four rotors, half a radius within; not the ball that hangs between.

    Of a disc whose centre is half a radius within the edge 1/2 + (sqrt(3)/4 + pi/6)/pi is over the box, of
    one as far beyond it the rest.
    """
    surfaces = (
        '<geom name="ground" type="plane" size="0 0 1"/>'
        '<geom name="step" type="box" size="0.5 1 0.1" pos="0.5 0 0.1"/>'
        '<geom name="ball" size="0.01" pos="0.05 0.03 0.9"/>'
    )
    xml = build.xml(
        rotors={"ground_effect": "2", "surfaces": "ground step", "arm": "0.05", "disc_height": "0.1",
                "disc_radius": "0.1", "ground_fading": "2"},
        site='<site name="com"/>',
    ).replace("<worldbody>", f"<worldbody>{surfaces}")  # fmt: skip
    data = build.data(mujoco.MjModel.from_xml_string(xml), [build.vehicle.hover_pwm], build.vehicle.hover_lag)
    weight = build.vehicle.body_mass * build.vehicle.environment_gravity
    low, high = (0.25 * weight * 2 * (0.1 / (4 * h)) ** 2 * math.exp((0.4 - h) / 0.5) for h in (0.9, 1.1))
    share = 0.5 + (math.sqrt(3) / 4 + math.pi / 6) / math.pi
    near, far = (s * low + (1 - s) * high for s in (share, 1 - share))  # discs at 1.1 m
    assert data.actuator_force[0] == pytest.approx(weight + 2 * near + 2 * far, rel=1e-9)
    assert data.qfrc_passive[4] == pytest.approx(-2 * 0.05 * (near - far), rel=1e-9)  # nose up
    assert abs(data.qfrc_passive[3]) < 1e-12
