"""Both plants: full-state resets, replays, contact with the platform, and the batch itself."""

import copy
import functools
import gc
import math
import multiprocessing
import pickle
import threading

import mujoco
import numpy as np
import pytest

from inclined_landing.models import geometry, threads
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ, YAW, X, Y, Z, euler_angles, quaternion
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import PART_BODIES, PARTS, PLATFORM_BODIES, PLATFORM_GEOMS
from inclined_landing.models.motion import Motion
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant, MujocoPlant, make_plant

V = load_vehicle()
# None of the delays is a number of control periods.
LATE = V.changed(effects_thrust_delay=0.027, effects_attitude_delay=0.051, effects_mocap_delay=0.033)
LOADED = V.changed(effects_load_mass=0.005, effects_load_length=0.4, effects_attitude_integral=2.0)
FEET, BODY, ROTORS = range(3)
SLAB, BASE, FLOOR = range(3)
INCLINATIONS = np.radians([-50, -25.7, -10, 0, 15, 50])
# The feet's spheres end this far below the vehicle's origin; read from the compiled scene.
MODEL = MujocoPlant(1).model
FOOT = MODEL.geom("foot_front_left")
FOOT_DEPTH = float(FOOT.size[0] - FOOT.pos[2])


def hover(*positions, **columns) -> np.ndarray:
    """States (n, 13) hovering at positions (x, y, z), with columns replaced."""
    state = np.zeros((len(positions), 13))
    state[:, :3], state[:, LAG] = positions, V.hover_lag
    for name, value in columns.items():
        state[:, {"vx": VX, "vz": VZ, "roll": ROLL, "pitch": PITCH, "yaw": YAW, "lag": LAG}[name]] = value
    return state


def on_slab(height, inclination=V.platform_inclination, along=0.0, **columns) -> np.ndarray:
    """One state aligned with the slab, its feet `height` above it, `along` the slope from its middle."""
    s, c = math.sin(inclination), math.cos(inclination)
    up, slope = np.array([s, 0, c]), np.array([c, 0, -s])
    position = [0, 0, V.platform_surface_height] + up * (FOOT_DEPTH + height) + slope * along
    return hover(position, **({"pitch": inclination} | columns))


def random_commands(steps, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([10_000, -0.5, -0.5, -3], [60_000, 0.5, 0.5, 3], (steps, n, 4))


def random_states(n, seed=0):
    """Around and on the platform, moving and turning, with all kinds of lag."""
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1, 1, (n, 13)) * [0.6, 0.3, 0.3, 2, 1, 2, 0.5, 0.5, 3, 2, 2, 2, 0]
    state[:, Z] += 1.5
    state[:, LAG] = rng.uniform(600, 3900, n)
    return state


def history(plant, commands):
    """Everything visible after each step, as a list of arrays."""
    rows = []
    for row in commands:
        plant.step(row)
        c = plant.contacts
        rows += [plant.state.copy(), c.near.copy(), c.touch.copy(), c.force.copy(), plant.measurement.copy()]
        if plant.vehicle == LOADED:
            rows += [plant.load.copy(), plant.integral.copy()]
    return rows


def assert_same(a, b):
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


KINDS = {
    "mujoco": {},
    "mujoco kinematic": {"attitude": "kinematic"},
    "mujoco late": {"vehicle": LATE},
    "mujoco late implicitfast": {"vehicle": LATE, "integrator": "implicitfast"},
    "mujoco loaded": {"vehicle": LOADED},
    "hybrid": {},
    "hybrid loaded": {"vehicle": LOADED},
    "analytic": {},
    "analytic rate_loop": {"attitude": "rate_loop"},
    "analytic late": {"vehicle": LATE},
    "analytic loaded": {"vehicle": LOADED},
}


@pytest.fixture(params=KINDS)
def build(request):
    return functools.partial(make_plant, request.param.split()[0], **KINDS[request.param])


def test_reset_then_replay_is_equal_bit_for_bit(build):
    plant, states, commands = build(6), random_states(6), random_commands(40, 6)
    plant.reset(np.arange(6), states)
    np.testing.assert_array_equal(plant.state, states)
    np.testing.assert_array_equal(plant.measurement, states)
    first = history(plant, commands)
    plant.reset(np.arange(6), states)
    assert not plant.contacts.touch.any() and not plant.contacts.near.any()
    assert_same(history(plant, commands), first)
    fresh = build(6)  # and nothing of the past survives
    fresh.reset(np.arange(6), states)
    assert_same(history(fresh, commands), first)


def test_reset_of_a_few_leaves_the_others_alone(build):
    plant, states, commands = build(6), random_states(6), random_commands(40, 6)
    plant.reset(np.arange(6), states)
    whole = history(plant, commands)
    plant.reset(np.arange(6), states)
    history(plant, commands[:20])
    ids = np.array([1, 4])
    plant.reset(np.isin(np.arange(6), ids), states[ids])
    rest = np.array([0, 2, 3, 5])
    joined = commands[20:].copy()
    joined[:, ids] = commands[:20, ids]
    later = history(plant, joined)
    assert_same([a[rest] for a in later], [a[rest] for a in whole[len(whole) // 2 :]])
    assert_same([a[ids] for a in later], [a[ids] for a in whole[: len(whole) // 2]])


def test_restore_replays_bit_for_bit(build):
    plant, commands = build(4), random_commands(60, 4)
    plant.set_platform(np.arange(4), INCLINATIONS[:4], [True, True, False, True])
    plant.reset(np.arange(4), random_states(4))
    plant.set_thrust_scale([1, 0.9, 1.1, 1])
    history(plant, commands[:30])
    snapshot = plant.save()
    contacts = plant.contacts.touch.copy()
    first = history(plant, commands[30:])
    plant.set_thrust_scale(0.5)
    plant.set_platform(np.arange(4), 0.0, True)
    plant.restore(snapshot)
    np.testing.assert_array_equal(plant.contacts.touch, contacts)
    assert_same(history(plant, commands[30:]), first)
    other = build(4)  # also into a plant that never heard of any of it
    other.restore(snapshot)
    assert_same(history(other, commands[30:]), first)


def test_snapshots_of_another_kind_or_size_are_refused():
    with pytest.raises(UserError, match="a different kind or size"):
        AnalyticPlant(2).restore(MujocoPlant(2).save())
    with pytest.raises(UserError, match="a different kind or size"):
        AnalyticPlant(2).restore(AnalyticPlant(3).save())


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_batch_equals_single_simulations_bit_for_bit(threads, integrator):
    n, steps = 6, 50
    plant = MujocoPlant(n, threads=threads, integrator=integrator)
    states, commands = random_states(n, 3), random_commands(steps, n, 3)
    plant.set_platform(np.arange(n), INCLINATIONS)
    plant.reset(np.arange(n), states)
    touched, batch = np.zeros(n, bool), []
    for row in commands:
        plant.step(row)
        batch.append(plant.state.copy())
        touched |= plant.contacts.touch.any(axis=(1, 2))
    assert touched.sum() >= 2 and not touched.all()  # with contact and without
    for i in range(n):
        data, s = engine_data(states[i], INCLINATIONS[i], plant.model), states[i]
        data.qvel[:], data.act[:] = [*s[VX : VZ + 1], *s[YAW + 1 : LAG]], s[LAG]
        for step in range(steps):
            data.ctrl[:] = commands[step, i]
            mujoco.mj_step(plant.model, data, plant.substeps)
            angles = euler_angles(*data.qpos[3:7])
            single = [*data.qpos[:3], *data.qvel[:3], *angles, *data.qvel[3:6], data.act[0]]
            np.testing.assert_array_equal(batch[step][i], single)


# --- contact -----------------------------------------------------------------------------------------


def engine_data(state, inclination, model=MODEL) -> mujoco.MjData:
    """MjData with the vehicle at `state` (13,) and the platform at `inclination`."""
    data = mujoco.MjData(model)
    positions, quaternions = geometry.platform_poses([inclination], [True], V)
    for k, name in enumerate(PLATFORM_BODIES):
        mocap = model.body(name).mocapid[0]
        data.mocap_pos[mocap], data.mocap_quat[mocap] = positions[0, k], quaternions[0, k]
    data.qpos[:] = [*state[:3], *quaternion(*state[ROLL : YAW + 1])]
    mujoco.mj_kinematics(model, data)
    return data


def engine_distances(data, part: str) -> np.ndarray:
    """(4,) MuJoCo's own distances of a part to the PLATFORM_GEOMS [m]."""
    model, body = data.model, data.model.body(PART_BODIES[PARTS.index(part)])
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body.id and model.geom_contype[g]]
    return np.array([
        min(mujoco.mj_geomDistance(model, data, g, model.geom(surface).id, 1.0, None) for g in geoms)
        for surface in PLATFORM_GEOMS
    ])  # fmt: skip


@pytest.mark.parametrize("inclination", INCLINATIONS)
def test_clearances_agree_with_mujocos_geometry(inclination):
    """The equations see spheres: feet exactly, rotor rims and the body box by points on their outline.

    They lie inside the real shapes, so that a clearance is never less than the real distance. To a flat
    face the body's corners and the feet are exact. A disc tilted by t exceeds it by the sagitta between 16
    points of the rim, 22 mm (1 - cos(pi/16)) sin t, and by its rounded corner, 1.5 mm (sin t + cos t - 1):
    together 0.94 mm at most. Against an *edge* of the platform, between the points, it is more.
    """
    plant = AnalyticPlant(1)
    rng = np.random.default_rng(1)
    compared = 0
    position, _ = geometry.platform_poses([inclination], [True], V)
    s, c = math.sin(inclination), math.cos(inclination)
    for _ in range(60):
        state = hover((rng.uniform(-0.6, 0.6), rng.uniform(-0.35, 0.35), 0))
        surface = V.platform_surface_height - state[0, X] * math.tan(inclination)
        state[0, Z] = surface + rng.uniform(0.05, 0.25) / c
        state[0, ROLL : YAW + 1] = rng.uniform([-1, -1, -3], [1, 1, 3])
        approximate = geometry.clearances(state, np.array([inclination]), position, plant.shapes)[0]
        data = engine_data(state[0], inclination)
        for k, part in enumerate(PARTS):
            exact = engine_distances(data, part)
            exact = np.array([exact[0], exact[1:].min()])
            if exact.min() < 1e-3:
                continue  # overlaps are measured another way
            assert np.all(approximate[:2, k] >= exact - 1e-6)  # of the engine's own tolerance
            # The slab's face is what is nearest where the whole vehicle is above its inside.
            dx, dz = state[0, X], state[0, Z] - V.platform_surface_height
            inside = abs(c * dx - s * dz) < V.slab_half_length - 0.07 and abs(state[0, 1]) < 0.18
            if part == "feet":
                assert approximate[0, k] == pytest.approx(exact[0], abs=1e-6)
            elif inside:
                compared += 1
                assert approximate[0, k] <= exact[0] + 0.94e-3
            else:  # a disc of 22 mm or a box of 60 mm, poked at its middle by an edge
                assert approximate[0, k] <= exact[0] + 0.030
    assert compared > 10


def test_flying_into_the_base_touches_the_base():
    for sign in (1, -1):
        plant = MujocoPlant(1)
        plant.reset([0], hover((-sign * 0.55, 0, 0.7), vx=sign * 1.0))
        for _ in range(20):
            plant.step(np.array([[V.hover_pwm, 0, 0, 0]]))
            if plant.contacts.touch.any():
                break
        assert plant.contacts.touch[0, BASE].any() and not plant.contacts.touch[0, [SLAB, FLOOR]].any()


@pytest.mark.parametrize("kind", ["mujoco", "hybrid", "analytic"])
def test_an_absent_platform_is_never_touched(kind):
    plant = make_plant(kind, 2)
    plant.set_platform(np.arange(2), V.platform_inclination, [False, True])
    plant.reset(np.arange(2), hover((0, 0, 1.4), (0, 0, 1.4), vz=-2.0))
    touched = np.zeros(2, bool)
    for _ in range(25):
        plant.step(np.tile([V.hover_pwm, 0, 0, 0], (2, 1)))
        touched |= plant.contacts.platform
    assert touched.tolist() == [False, True]
    assert plant.state[0, Z] < 0.6  # it passed


@pytest.mark.parametrize("kind", ["mujoco", "hybrid", "analytic"])
def test_the_keep_out_zone_is_near_but_not_touch(kind):
    plant = make_plant(kind, 3, keep_out=0.04)
    states = np.concatenate([on_slab(h) for h in (0.001, 0.03, 0.06)])
    plant.reset(np.arange(3), states)
    # Held at the slope's attitude the vehicle slides along the surface: a few mm in one step.
    plant.step(np.tile([V.hover_pwm, 0, V.platform_inclination / V.attitude_gain, 0], (3, 1)))
    assert np.isnan(plant.contacts.force).all() == (kind == "analytic")  # which feels nothing
    assert plant.contacts.platform_near.tolist() == [True, True, False]
    assert not plant.contacts.platform[1:].any()
    assert not plant.contacts.near[:, FLOOR].any()


def test_the_keep_out_zone_has_no_force():
    """Flights beside and onto the platform are the same bit for bit with a zone and without."""
    flights = []
    for keep_out in (0.0, 0.04):
        plant = MujocoPlant(2, keep_out=keep_out)
        plant.reset(np.arange(2), np.concatenate([on_slab(0.03, vz=0.1), on_slab(0.05, vz=0.5)]))
        flights.append(history(plant, np.tile([V.hover_pwm, 0, 0, 0], (10, 2, 1))))
        assert not plant.contacts.touch.any()
    assert_same(flights[0][::5], flights[1][::5])
    assert not any(force.any() for force in flights[1][3::5])


@pytest.mark.parametrize("kind", ["mujoco", "analytic", "hybrid"])
def test_a_thrust_scale_of_one_changes_no_bit(kind):
    """Also there and back, after which the engine's fields are expanded."""
    flights = []
    for scales in ((), (1.0,), (1.1, 1.0)):
        plant = make_plant(kind, 4)
        plant.reset(np.arange(4), random_states(4))
        for scale in scales:
            plant.set_thrust_scale(scale)
        flights.append(history(plant, random_commands(20, 4)))
    assert_same(flights[0], flights[1])
    assert_same(flights[0], flights[2])


# --- errors ------------------------------------------------------------------------------------------


def test_a_thrust_scale_that_is_no_number_is_refused():
    plant = AnalyticPlant(2)
    with pytest.raises(UserError, match="the scale of the thrust must be finite"):
        plant.set_thrust_scale([1.1, np.nan])
    assert (plant.thrust_scale == 1.0).all()


@pytest.mark.parametrize("kind, options, sentence", [
    ("mujoco", {"integrator": "rk4"}, "unknown integrator 'rk4'; choose from RK4, implicitfast, Euler"),
    ("mujoco", {"timestep": 0.003}, "control period 0.02 s is not a whole number of time steps of 0.003 s"),
    ("mujoco", {"timestep": math.nan}, "timestep must be a number"),
    ("mujoco", {"attitude": "quaternion"}, "attitude must be 'kinematic' or 'rate_loop', not 'quaternion'"),
    ("hybrid", {"keep_out": -0.01}, "keep_out must be a number from 0 to 1, not -0.01"),
    ("hybrid", {"n": "64"}, "n must be a whole number of at least 1"),
    ("analytic", {"substeps": 0}, "substeps must be a whole number from 1 to 1000, not 0"),
    ("analytic", {"vehicle": 3}, "vehicle must be a Vehicle or the path of a file, not 3"),
    ("analytic", {"pool": 3}, "pool "),
    ("gazebo", {}, "unknown plant 'gazebo'; choose from mujoco, hybrid, analytic"),
])  # fmt: skip
def test_wrong_options_are_refused(kind, options, sentence):
    with pytest.raises(UserError, match=sentence):
        make_plant(kind, **({"n": 1} | options))


def test_divergence_is_an_error_that_names_the_vehicle():
    """MuJoCo itself would put the vehicle back to the origin without a word."""
    plant = MujocoPlant(3)
    states = hover((0, 0, 2), (0, 0, 2), (0, 0, 2))
    states[1, VX] = 1e20
    snapshot = plant.save()
    plant.reset(np.arange(3), states)
    with pytest.raises(FloatingPointError, match=r"the engine diverged for vehicles \[1\]"):
        plant.step(np.zeros((3, 4)))
    plant.reset([1], hover((0, 0, 2)))
    plant.step(np.zeros((3, 4)))
    assert np.isfinite(plant.state).all()
    plant.reset(np.arange(3), states)
    with pytest.raises(FloatingPointError):
        plant.step(np.zeros((3, 4)))
    plant.restore(snapshot)
    plant.step(np.zeros((3, 4)))


@pytest.mark.parametrize("kind", ["mujoco", "hybrid", "analytic"])
def test_a_turned_platform_is_the_same_platform(kind):
    """Platform, vehicle and flight turned by one angle give the same flight and the same contacts.

    Free flight turns to rounding; contact solvers are not symmetric to rounding: 1e-6 m until the touch.
    """
    turns = np.array([0.0, 0.7, -2.1, np.pi])
    plant = make_plant(kind, 4)
    plant.set_platform(np.arange(4), -0.4, True, turns)
    states = np.zeros((4, 13))
    states[:, X], states[:, Y] = 0.25 * np.cos(turns), 0.25 * np.sin(turns)
    states[:, Z], states[:, YAW], states[:, LAG] = 1.45, turns, V.hover_lag
    plant.reset(np.arange(4), states)
    touched = []
    for _ in range(40):
        plant.step(np.tile([0.9 * V.hover_pwm, 0.0, -0.1, 0.0], (4, 1)))
        cos, sin = np.cos(turns), np.sin(turns)
        x, y = plant.state[:, X], plant.state[:, Y]
        local = np.stack([x * cos + y * sin, y * cos - x * sin, plant.state[:, Z]], axis=1)
        touched.append(plant.contacts.platform.copy())
        if not touched[-1].any():
            assert np.abs(local - local[0]).max() < 1e-6
    assert np.any(touched) and (np.array(touched) == np.array(touched)[:, :1]).all()


# --- copies and forks --------------------------------------------------------------------------------

COPIES = [copy.deepcopy, lambda plant: pickle.loads(pickle.dumps(plant))]


def flown(kind, moving=False):
    """A plant with everything that a copy could forget, after a few steps."""
    pool = [V.changed(body_mass=0.028), V.changed(effects_thrust_delay=0.013, effects_mocap_delay=0.02)]
    options = {} if kind == "analytic" else {"threads": 2, "moving": moving}
    plant = make_plant(kind, 4, V, pool=pool, disturbance=3, **options)
    plant.assign(np.arange(4), [0, 1, 2, 0])
    plant.set_platform(np.arange(4), V.platform_inclination + plant.tilt)
    if moving:
        motion = Motion.still(4)
        motion.waves.amplitude[:], motion.waves.frequency[:] = 0.02, 3.0
        plant.set_motion(np.arange(4), motion)
    plant.reset(np.arange(4), np.concatenate([on_slab(0.001), random_states(3)]))
    plant.set_thrust_scale(0.9)
    if kind != "analytic":
        plant.set_contact([0, 2], friction=0.3, foot_height=0.02)
    history(plant, random_commands(6, 4))
    return plant


@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("kind", ["analytic", "hybrid", "mujoco", "moving mujoco", "moving hybrid"])
def test_copies_go_on_alike_and_leave_each_other_alone(kind, copied):
    plant = flown(kind.split()[-1], kind.startswith("moving"))
    other, commands = copied(plant), random_commands(10, 4, seed=1)
    before = plant.save()
    went = history(other, commands)
    other.reset(np.arange(4), random_states(4, seed=2))
    for name, array in plant.save().items():
        np.testing.assert_array_equal(array, before[name])
    assert_same(history(plant, commands), went)
    other.assign(np.arange(4), 0)
    other.set_platform(np.arange(4), 0.1)
    other.set_thrust_scale(1.0)
    if "hybrid" in kind or "mujoco" in kind:
        other.set_contact([0, 1], friction=1.0, restitution=0.3, contact_time=0.02, foot_height=0.03)
    if kind.startswith("moving"):
        other.set_motion([0, 1], Motion.still(2, waves=3))
    other.restore(before)
    assert_same(history(other, commands), went)


def in_a_fork(work) -> int | None:
    """Return the exit code of a forked child that does `work`; None if it had not ended after 20 s."""
    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    child.join(20)
    ended = child.exitcode
    child.kill()
    return ended


def test_a_forked_process_has_threads_of_its_own():
    def both():
        assert threads.two_at_a_time(max, [1, 2, 3], [3, 2, 1]) == [3, 2, 3]
        assert threads.in_threads(abs, [-1, -2]) == [1, 2]

    both()  # now the parent's pools have threads, which a child lacks
    assert in_a_fork(both) == 0


@pytest.mark.parametrize("kind", ["hybrid", "mujoco"])
def test_a_forked_process_goes_on_as_its_parent(kind):
    plant, commands = flown(kind), random_commands(10, 4, seed=1)
    went = history(copy.deepcopy(plant), commands)

    def go_on():
        assert_same(history(plant, commands), went)

    def fork_once_more():
        assert in_a_fork(go_on) == 0
        go_on()
        assert in_a_fork(lambda: plant.step(commands[0])) == 0

    def forget():  # the engine's end would wait for its threads
        vars(plant).clear()
        gc.collect()

    for work in (go_on, fork_once_more, forget):
        assert in_a_fork(work) == 0, work
    assert_same(history(plant, commands), went)


def test_a_fork_waits_for_the_calls_of_other_threads():
    plant, ended = MujocoPlant(64, threads=2), threading.Event()

    def fly():
        while not ended.is_set():
            plant.step(np.zeros((64, 4)))

    thread = threading.Thread(target=fly)
    thread.start()
    try:
        for _ in range(3):
            assert in_a_fork(lambda: plant.step(np.zeros((64, 4)))) == 0
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize("zone", [0.0, 0.04])
def test_the_analytic_contacts_are_those_of_all_distances(zone):
    """Those that are far from everything are not looked at closely."""
    rng = np.random.default_rng(4)
    n = 400
    plant = AnalyticPlant(n, keep_out=zone)
    plant.set_platform(np.arange(n), rng.uniform(-0.8, 0.8, n), rng.random(n) < 0.8, rng.uniform(-3, 3, n))
    state = rng.uniform(-1, 1, (n, 13)) * [0.8, 0.5, 0.8, 0, 0, 0, 1, 1, 3, 0, 0, 0, 0]
    state[:, Z] += 0.9
    plant.reset(np.arange(n), state)
    plant.step(np.zeros((n, 4)))
    position, _ = plant._platform_poses(np.arange(n))
    where = plant.inclination, position, plant.shapes
    distance = geometry.clearances(plant.state, *where, azimuth=plant.azimuth)
    np.testing.assert_array_equal(plant.contacts.near, distance < zone)
    np.testing.assert_array_equal(plant.contacts.touch, distance < 0.0)
    met = distance.min(axis=(1, 2)) < zone
    assert 0.1 < met.mean() < 0.9
