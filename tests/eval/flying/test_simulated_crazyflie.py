"""The simulated Crazyflie: signs and units, the firmware's rules, radio, cameras, faults."""

import functools
import math

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.body import Body, firmware_attitude, plant_command
from inclined_landing.eval.flying.simulated.faults import FAULTS, Fault
from inclined_landing.eval.flying.simulated.firmware import Firmware, FirmwareSetpoint, State
from inclined_landing.eval.flying.simulated.transport import CameraQuality, LinkDirection, LinkQuality
from inclined_landing.eval.flying.simulated.world import URI, Setting, World
from inclined_landing.models import attitude
from inclined_landing.models.attitude import PITCH, ROLL, VX, VY, YAW, Z, rotation
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle

PERIOD = 0.02
PERFECT = LinkQuality(jitter=0.0, failing=0.0, lost=0.0)
angles = st.floats(-75.0, 75.0)
yaws = st.floats(-179.0, 179.0)


def connected(seed=1, faults=(), **setting):
    setting = {"heading": 0.0, **setting}
    world = World(Setting(**setting), seed=seed, faults=[Fault.parse(text) for text in faults])
    world.open(URI)
    return world


def fly(world, seconds, setpoint=None):
    """Send a set-point at 50 Hz."""
    for _ in range(round(seconds / PERIOD)):
        if setpoint is not None:
            world.setpoint(*setpoint)
        world.wait_until(world.now() + PERIOD)


def airborne(seconds=1.0, **options):
    """In the air, rising at about 1 m/s, some thrust over hover."""
    world = connected(**options)
    fly(world, 0.1, (0, 0, 0, 0))
    fly(world, seconds, (0, 0, 0, 38000))
    return world


def logged(world, period, *names):
    rows = []
    world.log("test", period, names, lambda stamp, data: rows.append((world.now(), stamp, data)))
    return rows


def seen_by(world):
    """Every pose from now on: time of arrival, pose, true position then."""
    poses = []
    arrive = world.view.arrive

    def seen(pose):
        poses.append((world.now(), pose, world.body.state[:3].copy()))
        arrive(pose)

    world.view.arrive = seen
    return poses


# --- signs and units ---------------------------------------------------------------------------------


@hypothesis.given(angles, angles, yaws)
def test_logged_angles_are_those_of_the_firmware(roll, pitch, yaw):
    """Rz(yaw) Ry(-pitch) Rx(roll) of what is logged is the attitude itself."""
    true = rotation(*np.radians([roll, pitch, yaw]))
    r, p, y = firmware_attitude(*np.radians([roll, pitch, yaw]))
    assert np.abs(Rotation.from_euler("ZYX", [y, -p, r], degrees=True).as_matrix() - true).max() < 1e-9


@hypothesis.given(angles, angles)
def test_setpoints_point_the_thrust_where_the_firmware_would(roll, pitch):
    _, r, p, _ = plant_command(FirmwareSetpoint(1.0, roll, pitch, 0.0))
    wanted = Rotation.from_euler("ZYX", [0.0, -pitch, roll], degrees=True).as_matrix()[:, 2]
    assert np.abs(rotation(r, p, 0.0)[:, 2] - wanted).max() < 1e-12


@pytest.mark.parametrize(
    ("setpoint", "speed", "angle", "shown", "sign"),
    [
        ((0, 8, 0, 36000), (VX, 1), (PITCH, 1), "stateEstimate.pitch", -1),
        ((8, 0, 0, 36000), (VY, -1), (ROLL, 1), "stateEstimate.roll", 1),
        ((0, 0, 40, 36000), (None, 0), (YAW, -1), "stateEstimate.yaw", 1),
    ],
    ids=["pitch is forward", "roll is right", "yaw rate is clockwise"],
)
def test_signs_of_set_points_and_logs(setpoint, speed, angle, shown, sign):
    world = airborne()
    rows = logged(world, 20, shown)
    fly(world, 0.8, setpoint)
    state, (column, direction) = world.body.state, angle
    assert direction * state[column] > math.radians(5.0)
    # 0.1 deg of noise, 0.01 s of a change of less than 60 deg/s.
    assert rows[-1][2][shown] == pytest.approx(sign * math.degrees(state[column]), abs=1.5)
    if speed[0] is not None:
        assert speed[1] * state[speed[0]] > 0.3


def test_the_onboard_yaw_begins_at_zero_whatever_the_heading():
    world = connected(heading=0.5)
    rows = logged(world, 100, "stateEstimate.yaw")
    fly(world, 0.3)
    assert abs(rows[-1][2]["stateEstimate.yaw"]) < 0.6  # noise of 0.1 deg
    r = Rotation.from_quat(world.view.latest().attitude, scalar_first=True)
    assert r.as_euler("ZXY")[0] == pytest.approx(0.5, abs=0.02)  # noise of 4 mrad


# --- the accelerometer --------------------------------------------------------------------------------


def placed(inclination=None, **columns):
    """A body in a state of its own."""
    body, state = Body(load_vehicle(), start=(1.0, 0.0), inclination=inclination), np.zeros((1, 13))
    for name, value in columns.items():
        state[0, getattr(attitude, name)] = value
    body.plant.reset([0], state)
    body.state = body.plant.state[0].copy()
    return body


def specific_force(body, setpoint, seconds):
    """(T, 3) of every engine step."""
    return np.array(
        [(body.step(setpoint), body.specific_force)[1] for _ in range(round(seconds / body.step_length))]
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_accelerometer_feels_nothing_in_a_fall_and_gravity_s_reaction_on_the_slope(sign):
    v = load_vehicle()
    angle = sign * v.platform_inclination
    height = v.platform_surface_height + 0.025  # the feet 5 mm above the slope: a fall of 30 ms
    body = placed(angle, X=0.025 * math.sin(angle), Z=height, PITCH=angle)
    assert np.abs(specific_force(body, FirmwareSetpoint(), 0.02)).max() < 1e-3  # drag at 0.2 m/s
    resting = specific_force(body, FirmwareSetpoint(), 0.6)[-1]
    state = body.state
    assert body.touching[0] and np.linalg.norm(state[VX : VX + 3]) < 1e-3
    assert state[PITCH] == pytest.approx(angle, abs=0.01)
    assert resting == pytest.approx([-math.sin(state[PITCH]), 0.0, math.cos(state[PITCH])], abs=1e-3)


@pytest.mark.parametrize("share", [0.8, 1.0, 1.3])
def test_the_accelerometer_feels_the_thrust_in_flight(share):
    """Thrust over weight, along the body's axis whatever its lean: 1 in hover."""
    v = load_vehicle()
    body = placed(Z=1.5, LAG=share * v.hover_lag, PITCH=0.2)
    command = FirmwareSetpoint(thrust=share * v.hover_pwm, pitch=-math.degrees(0.2))
    # Drag at 0.1 m/s, and the turning of a body that is not held still, in 20 ms.
    assert specific_force(body, command, 0.02) == pytest.approx(np.tile([0.0, 0.0, share], (5, 1)), abs=5e-3)


# --- the firmware's rules ----------------------------------------------------------------------------


def test_thrust_is_locked_until_a_setpoint_of_none():
    world = connected()
    fly(world, 0.5, (0, 0, 0, 50000))
    assert world.firmware.thrust == 0.0
    world.setpoint(0, 0, 0, 0)
    fly(world, 0.1, (0, 0, 0, 50000))
    assert world.firmware.thrust == 50000.0
    fly(world, 0.1, (0, 0, 0, 65535))
    assert world.firmware.thrust == firmware.MOST_THRUST
    fly(world, 0.1, (0, 0, 0, 999))
    assert world.firmware.thrust == 0.0


def test_watchdog_levels_out_then_stops_and_locks():
    world = airborne()
    fly(world, 0.3, (0, 10, 0, 36000))
    world.wait_until(world.now() + 3.0)
    trace = world.trace
    last = world.firmware.setpoint.time
    levels = trace.time[np.argmax(trace.mode == State.LEVEL_OUT)]
    off = trace.time[np.nonzero(trace.command[:, 0])[0][-1]] + 0.004
    # The supervisor looks every 40 ms; an engine step is 4 ms.
    assert 0.5 <= levels - last <= 0.55
    assert 2.0 <= off - last <= 2.05
    between = (trace.time > levels + 0.01) & (trace.time < off)
    assert np.ptp(trace.command[between], axis=0).max() == 0.0 and trace.command[between][0, 2] == 0.0
    assert world.firmware.state is State.LOCKED
    fly(world, 0.1, (0, 0, 0, 0))
    fly(world, 0.1, (0, 0, 0, 40000))
    assert world.thrust == 0.0


def test_emergency_stop_and_its_watchdog():
    world = airborne(link=PERFECT)
    begin = world.now()
    world.emergency_stop()
    fly(world, 0.2, (0, 0, 0, 40000))
    trace = world.trace
    assert trace.time[trace.command[:, 0] > 0][-1] - begin < 0.05  # 3 ms of radio, 40 ms of supervisor
    world = airborne(link=PERFECT)
    world.notice()
    begin = world.now()
    fly(world, 1.2, (0, 0, 0, 34000))
    trace = world.trace
    assert 1.0 <= trace.time[trace.command[:, 0] > 0][-1] - begin <= 1.06


def test_a_stop_setpoint_ends_a_flight_that_may_go_on():
    world = airborne(0.4)
    for _ in range(110):
        world.stop()
        fly(world, PERIOD)
    assert world.thrust == 0.0 and world.firmware.state is State.LANDED
    fly(world, 0.3, (0, 0, 0, 40000))
    assert world.firmware.state is State.FLYING


@pytest.mark.parametrize(("up", "after"), [(0.3, 1.0), (-0.5, 0.1)])
def test_tumbling_stops_the_motors(up, after):
    rules, time = Firmware(), 0.0

    def pass_by(seconds, specific_force):
        nonlocal time
        for _ in range(round(seconds / 0.004)):
            rules.receive_rpyt(time, 0.0, 0.0, 0.0, 40000 if time > 0.1 else 0)
            rules.step(time, specific_force, abs(specific_force))
            time += 0.004

    pass_by(0.5, 1.0)
    assert rules.state is State.FLYING
    pass_by(after, up)
    assert rules.state is State.FLYING
    pass_by(0.12, up)
    assert rules.state is State.CRASHED and rules.thrust == 0.0


@hypothesis.given(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=True, allow_infinity=True)
)
def test_setpoints_that_are_no_numbers_stay_finite(roll, yaw_rate):
    rules = Firmware()
    for k in range(30):
        rules.receive_rpyt(0.02 * k, roll, roll, yaw_rate, 0 if k < 15 else 30000)
        command = plant_command(rules.step(0.02 * k, 1.0, 1.0))
    assert rules.thrust == 30000 and np.isfinite(command).all()


# --- the link ------------------------------------------------------------------------------------


def test_logs_and_what_they_refuse():
    world = connected(link=PERFECT)
    rows = logged(world, 10, "stateEstimate.roll", "pm.vbat", "supervisor.info")
    fly(world, 1.0)
    stamps = np.array([stamp for _, stamp, _ in rows])
    assert len(rows) in (99, 100, 101) and (np.diff(stamps) == 10).all()
    assert 3.9 < rows[-1][2]["pm.vbat"] < 4.3 and int(rows[-1][2]["supervisor.info"]) & 2
    assert 0.0029 < rows[-1][0] - stamps[-1] / 1000.0 < 0.0045  # 3 ms of radio; stamps are cut to ms
    with pytest.raises(KeyError):
        logged(world, 10, "stateEstimate.w")  # the firmware has none either


# --- radio, cameras, repeatability -------------------------------------------------------------------


def test_packets_arrive_in_order_late_and_not_always():
    link = LinkQuality(lost=0.1)
    way = LinkDirection(link, np.random.default_rng(0))
    times = 0.01 * np.arange(4000)
    arrivals = [way.arrival(t) for t in times]
    lost = np.mean([a is None for a in arrivals])
    assert abs(lost - 0.1) < 4 * math.sqrt(0.1 * 0.9 / 4000)
    delay = np.array([a - t for a, t in zip(arrivals, times) if a is not None])
    assert delay.min() >= link.latency
    expected = link.latency + link.jitter + link.again * link.failing / (1 - link.failing)
    assert delay.mean() == pytest.approx(expected, abs=2e-4)  # 4 standard errors, and order
    assert (np.diff([a for a in arrivals if a is not None]) >= 0).all()


def test_cameras_see_with_their_noise_rate_and_latency():
    world = connected(cameras=CameraQuality(jitter=0.0))
    poses = seen_by(world)
    world.wait_until(world.now() + 8.0)
    c = CameraQuality()
    seen = len(poses) / 8.0
    hidden = c.dropouts * (c.dropout_length + 0.5 / c.rate)
    assert seen == pytest.approx(c.rate * (1.0 - hidden), abs=3.0)  # 4 dropouts of 30 ms, give or take 3
    positions = np.array([pose.position for _, pose, _ in poses])
    assert positions.std(axis=0) == pytest.approx(c.noise, rel=0.09)  # 1/sqrt(2 * 950) is 2.3 %
    assert np.abs(positions.mean(axis=0) - world.body.state[:3]).max() < 1e-4
    assert np.array([t - pose.time for t, pose, _ in poses]) == pytest.approx(c.latency)


def test_a_flight_repeats_bit_for_bit_under_its_seed():
    def trace(seed):
        world = airborne(0.4, seed=seed, heading=None)
        fly(world, 0.3, (3, 4, 5, 36000))
        return world.trace.state

    first = trace(5)
    assert (first == trace(5)).all() and (first != trace(6)).any()


# --- faults ------------------------------------------------------------------------------------------


@functools.cache
def fault_flight(name):
    """A second of flight, and one with the fault."""
    world = connected(faults=[f"{name}@air+0.5"], cameras=CameraQuality(dropouts=0.0))
    lost = []
    world.give_up = lambda: lost.append(world.now())
    rows = logged(world, 10, "stateEstimate.roll", "stateEstimate.pitch", "pm.vbat")
    fly(world, 0.1, (0, 0, 0, 0))
    poses = seen_by(world)
    fly(world, 1.8, (0, 5, 0, 36000))
    return world, rows, poses, lost


def test_faults_of_the_link():
    world, rows, _, lost = fault_flight("link-lost")
    begun = world.trace.time[np.argmax(world.trace.state[:, Z] > 0.03)] + 0.5
    assert rows[-1][0] < begun + 0.05 and len(lost) == 1 and lost[0] - begun < 0.3
    assert world.firmware.state is State.LEVEL_OUT
    world, rows, _, lost = fault_flight("uplink-lost")
    assert rows[-1][0] > world.now() - 0.05 and not lost
    assert world.firmware.state is State.LEVEL_OUT
    world, rows, _, lost = fault_flight("downlink-lost")
    assert rows[-1][0] < begun + 0.1 and not lost and world.firmware.state is State.FLYING
    world, rows, _, lost = fault_flight("packet-storm")
    during = [t for t, *_ in rows if begun + 0.1 < t < begun + 0.9]
    assert 0 < len(during) < 30 and not lost  # of 80, a tenth
    world, _, _, lost = fault_flight("reboot")
    assert world.thrust == 0.0 and len(lost) == 1


def test_faults_of_the_motion_capture():
    _, _, poses, _ = fault_flight("mocap-lost")
    assert poses[-1][0] < poses[0][0] + 1.2
    _, _, poses, _ = fault_flight("mocap-frozen")
    assert (poses[-1][1].position == poses[-20][1].position).all()
    assert poses[-1][1].time - poses[-2][1].time == pytest.approx(1 / 120, abs=0.006)
    _, _, poses, _ = fault_flight("mocap-stuck")
    last = np.array([pose.position for _, pose, _ in poses[-30:]])
    assert 2e-4 < last.std(axis=0).max() < 1e-3 and np.linalg.norm(last[-1] - poses[-1][2]) > 0.2
    _, _, poses, _ = fault_flight("marker-swap")
    jump = np.linalg.norm(poses[-1][1].position - poses[-1][2])
    assert jump == pytest.approx(0.3, abs=0.05)  # 10 ms at up to 4 m/s
    _, _, poses, _ = fault_flight("attitude-turned")
    r = Rotation.from_quat(poses[-1][1].attitude, scalar_first=True).as_euler("ZXY", degrees=True)
    assert abs(abs(r[0]) - 180.0) < 3.0


def test_faults_of_the_vehicle():
    world, rows, _, _ = fault_flight("attitude-wrong")
    assert rows[-1][2]["stateEstimate.pitch"] > 3.0 and world.body.state[PITCH] > 0.05
    world, rows, _, _ = fault_flight("low-battery")
    assert rows[-1][2]["pm.vbat"] < rows[40][2]["pm.vbat"] - 0.3
    nominal, *_ = fault_flight("downlink-lost")
    assert world.body.state[Z] < nominal.body.state[Z] - 0.05


def test_faults_are_named_and_timed():
    assert Fault.parse("link-lost@12") == Fault("link-lost", "start", 12.0)
    assert Fault.parse("link-lost@air+2.5") == Fault("link-lost", "air", 2.5)
    assert Fault.parse("marker-swap@air") == Fault("marker-swap", "air", 0.0)
    assert all(Fault.parse(str(Fault(name, "air", 1.5))) == Fault(name, "air", 1.5) for name in FAULTS)
    for wrong in ("", "none", "link-lost@", "link-lost@x", "link-lost@air+nan", "link-lost@-1"):
        with pytest.raises(UserError):
            Fault.parse(wrong)


def test_connecting_over_a_lost_link_fails():
    world = World(seed=1, faults=[Fault("link-lost")])
    world.wait_until(1.1)
    world.open(URI)
    assert world.lost == "Too many packets lost" and not world.connected


@pytest.mark.parametrize("start", [(0.0, 0.0), (9.0, 0.0), (math.nan, 0.0)])
def test_impossible_starts_are_refused(start):
    with pytest.raises(UserError):
        World(Setting(start=start), seed=0)
