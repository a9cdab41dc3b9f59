"""The library of effects: complete, neutral when neutral, and the same in both plants.

Free flights are those of the equivalence tests: full command bounds for 3 s, RK4 at 4 ms in the engine
without torque limit, the equations with the rate loop at the same step. The tolerances are the nominal
ones, because an effect changes coefficients by less than a factor of two.
"""

import dataclasses
import functools
import itertools
import math
import re

import mujoco
import numpy as np
import pytest
from scipy.signal import detrend

from inclined_landing.eval.gap.answer.rollout import RolloutWindows, simulate
from inclined_landing.eval.gap.measured.windows import prepare
from inclined_landing.eval.gap.model.prediction import predict, predictor
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.truth.equivalence.flying import UNLIMITED, full_steps, largest_gaps, start_states
from inclined_landing.eval.truth.equivalence.levels import FLIGHT_LIMITS
from inclined_landing.models import effects, forces, geometry
from inclined_landing.models.attitude import LAG, PITCH, PWM, ROLL, VX, VY, VZ, WX, YAW, X, Z, quaternion
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import CHANNELS, LIBRARY, REGIMES
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.plants import MujocoPlant, make_plant
from inclined_landing.models.scene import build_spec

V = load_vehicle()
METRES, DEGREES = FLIGHT_LIMITS["rate_loop"]
N = 4
COMMANDS = full_steps(V, N, np.random.default_rng(4))[:150]
TOUCHDOWN = [name for name, effect in LIBRARY.items() if effect.contact]
# Flights high above everything show the others.
FREE = [
    name
    for name, effect in LIBRARY.items()
    if "near_surface" not in effect.regimes and effect.channels not in (("touchdown",), ("requests",))
]
BOTH = ("mujoco", "analytic")
WEIGHT = V.body_mass * V.environment_gravity
ALPHA = V.platform_inclination
# The pitch caused by a centre of mass 1 mm off: the loop's stiffness is B/tau inertia.
TILT = 0.001 * WEIGHT * V.attitude_time_constant / (V.attitude_bandwidth * V.body_inertia[1])


def changed(name: str, **values):
    """The shipped vehicle with one effect, at its plausible size unless values are given."""
    return LIBRARY[name].apply(V, values or LIBRARY[name].plausible)


def everything():
    """The vehicle with every effect at once, at half their plausible sizes."""
    vehicle = V
    for name, effect in LIBRARY.items():
        half = {p.name: 0.5 * (p.neutral + p.plausible) for p in effect.parameters}
        vehicle = LIBRARY[name].apply(vehicle, half)
    return vehicle


def plant_of(kind: str, n: int, vehicle, **options):
    """The pair of plants that must agree."""
    own = {"attitude": "rate_loop", "substeps": 5} if kind == "analytic" else {}
    vehicle = vehicle.changed(**UNLIMITED) if kind == "mujoco" else vehicle
    return make_plant(kind, n, vehicle, **(own | options))


def fly(plant, commands=COMMANDS, starts=None, platform=False):
    """What is measured after every control step, (steps, n, 13)."""
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, plant.vehicle.platform_inclination, platform)
    plant.reset(everyone, start_states(plant.n, vehicle=plant.vehicle) if starts is None else starts)
    rows = []
    for row in commands:
        plant.step(row)
        rows.append(plant.measurement.copy())
    return np.array(rows)


@functools.cache
def nominal_flight():
    return fly(plant_of("analytic", N, V))


def hold(plant, steps: int, pwm: float, state=None, roll=0.0, pitch=0.0) -> np.ndarray:
    """One vehicle under constant commands; (steps, 13) states."""
    start = start_states(1, vehicle=plant.vehicle) if state is None else state
    return fly(plant, np.tile([pwm, roll, pitch, 0.0], (steps, 1, 1)), start)[:, 0]


# --- the library -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LIBRARY)
def test_every_effect_is_complete(name):
    effect = LIBRARY[name]
    assert effect.name == name
    for text in (effect.description, effect.formula, effect.source, effect.remedy):
        assert len(text) > 8
    assert effect.parameters and effect.regimes and effect.channels
    assert set(effect.regimes) <= set(REGIMES) and set(effect.channels) <= set(CHANNELS)
    assert set(effect.confused_with) <= set(LIBRARY) - {name}
    derived = {"yaw_rate_command", "request_differences"}  # of a flight cut into windows
    assert set(effect.requires) <= {f.name for f in dataclasses.fields(FlightLog)} | derived
    says = effect.says.format(**{p.name: f"[{p.name}]" for p in effect.parameters})
    assert all(f"[{p.name}]" in says or p.is_reference for p in effect.parameters)
    for p in effect.parameters:
        low, high = p.bounds
        assert low <= p.neutral <= high and low < p.plausible < high and p.unit
        assert 0 < p.negligible < high - low
        assert not (p.one_signed and -low > 0.1 * (high - low))  # room for noise only
        if p.reported:  # what identify reports is a field that the effect changes
            moved = effect.apply(V, {p.name: p.plausible})
            changed_fields = {
                f.name for f in dataclasses.fields(V) if getattr(moved, f.name) != getattr(V, f.name)
            }
            assert p.fields[0].partition(".")[0] in changed_fields
    first = effect.parameters[0]
    assert abs(first.plausible - first.neutral) > first.negligible
    # Every size within the bounds can be flown.
    for corner in itertools.product(*(p.bounds for p in effect.parameters)):
        vehicle = effect.apply(V, {p.name: value for p, value in zip(effect.parameters, corner)})
        build_spec(vehicle, visuals=False).compile()


@pytest.mark.parametrize("name", LIBRARY)
def test_neutral_parameters_change_nothing(name):
    effect = LIBRARY[name]
    for vehicle in (V, everything()):
        assert effect.apply(vehicle, effect.neutral) == vehicle
        assert effect.apply(vehicle, {}) == vehicle
    assert effect.apply(V, effect.plausible) != V


def test_every_effect_of_the_vehicle_file_belongs_to_the_library():
    fields = {f.name for f in dataclasses.fields(V) if f.name.startswith("effects_")}
    touched = {f for f in fields if getattr(everything(), f) != getattr(V, f)}
    assert {f for f in fields if not f.startswith("effects_voltage_")} - touched <= {
        "effects_battery_reference"  # its plausible value is the shipped one
    }


def test_unknown_effects_and_parameters_are_refused():
    with pytest.raises(UserError, match=r"unknown effect 'gremlins'; choose from .*, such as thrust_scale"):
        effects.apply(V, {"gremlins": {}})
    with pytest.raises(UserError, match="effect wind has no parameter 'z'; choose from x, y"):
        effects.apply(V, {"wind": {"z": 1.0}})
    together = effects.apply(V, {"wind": {"x": 1.0}, "mass": {"scale": 1.1}})
    assert together.effects_wind == (1.0, 0.0) and together.body_mass == V.body_mass * 1.1


def test_effects_come_on_top_of_what_the_vehicle_has():
    twice = changed("thrust_scale", scale=0.9)
    twice = LIBRARY["thrust_scale"].apply(twice, {"scale": 0.5})
    assert twice.thrust_per_pwm == pytest.approx(0.45 * V.thrust_per_pwm)
    # Where the slopes of two sags cancel, a constant is left: to within load over farthest reference, 1e-3.
    for slope in (0.1 / 50_000.0, 0.1 / 50_000.0 * (1.0 + 1e-9)):
        two = {"sag": -slope * 30_000.0, "reference": 30_000.0}
        both = LIBRARY["battery_sag"].apply(changed("battery_sag", sag=0.1, reference=50_000.0), two)
        for load in (10_000.0, 60_000.0):
            sag = both.effects_battery_sag * (load / both.effects_battery_reference - 1)
            assert sag == pytest.approx(-0.1 + slope * 30_000.0, rel=1e-3)


ABOUT = [name for name, effect in LIBRARY.items() if effect.reference]


@pytest.mark.parametrize("name", ABOUT)
def test_a_size_about_a_reference_is_two_sizes_about_both_of_its_sides(name):
    effect = LIBRARY[name]
    low, high = effect.reference.either_side()
    assert effect.reference.bounds[0] <= low <= effect.reference.neutral < high <= effect.reference.bounds[1]
    for value in (0.12, -0.3):
        for about in (low, high, 0.3 * low + 0.7 * high, high + 0.2 * (high - low)):
            assert effect.from_ends(*effect.at_ends(value, about)) == pytest.approx((value, about), rel=1e-12)
    assert effect.at_ends(0.12, low) == pytest.approx((0.12, 0.0), abs=1e-15)
    assert effect.at_ends(0.12, high) == pytest.approx((0.0, 0.12), abs=1e-15)


def test_a_sag_relative_to_nothing_is_refused():
    with pytest.raises(UserError, match="battery_reference of the vehicle is 0"):
        forces.settled_hover(V.changed(effects_battery_reference=0.0))


@pytest.mark.parametrize("name", ["thrust_curve", "battery_sag", "battery_voltage"])
def test_what_is_linear_does_the_same_about_both_sides(name):
    effect, about = LIBRARY[name], LIBRARY[name].reference
    sides, size = about.either_side(), effect.parameters[0].name
    for vehicle in (V, everything()):
        for reference in (0.8 * sides[0] + 0.2 * sides[1], 1.1 * sides[1] - 0.1 * sides[0]):
            once = effect.apply(vehicle, {size: 0.12, about.name: reference})
            twice = vehicle
            for part, side in zip(effect.at_ends(0.12, reference), sides):
                twice = effect.apply(twice, {size: part, about.name: side})
            for f in dataclasses.fields(V):
                wanted = getattr(once, f.name)
                assert wanted == getattr(twice, f.name) or getattr(twice, f.name) == pytest.approx(
                    wanted, rel=1e-9
                ), f.name


@pytest.mark.parametrize("name", LIBRARY)
def test_sizes_of_times_and_drags_are_those_of_the_quantity(name):
    """Nothing changes beside the shipped vehicle; of half a constant, as much is twice the share."""
    effect = LIBRARY[name]
    for p in effect.parameters:
        if not (p.is_factor and p.reported):
            assert p.is_reference or p.fields or p.sized_for(V) == p
            continue
        assert p.sized_for(V) == dataclasses.replace(p, bounds=p.sized_for(V).bounds)
        if not (p.reported_unit == "s" or "." in p.fields[0]):
            continue
        half = effect.apply(V, {q.name: 0.5 for q in effect.parameters if q.is_factor})
        own = p.sized_for(half)
        assert own.negligible == pytest.approx(2.0 * p.negligible, rel=1e-5)
        assert abs(own.plausible - 1.0) == pytest.approx(2.0 * abs(p.plausible - 1.0), rel=1e-5)
        assert own.bounds[0] < own.plausible < own.bounds[1]


# --- both plants -------------------------------------------------------------------------------------


def test_sizes_go_with_the_vehicle():
    """Forces by weight, air speeds by the hover inflow sqrt(m)/r, lengths by arm or rotor."""
    heavy = V.changed(body_mass=4.0 * V.body_mass, rotor_arm=3.0 * V.rotor_arm)
    wide = V.changed(rotor_radius=2.0 * V.rotor_radius)
    for name, parameter, by_mass, by_radius in [
        ("thrust_bias", "force", 4.0, 1.0),
        ("slung_load", "mass", 4.0, 1.0),
        ("body_drag", "coefficient", 4.0 ** (2.0 / 3.0), 1.0),
        ("wind", "x", 2.0, 0.5),
        ("axial_inflow", "coefficient", 0.5, 2.0),
        ("translational_lift", "coefficient", 0.25, 4.0),
        ("ground_effect", "fading", 1.0, 0.5),
        ("ground_effect", "strength", 1.0, 1.0),
        ("com_offset", "x", 3.0, 1.0),  # by the arm
    ]:
        own = LIBRARY[name].parameter(parameter)
        for vehicle, times in ((heavy, by_mass), (wide, by_radius)):
            there = own.sized_for(vehicle)
            sizes = [(p.plausible, p.negligible, *p.bounds) for p in (there, own)]
            np.testing.assert_allclose(sizes[0], np.multiply(times, sizes[1]), rtol=1e-12)


@pytest.mark.parametrize("name", FREE)
def test_both_plants_fly_the_effect_alike(name):
    vehicle = changed(name)
    flights = [fly(plant_of(kind, N, vehicle)) for kind in BOTH]
    position, angle = largest_gaps(*flights)
    assert position < METRES and angle < DEGREES
    metres, degrees = largest_gaps(flights[1], nominal_flight())
    assert metres > 100 * METRES or degrees > 100 * DEGREES  # and it changes the flight


def test_both_plants_fly_all_effects_at_once_with_scaled_thrust():
    """Delays of 10 and 20 ms, wind, battery, drag, offset and the rest, each vehicle with another thrust."""
    vehicle, scale = everything(), np.linspace(0.9, 1.1, N)
    flights = []
    for kind in BOTH:
        plant = plant_of(kind, N, vehicle)
        plant.set_thrust_scale(scale)
        flights.append(fly(plant))
    position, angle = largest_gaps(*flights)
    assert position < METRES and angle < DEGREES


def test_both_plants_see_the_same_edges_of_the_slab():
    """The force on a vehicle at rest anywhere around the slab, with any attitude, partly over its edges."""
    vehicle, rng = changed("ground_effect", strength=20.0, fading=10.0), np.random.default_rng(1)
    model, v = MujocoPlant(1, vehicle).model, forces.pack(vehicle)[0]
    data, seen = mujoco.MjData(model), set()
    for _ in range(300):
        inclination = rng.uniform(-0.8, 0.8)
        position = rng.uniform([-0.6, -0.4, 0.02], [0.6, 0.4, 1.8])
        angles = rng.uniform([-0.8, -0.8, -3], [0.8, 0.8, 3])
        above = math.sin(inclination) * position[0]
        above += math.cos(inclination) * (position[2] - vehicle.platform_surface_height)
        if abs(above) < 0.07:  # rotors inside the slab
            continue
        poses, turns = geometry.platform_poses([inclination], [True], vehicle)
        for k, name in enumerate(geometry.PLATFORM_BODIES):
            mocap = model.body(name).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = poses[0, k], turns[0, k]
        data.qpos[:] = [*position, *quaternion(*angles)]
        data.act[:], data.ctrl[0] = V.hover_lag, V.hover_pwm
        mujoco.mj_forward(model, data)
        frame = data.body("crazyflie").xmat.reshape(3, 3)
        extra, x, y = forces.ground_effect(position, tuple(frame.ravel()), WEIGHT, inclination, 1.0, 0.0, v)
        assert data.actuator_force[0] == pytest.approx(WEIGHT + extra, rel=1e-9)
        # qfrc_passive of a free joint: force in the world, torque in the body's axes; no speed, no drag
        np.testing.assert_allclose(data.qfrc_passive[:6], [0, 0, 0, x, y, 0], atol=1e-12)
        seen.add((above > 0, extra > 1e-3))
    assert len(seen) == 4


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_the_saved_xml_flies_with_the_effects(integrator):
    """Plain MuJoCo, from the XML text alone, flies as the plant does."""
    vehicle = everything()
    spec = build_spec(vehicle, visuals=False, integrator=integrator)
    spec.compile()
    model = mujoco.MjModel.from_xml_string(re.sub(r' meshdir="[^"]*"', "", spec.to_xml()))
    data = mujoco.MjData(model)
    plant = MujocoPlant(1, vehicle, integrator=integrator)
    start = start_states(1, vehicle=vehicle)
    start[0, Z] = 1.6
    plant.reset([0], start)
    data.qpos[:7] = [*start[0, :3], 1, 0, 0, 0]  # behind it the slung load, which hangs straight down
    data.act[model.actuator("thrust").actadr] = start[0, LAG]
    for actuator in range(4):  # MuJoCo's own past is all zeros
        samples = model.actuator_history[actuator, 0]
        mujoco.mj_initCtrlHistory(model, data, actuator, None, np.full(samples, COMMANDS[0, 0, actuator]))
    for row in COMMANDS[:40, :1]:
        plant.step(row)
        data.ctrl[:] = row
        mujoco.mj_step(model, data, plant.substeps)
        # the XML text has fewer digits than the numbers
        np.testing.assert_allclose(plant.state[0, :3], data.qpos[:3], atol=1e-7)
        np.testing.assert_allclose(plant.state[0, VX : VZ + 1], data.qvel[:3], atol=1e-6)


# --- histories ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", BOTH)
def test_a_delay_shifts_the_commands(kind):
    """Three control periods later, held at the first command before."""
    vehicle = changed("thrust_delay", delay=0.06)
    vehicle = LIBRARY["attitude_delay"].apply(vehicle, {"delay": 0.06})
    late = fly(plant_of(kind, N, vehicle), COMMANDS[:60])
    shifted = np.concatenate([np.repeat(COMMANDS[:1], 3, axis=0), COMMANDS[:57]])
    np.testing.assert_allclose(late, fly(plant_of(kind, N, V), shifted), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", BOTH)
def test_the_measurement_is_late_and_the_flight_is_not(kind):
    flown, plain = plant_of(kind, N, changed("mocap_delay", delay=0.05)), plant_of(kind, N, V)
    starts = start_states(N, np.linspace(3.0, 3.2, N))  # the heading passes +-pi
    measured, states = fly(flown, COMMANDS, starts), fly(plain, COMMANDS, starts)
    np.testing.assert_array_equal(flown.state, plain.state)
    between = 0.5 * (states[7:-3] + states[8:-2])
    np.testing.assert_allclose(measured[10:, :, :3], between[..., :3], atol=1e-12)
    turn = states[8:-2, :, YAW] - states[7:-3, :, YAW]
    half = states[7:-3, :, YAW] + 0.5 * np.arctan2(np.sin(turn), np.cos(turn))
    assert (np.abs(turn) > 3).any() == (kind == "mujoco")  # whose heading jumps from pi to -pi
    np.testing.assert_allclose(np.exp(1j * measured[10:, :, YAW]), np.exp(1j * half), atol=1e-12)


# --- what physics says -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", BOTH)
def test_a_sagging_battery_needs_more_pwm_to_hover(kind):
    """At PWM P the steady thrust is P thrust_per_pwm (1 - sag (P/reference - 1)); its root carries."""
    sag, reference = 0.15, 25_000.0
    vehicle = changed("battery_sag", sag=sag, reference=reference)
    ratio = V.hover_pwm / reference
    pwm = reference * ((1 + sag) - math.sqrt((1 + sag) ** 2 - 4 * sag * ratio)) / (2 * sag)
    assert pwm > 1.02 * V.hover_pwm
    start = start_states(1)
    start[0, LAG] = pwm / V.thrust_lag_rate
    speed = hold(plant_of(kind, 1, vehicle), 100, pwm, start)[:, VZ]
    assert np.abs(speed).max() < 1e-9


def test_the_static_map_is_a_line_and_a_curve():
    """Quadratic in the steady PWM: with the line through its zeros, curvature and line are the map itself."""
    a, b, c = (V.motor_count * x for x in V.motor_pwm_to_force)
    near, far = sorted(-np.roots([a, b, c]))
    reference = 34_100.0
    curvature = reference / (far + reference)
    line = dataclasses.replace(
        V,
        thrust_state_gain=a * far / (1.0 - curvature) * V.thrust_lag_rate,
        thrust_direct_gain=0.0,
        effects_thrust_bias=a * far / (1.0 - curvature) * near,
    )
    values = {"curvature": curvature, "reference": reference}
    v = forces.pack(LIBRARY["thrust_curve"].apply(line, values))[0]
    for pwm in (10_000.0, 34_100.0, 60_000.0):
        lag = pwm / V.thrust_lag_rate
        thrust = forces.total_thrust(lag, pwm, 1.0, v)
        thrust = forces.powered_thrust(thrust, lag, 0.0, math.nan, v)
        assert thrust == pytest.approx(a * pwm**2 + b * pwm + c, rel=1e-9)
    opposite = LIBRARY["battery_sag"].apply(line, {"sag": -curvature, "reference": reference})
    assert opposite == LIBRARY["thrust_curve"].apply(line, values)


@pytest.mark.parametrize("kind", BOTH)
def test_fade_and_discharge_follow_the_time_since_the_reset(kind):
    vehicle = changed("thrust_fade", rate=0.01)
    plant = plant_of(kind, 1, vehicle)
    hold(plant, 10, V.hover_pwm)
    states = hold(plant, 100, V.hover_pwm)  # begins at time 0 again
    # m dv/dt = -W rate t - vertical drag; without drag v = -g rate t^2/2 (drag: 2 % within 2 s)
    assert states[-1, VZ] == pytest.approx(-9.81 * 0.01 * 2.0**2 / 2, rel=0.2)
    voltage = changed("battery_voltage", sensitivity=0.3, reference=V.effects_voltage_open)
    fall = V.effects_voltage_drop * V.hover_pwm
    states = hold(plant_of(kind, 1, voltage), 10, V.hover_pwm)
    assert states[0, VZ] == pytest.approx(-9.81 * 0.3 * fall * 0.02, rel=0.02)


@pytest.mark.parametrize("kind", BOTH)
def test_a_vehicle_without_tilt_drifts_with_the_wind(kind):
    """Time constant of the linear drag: m/(K w) = 5 s; body drag makes it faster."""
    vehicle = changed("wind", x=0.8, y=-0.4)
    vehicle = LIBRARY["body_drag"].apply(vehicle, {"coefficient": 0.05})
    states = hold(plant_of(kind, 1, vehicle), 1500, V.hover_pwm)
    np.testing.assert_allclose(states[-1, [VX, VY]], [0.8, -0.4], atol=0.01)
    assert abs(states[-1, VZ]) < 1e-9


@pytest.mark.parametrize("kind", BOTH)
def test_an_estimate_without_drag_leans_into_the_motion(kind):
    """Commanded level at 1 m/s to forward and left: the angles settle at lean times the speed still left."""
    start = start_states(1, np.array([0.5]))
    start[0, VX : VZ + 1] = [math.cos(0.5) - math.sin(0.5), math.sin(0.5) + math.cos(0.5), 0.0]
    states = hold(plant_of(kind, 1, changed("estimator_lean", lean=0.02)), 60, V.hover_pwm, start)
    x, y = states[:, VX], states[:, VY]
    forward, left = math.cos(0.5) * x + math.sin(0.5) * y, math.cos(0.5) * y - math.sin(0.5) * x
    # After 1.2 s = 6.5 tau; the speed grows by lean g v, 0.2 v per second, which the loop lags by 0.2 s.
    assert states[-1, PITCH] == pytest.approx(0.02 * forward[-1], rel=0.05)
    assert states[-1, ROLL] == pytest.approx(-0.02 * left[-1], rel=0.05)


@pytest.mark.parametrize("kind", BOTH)
def test_rising_air_speed_changes_the_thrust(kind):
    start = start_states(1)
    start[0, VZ] = 2.0
    slow = hold(plant_of(kind, 1, changed("axial_inflow", coefficient=0.1)), 1, V.hover_pwm, start)
    plain = hold(plant_of(kind, 1, V), 1, V.hover_pwm, start)
    assert (slow - plain)[0, VZ] == pytest.approx(-9.81 * 0.1 * 2.0 * 0.02, rel=0.02)
    start[0, [VX, VY, VZ]] = [3.0, -4.0, 0.0]
    lift = hold(plant_of(kind, 1, changed("translational_lift", coefficient=0.02)), 1, V.hover_pwm, start)
    plain = hold(plant_of(kind, 1, V), 1, V.hover_pwm, start)
    assert (lift - plain)[0, VZ] == pytest.approx(9.81 * 0.02 * 25.0 * 0.02, rel=0.02)


@pytest.mark.parametrize("kind", BOTH)
def test_a_slope_turns_the_vehicle_away_from_itself(kind):
    """The platform rises towards +x at negative inclination: the front rotors gain, the nose goes up."""
    for inclination, sign in ((-0.4, -1), (0.4, 1)):
        plant = plant_of(kind, 1, changed("ground_effect"))
        plant.set_platform([0], inclination)
        start = start_states(1)
        start[0, Z] = V.platform_surface_height + 0.1
        plant.reset([0], start)
        for _ in range(10):
            plant.step(np.array([[V.hover_pwm, 0, 0, 0]]))
        assert sign * plant.state[0, PITCH] > 1e-3 and abs(plant.state[0, ROLL]) < 1e-9
        assert plant.state[0, VZ] > 0.01


def gain_over(x, height=0.08, strength=5.0, fading=5.0):
    """Share of the weight gained and torque about y [N m], level at x over a level slab."""
    vehicle = changed("ground_effect", strength=strength, fading=fading)
    position = np.array([x, 0.0, V.platform_surface_height + height - V.rotor_height])
    v = forces.pack(vehicle)[0]
    extra, _, torque = forces.ground_effect(position, tuple(np.eye(3).ravel()), WEIGHT, 0.0, 1.0, 0.0, v)
    return extra / WEIGHT, torque


def test_ground_effect_has_a_strength_and_a_fading():
    """All over the slab: strength (r/4h)^2 at four radii, sooner gone with fading, thrust at most doubled."""
    r = V.rotor_radius
    assert gain_over(0.0, 4 * r)[0] == pytest.approx(5.0 / 16**2, rel=1e-12)
    for h in (0.06, 0.15):
        wanted = 5.0 * (r / (4 * h)) ** 2 * math.exp((4 * r - h) * 5.0)
        assert gain_over(0.0, h)[0] == pytest.approx(wanted, rel=1e-12)
    assert gain_over(0.0, 0.15, fading=20.0)[0] < 0.5 * gain_over(0.0, 0.15)[0]
    assert gain_over(0.0, 0.012, strength=40.0)[0] == 1.0


def test_a_rotor_over_an_edge_gains_its_share():
    """Half of it with its axis above the edge; smooth all the way from over the slab to beyond it."""
    inner, outer = V.slab_half_length - V.rotor_arm, V.slab_half_length + V.rotor_arm
    whole, torque = gain_over(0.0)
    assert torque == pytest.approx(0.0, abs=1e-15)
    assert gain_over(inner)[0] == pytest.approx(0.75 * whole, rel=1e-2)  # the floor far below adds 0.5 %
    assert gain_over(outer)[0] == pytest.approx(0.25 * whole, rel=2e-2)
    beyond, _ = gain_over(outer + V.rotor_radius)
    x = np.linspace(inner - 0.05, outer + 0.05, 2001)
    gains, torques = np.array([gain_over(one) for one in x]).T
    assert (np.diff(gains) <= 1e-15).all() and gains[-1] == pytest.approx(beyond, rel=1e-12)
    # The share of a disc changes by at most 2/(pi r) per metre, of two of the four at a time.
    steepest = 0.5 * whole * 2 / (math.pi * V.rotor_radius)
    assert np.abs(np.diff(gains) / np.diff(x)).max() <= steepest
    assert torques.min() > -1e-15 and torques.max() == pytest.approx(
        0.5 * V.rotor_arm * whole * WEIGHT, rel=0.02
    )  # rear rotors over the slab, front ones beyond: the nose goes down


@pytest.mark.parametrize("kind", BOTH)
def test_a_tilted_level_shows_in_the_true_attitude_only(kind):
    """The loops hold the measured angles at gain times command; tilts and angles are small: 1 % of them."""
    roll, pitch = 0.03, -0.02
    plant = plant_of(kind, 1, changed("level_calibration", roll=roll, pitch=pitch))
    measured = hold(plant, 150, V.hover_pwm, roll=0.04, pitch=-0.05)[-1, [ROLL, PITCH]]
    wanted = V.attitude_gain * np.array([0.04, -0.05])
    np.testing.assert_allclose(measured, wanted, atol=3e-4)
    np.testing.assert_allclose(plant.state[0, [ROLL, PITCH]], wanted - [roll, pitch], atol=3e-4)


def flight_of(vehicle):
    """A flight of the vehicle with turning heading, cut into windows."""
    rng = np.random.default_rng(5)
    commands = np.zeros((300, 1, 4))
    commands[:, 0, PWM] = V.hover_pwm * np.repeat(rng.uniform(0.96, 1.04, 20), 15)
    commands[:, 0, 1:3] = np.repeat(rng.uniform(-0.2, 0.2, (20, 2)), 15, axis=0)
    commands[:, 0, 3] = np.repeat(rng.uniform(0.0, 2.0, 20), 15)
    flown = fly(plant_of("analytic", 1, vehicle), commands)[:, 0]
    log = FlightLog(
        "flown", np.arange(299) * 0.02, flown[:-1, X : Z + 1], flown[:-1, ROLL:WX], commands[1:, 0]
    )
    return prepare(log, V)


@pytest.mark.parametrize(
    "first", ["thrust_scale", "mocap_tilt", "com_offset", "slung_load", "estimator_lean"]
)
def test_vehicles_are_predicted_together_as_one_by_one(first):
    flight, vehicle = flight_of(V), changed(first)
    vehicles = [vehicle, *(e.apply(vehicle, e.plausible) for e in LIBRARY.values())]
    alone = np.stack([predict(flight, v) for v in vehicles])
    together = predictor(flight, vehicles)(flight)
    atol = 2e-4 * np.ptp(alone) if first == "slung_load" else 0.0  # one step of Newton to a swing's start
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=atol)


# Velocities are smoothed over 0.1 s, and one leans by their error; what an integral has of the start at rest
# dies away with its own rate, 0.5 1/s.
COARSE = ("estimator_lean", "attitude_integral", "attitude_saturation")


@pytest.mark.parametrize("name", ["level_calibration", "mocap_tilt", "attitude_trim", "yaw_loop", *COARSE])
def test_the_prediction_along_a_flight_knows_the_attitude_effects(name):
    """Positions up to the line that the start state is, angles once the start has died away."""
    vehicle = changed(name)
    flight = flight_of(vehicle)

    def error(v):
        windows = flight.cut(flight.measured - predict(flight, v))[5:]  # (w, rows, 6)
        angles = windows[..., 3:] - windows[:, :1, 3:] * [0, 0, 1]
        return np.abs(detrend(windows[..., :3], axis=1)).max(), np.abs(angles).max()

    (metres, radians), nominal = error(vehicle), error(V)
    assert metres < 2e-4 and radians < (2e-4 if name in COARSE else 1e-5)
    assert nominal[0] > 5 * metres or nominal[1] > 5 * radians


@pytest.mark.parametrize("kind", BOTH)
def test_the_heavy_side_goes_down(kind):
    states = hold(plant_of(kind, 1, changed("com_offset", x=0.001, y=0.0)), 200, V.hover_pwm)
    assert states[-1, PITCH] == pytest.approx(TILT, rel=0.01)
    left = hold(plant_of(kind, 1, changed("com_offset", x=0.0, y=0.001)), 200, V.hover_pwm)
    assert left[-1, ROLL] < -0.9 * TILT * V.body_inertia[1] / V.body_inertia[0]


@pytest.mark.parametrize("kind", ["analytic", "mujoco", "hybrid"])
def test_an_integral_trims_a_moment_away_up_to_its_limit(kind):
    """From the angle without it: integral I = angle, or what the limit leaves of it."""
    rate, vehicle = 2.0, changed("com_offset", x=0.001, y=0.0).changed(effects_attitude_integral=2.0)
    for limit, left in ((0.3, 0.0), (0.25 * TILT / rate, 0.75 * TILT)):
        plant = plant_of(kind, 1, vehicle.changed(attitude_integral_limit=limit))
        pitch = hold(plant, 350, V.hover_pwm)[:, PITCH]
        # The slowest pole, -3.2 1/s, leaves 2e-10 in 7 s; the step that reaches the limit is of 4 ms tilt.
        assert pitch[-1] == pytest.approx(left, abs=0.004 * rate * TILT if left else 1e-3 * TILT)
        assert plant.integral[0, 1] * rate == pytest.approx(pitch[-1] - TILT, rel=1e-2)


@pytest.mark.parametrize("kind", ["analytic", "mujoco", "hybrid"])
def test_the_loops_take_over_the_moment_of_a_centre_of_mass(kind):
    """It tilts the vehicle at first, and no more after a few times 1/hold; a vehicle that stands so stays."""
    vehicle = changed("com_offset", x=0.001, y=0.0, hold=2.0)
    pitch = hold(plant_of(kind, 1, vehicle), 350, V.hover_pwm)[:, PITCH]
    # tilt (exp(-hold t) - exp(-t/tau))/(1 - hold tau) is 0.56 tilt at most; exp(-2 * 7) = 8e-7 is left.
    assert 0.3 * TILT < pitch.max() < 0.7 * TILT and abs(pitch[-1]) < 1e-4 * TILT
    still, state = plant_of(kind, 1, V.changed(effects_attitude_hold=2.0)), start_states(1)
    state[0, PITCH] = 0.1
    pitch = hold(still, 50, V.hover_pwm, state, pitch=0.1 / V.attitude_gain)[:, PITCH]
    np.testing.assert_allclose(pitch, 0.1, atol=1e-6)


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("attitude", ["rate_loop", "kinematic"])
def test_a_saturated_loop_turns_at_its_largest_rate(kind, attitude):
    """A step that wants 2.4 rad/s: after 0.1 s, 5 time constants of the rate loop, and up to 0.7 s."""
    plant = make_plant(kind, 1, V.changed(effects_attitude_saturation=2.0), attitude=attitude)
    roll = hold(plant, 20, V.hover_pwm, roll=0.4)[:, ROLL]
    np.testing.assert_allclose(np.diff(roll)[5:], 0.5 * 0.02, rtol=0.01)


@pytest.mark.parametrize("plant", BOTH)
def test_a_rollout_begins_with_the_integrals_of_the_flight(plant):
    vehicle = changed("attitude_integral", rate=2.0)
    starts = RolloutWindows.of([flight_of(vehicle)])
    ends = [(simulate(starts, v, plant) - starts.measured())[:, -1, 3:5] for v in (vehicle, V)]
    known, forgotten = (np.abs(end).max() for end in ends)
    # Start rates smoothed over 0.1 s err by at most the steps of commands, gone by exp(-1 s/tau) = 4e-3.
    assert known < 1e-3 < 1e-2 < forgotten


@pytest.mark.parametrize(
    "options", [("analytic", {}), ("mujoco", {}), ("mujoco", {"integrator": "implicitfast"})]
)
def test_slower_spin_down_is_exact(options):
    kind, own = options
    plant = plant_of(kind, 1, changed("spin_down", excess=1.0), **own)
    states = hold(plant, 5, 10_000.0)
    rate = V.thrust_lag_rate / 2
    end = 10_000.0 / V.thrust_lag_rate
    wanted = end + (V.hover_lag - end) * math.exp(-rate * 0.1)
    assert states[-1, LAG] == pytest.approx(wanted, rel=1e-7)  # RK4 at 4 ms: (rate h)^5/120 = 2e-10 a step
    up = hold(plant, 5, 50_000.0)[-1, LAG]
    assert up == pytest.approx(hold(plant_of(kind, 1, V, **own), 5, 50_000.0)[-1, LAG], rel=1e-12)


# --- touchdown, in MuJoCo ----------------------------------------------------------------------------


UP, SLOPE = np.array([[math.sin(ALPHA), 0, math.cos(ALPHA)], [math.cos(ALPHA), 0, -math.sin(ALPHA)]])


def touch(vehicle, steps=40) -> np.ndarray:
    """(steps, 13) states of a vehicle that drops 3 cm, sliding, onto the slab with its motors off."""
    plant = MujocoPlant(1, vehicle)
    state = np.zeros((1, 13))
    state[0, :3] = [0, 0, V.platform_surface_height] + UP * 0.05
    state[0, PITCH], state[0, VX : VZ + 1] = ALPHA, -0.5 * UP + 0.4 * SLOPE
    plant.reset([0], state)
    rows = []
    for _ in range(steps):
        plant.step(np.array([[0.0, 0.0, ALPHA / V.attitude_gain, 0.0]]))
        rows.append(plant.state[0].copy())
    return np.array(rows)


@pytest.mark.parametrize("name", TOUCHDOWN)
def test_touchdown_effects_act(name):
    nominal, flown = touch(V), touch(changed(name))
    np.testing.assert_array_equal(nominal[0], flown[0])  # no foot has touched
    height, along = (lambda s: s[:, :3] @ UP), (lambda s: s[:, :3] @ SLOPE)
    if name == "friction":
        assert along(flown)[-1] < along(nominal)[-1] - 0.02  # slides back down the slope
    elif name == "contact_stiffness":
        assert height(flown).min() < height(nominal).min() - 2e-4  # sinks in deeper
    elif name == "contact_damping":
        assert height(flown)[3:6].max() > height(nominal)[3:6].max() + 2e-3  # bounces
    elif name == "foot_height":
        assert (height(flown) - height(nominal))[-1] == pytest.approx(0.004, abs=2e-4)
    elif name == "platform_height":
        rise = changed(name).platform_surface_height - V.platform_surface_height
        assert (height(flown) - height(nominal))[-1] == pytest.approx(rise * math.cos(ALPHA), abs=2e-4)
    else:
        assert flown[-1, PITCH] - nominal[-1, PITCH] == pytest.approx(0.05, abs=1e-3)


def test_stiffness_and_damping_are_those_of_the_engine():
    """Of r'' = -b r' - k r: both formats of solref mean the same spring, and only the named part scales."""
    direct = LIBRARY["contact_stiffness"].apply(changed("contact_damping", scale=0.5), {"scale": 2.0})
    time, ratio = V.contact_solref
    stiffness, damping = 1 / (time * ratio) ** 2, 2 / time
    assert direct.contact_solref == pytest.approx((-2 * stiffness, -0.5 * damping))
    same = dataclasses.replace(V, contact_solref=(-stiffness, -damping))
    np.testing.assert_allclose(touch(same), touch(V), atol=1e-9)


# --- files and wrong values --------------------------------------------------------------------------


def test_a_corrected_vehicle_is_a_file(tmp_path):
    write_vehicle(tmp_path / "all.toml", everything())
    assert load_vehicle(tmp_path / "all.toml") == everything()
    write_vehicle(tmp_path / "all.toml", V)  # the same name again
    assert load_vehicle(tmp_path / "all.toml") == V


def test_what_a_vehicle_has_already_it_may_have_less_of():
    """A delay of 7 ms may be 7 ms shorter, and no more; without one it can only grow."""
    effect = LIBRARY["thrust_delay"]
    (alone,) = effect.sized_for(V).parameters
    assert alone.possible == (0.0, alone.bounds[1])
    late = V.changed(effects_thrust_delay=0.007)
    (p,) = effect.sized_for(late).parameters
    assert p.possible == (-0.007, p.bounds[1])
    assert effect.apply(late, {"delay": p.possible[0]}) == V


def test_a_moment_comes_with_the_rate_at_which_it_is_taken_over():
    """None changes nothing; beside one that is there, the rate of either counts by its size."""
    effect = LIBRARY["com_offset"]
    held = V.changed(effects_com_offset=(0.0, -0.002), effects_attitude_hold=1.5)
    for x, hold in ((0.0, 1.5), (1e-9, 1.5), (0.002, 1.0), (0.006, 0.75)):  # (2 1.5 + 6 0.5)/8
        new = effect.apply(held, {"x": x, "y": 0.0, "hold": 0.5})
        assert new.effects_attitude_hold == pytest.approx(hold, abs=1e-5)
    assert effect.apply(V, {"x": 1e-9, "hold": 0.5}).effects_attitude_hold == 0.5
