"""What the pilot believes, against known truth, by the filter's own word, through holes and jumps."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import chi2

from inclined_landing.envs import load_policy, record_flights
from inclined_landing.envs.tasks import hover_states
from inclined_landing.envs.tasks.touchdown import HOLD_STEPS, REST_SPEED
from inclined_landing.eval.flying import frames
from inclined_landing.eval.flying.estimate import (
    POSITION_NOISE,
    SPEED,
    TIME_CONSTANT,
    Attitude,
    ClockOffset,
    ConsistencyMonitor,
    Estimator,
    KalmanFilter,
    RestMonitor,
    process_noise,
    transition,
)
from inclined_landing.eval.flying.interfaces import MeasuredPose
from inclined_landing.models.attitude import quaternion, rotation
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
FILTER = KalmanFilter(V)
STEP = 1 / 120
G = 9.81


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-5, 0.3))
def test_steps_are_those_of_the_differential_equation(dt):
    """Van Loan's block exponential is the exact answer; quadrature differs by its truncation, below 1e-6."""
    a = np.zeros((3, 3))
    a[0, 1] = a[1, 2] = 1.0
    a[2, 2] = -1 / FILTER.correlation
    noise = np.zeros((3, 3))
    noise[2, 2] = 2 * FILTER.acceleration**2 / FILTER.correlation
    block = expm(np.block([[-a, noise], [np.zeros((3, 3)), a.T]]) * dt)
    f = block[3:, 3:].T
    np.testing.assert_allclose(transition(dt, FILTER.correlation), f, rtol=1e-9, atol=1e-12)
    exact = f @ block[:3, 3:]
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert (
        np.abs(process_noise(dt, FILTER.acceleration, FILTER.correlation) - exact).max()
        <= (1e-6 * size).max() + 1e-15
    )


def times(random, seconds):
    """Measurement times with 1 ms jitter and dropouts of up to 0.1 s."""
    t, now = [], 0.0
    while now < seconds:
        now += STEP + abs(random.normal(0, 1e-3)) + (random.uniform(0, 0.1) if random.random() < 0.01 else 0)
        t.append(now)
    return t


def test_errors_are_as_large_as_the_filter_says():
    """Normalised squared errors of position, velocity, acceleration of vehicles that move as it believes."""
    random, squared, inside = np.random.default_rng(3), [], []
    for _ in range(20):
        truth = np.stack([np.zeros(3), random.normal(0, SPEED, 3), random.normal(0, FILTER.acceleration, 3)])
        tracked, last = KalmanFilter(V), 0.0
        for t in times(random, 1.5):
            kick = random.multivariate_normal(
                np.zeros(3),
                process_noise(t - last, FILTER.acceleration, FILTER.correlation),
                3,
                method="eigh",
            )
            truth, last = transition(t - last, FILTER.correlation) @ truth + kick.T, t
            tracked.update(t, truth[0] + random.normal(0, POSITION_NOISE, 3))
        error = truth - tracked.mean
        squared.append(np.einsum("ik,ij,jk->k", error, np.linalg.inv(tracked.variance), error))
        inside.append(tracked.normalised_innovation_squared)
    # 60 sums of three squares: chi-square with 180 degrees, 0.1 % and 99.9 %.
    assert chi2.ppf(1e-3, 180) < np.sum(squared) < chi2.ppf(1 - 1e-3, 180)
    assert chi2.ppf(1e-3, 60) < np.sum(inside) < chi2.ppf(1 - 1e-3, 60)


def test_landings_are_followed():
    """True flights, which are no random process: errors within three of the filter's own deviations."""
    policy = load_policy("landing-nominal")
    starts = hover_states([(0.0, 2.0), (-1.5, 1.6), (1.5, 1.8)], policy.task.vehicle)
    random = np.random.default_rng(5)
    for flight in record_flights(policy, "hybrid", starts):
        tracked, errors, deviations = KalmanFilter(V), [], []
        for t in np.arange(0.0, flight.duration, STEP):
            state = np.array([np.interp(t, flight.t, column) for column in flight.state[:, :6].T])
            tracked.update(t, state[:3] + random.normal(0, POSITION_NOISE, 3))
            errors.append(np.stack(tracked.predict(t)) - state.reshape(2, 3))
            deviations.append(np.sqrt(np.diag(tracked._ahead(max(0.0, t - tracked.time))[1])[:2]))
        error, deviation = np.abs(errors)[20:], np.array(deviations)[20:, :, None]
        assert (error < 4 * deviation).all() and np.sqrt((error**2).mean((0, 2))) @ [0, 1] < 0.10


def test_what_is_no_measurement_is_left_out():
    tracked = KalmanFilter(V)
    assert np.isnan(tracked.predict(0.0)).all()
    assert not tracked.update(np.nan, np.zeros(3)) and not tracked.update(0.0, np.full(3, np.inf))
    for k in range(100):
        assert tracked.update(k * STEP, np.zeros(3))
    before = tracked.mean.copy()
    assert not tracked.update(99 * STEP, np.zeros(3)), "not newer"
    assert not tracked.update(100 * STEP, np.array([0.3, 0.0, 0.0])), "a jump of 30 cm"
    assert not tracked.update(100 * STEP, np.array([0.3, 0.0, 0.0]), impact=True), "nor from a touch"
    np.testing.assert_array_equal(tracked.mean, before)
    # A fall at 2 m/s ends at once: only where something may be touched that is believed.
    falling = KalmanFilter(V)
    path = [-2.0 * max(0.0, 0.5 - k * STEP) for k in range(90)]
    for at, z in enumerate(path):
        falling.update(at * STEP, np.array([0.0, 0.0, z]), impact=True)
    assert falling.contact_updates >= 1 and abs(falling.predict(89 * STEP)[1][2]) < 0.1


def test_heading_comes_from_motion_capture():
    """The vehicle's own yaw begins anywhere; the arena's is seen, and followed when gyroscopes drift."""
    estimator, own = Estimator(V), 1.2
    angles = 0.1, -0.2, 0.7  # roll, pitch, yaw in the arena
    for k in range(600):
        t = k * STEP
        drift = own + 0.02 * t
        turned = frames.about_z(drift) @ rotation(*angles)
        estimator.add_attitude(Attitude(t, turned))
        estimator.add_pose(MeasuredPose(t, np.full(3, 1e-4 * (k % 2)), np.array(quaternion(*angles))))
    estimate = estimator.predict(t)
    # The drift of 0.02 rad/s is followed HEADING_TIME = 0.5 s late: 0.01 rad.
    assert frames.angle_between(rotation(*angles), estimator.to_arena(estimator.attitude)) < 0.015
    assert estimate.attitude_mismatch < 0.015
    level = rotation(0.0, 0.0, angles[2]).T @ rotation(*angles)
    assert estimate.tilt == pytest.approx(np.arccos(level[2, 2]), abs=1e-6)


def test_frozen_cameras_are_no_measurement():
    estimator = Estimator(V)
    assert estimator.add_pose(MeasuredPose(0.0, np.zeros(3)))
    assert not any(estimator.add_pose(MeasuredPose(k * STEP, np.zeros(3))) for k in range(1, 60))
    assert estimator.predict(0.5).pose_age == 0.5


def test_the_log_is_dated_by_its_earliest_packet():
    clock, random = ClockOffset(), np.random.default_rng(0)
    stamps = 5000 + 10 * np.arange(200)
    delays = 0.003 + random.exponential(0.004, 200)
    dates = [clock.date(int(s), 1e-3 * s - 2.5 + d) for s, d in zip(stamps, delays)]
    best = np.minimum.accumulate(delays)
    np.testing.assert_allclose(dates, 1e-3 * stamps - 2.5 + best, atol=1e-9)
    assert clock.date(10, 100.0) == pytest.approx(100.0), "a clock that began anew"


angle = st.floats(-0.5, 0.5)


@settings(max_examples=25, deadline=None)
@given(angle, angle, st.floats(-3.0, 3.0))
def test_set_points_tilt_the_thrust_as_commanded(roll, pitch, heading):
    """A vehicle of any heading that holds the angles it is sent points its thrust where it should."""
    command = np.array([40_000.0, roll, pitch, 0.3])
    sent_roll, sent_pitch, yaw_rate, thrust = frames.radio_setpoint(frames.in_heading(command, heading), 1.4)
    # What cflib packs is -pitch; the log shows that.
    held = frames.logged_rotation(sent_roll, -sent_pitch, np.degrees(heading))
    np.testing.assert_allclose(held[:, 2], rotation(roll, pitch, 0.0)[:, 2], atol=1e-12)
    assert frames.tilt(held[:, 2]) == pytest.approx((roll, pitch), abs=1e-9)
    assert frames.heading_of(held) == pytest.approx(heading, abs=1e-9)
    assert yaw_rate == pytest.approx(-np.degrees(0.3)) and thrust == 40_000


@settings(max_examples=25, deadline=None)
@given(angle, angle, st.floats(-3.0, 3.0))
def test_attitudes_are_the_same_in_all_conventions(roll, pitch, yaw):
    r = rotation(roll, pitch, yaw)
    assert frames.project_angles(r) == pytest.approx((roll, pitch, yaw), abs=1e-9)
    np.testing.assert_allclose(
        frames.quaternion_rotation(np.array(quaternion(roll, pitch, yaw))), r, atol=1e-12
    )


def test_commands_are_saturated_and_never_nan():
    for pwm, thrust in ((-5.0, 0), (1e9, 60_000), (0.0, 0)):
        assert frames.radio_setpoint(np.array([pwm, 0, 0, 0]), 0.5)[3] == thrust
    roll, pitch, *_ = frames.radio_setpoint(np.array([0, 1.3, -1.3, 0.0]), np.radians(30))
    assert max(abs(roll), abs(pitch)) <= 30 + 1e-9
    for bad in itertools.product((np.nan, np.inf), range(4)):
        command = np.zeros(4)
        command[bad[1]] = bad[0]
        with pytest.raises(ValueError, match="NaN or infinite"):
            frames.radio_setpoint(command, 0.5)


leans = st.tuples(*[st.floats(-0.5, 0.5)] * 2)


@given(leans, st.floats(0.3, 1.8))
def test_motion_that_fits_the_forces_leaves_nothing(lean, lift):
    up = np.array([*lean, math.sqrt(1.0 - lean[0] ** 2 - lean[1] ** 2)])
    coherence, acceleration = ConsistencyMonitor(G), G * (lift * up - [0.0, 0.0, 1.0])
    for k in range(200):
        coherence.update(0.02 * k, acceleration * 0.02 * k, up, lift)
    assert coherence.velocity_mismatch < 1e-9


@given(leans, st.floats(0.3, 1.8))
def test_forces_that_lead_nowhere_add_up(lean, lift):
    up = np.array([*lean, math.sqrt(1.0 - lean[0] ** 2 - lean[1] ** 2)])
    coherence, acceleration = ConsistencyMonitor(G), G * (lift * up - [0.0, 0.0, 1.0])
    for k in range(201):
        coherence.update(0.02 * k, np.zeros(3), up, lift)
    expected = np.linalg.norm(acceleration) * TIME_CONSTANT * (1.0 - math.exp(-4.0 / TIME_CONSTANT))
    assert coherence.velocity_mismatch == pytest.approx(expected, rel=0.01)  # steps of 0.02 s in 2.5 s: 0.4 %
    coherence.update(5.0, np.full(3, np.nan), up, lift)
    coherence.update(5.0, np.zeros(3), up, math.nan)
    assert math.isfinite(coherence.velocity_mismatch)
    coherence.reset()
    assert coherence.velocity_mismatch == 0.0


def test_a_vehicle_lies_still_once_it_has_for_as_long_as_a_landing_asks():
    """In HOLD_STEPS steps it moves by less than REST_SPEED does, and something supports it throughout."""
    period, slow = 0.02, 0.9 * REST_SPEED * HOLD_STEPS / (HOLD_STEPS - 1)
    for speed, supported, rests in ((slow, True, True), (2 * slow, True, False), (slow, False, False)):
        rest = RestMonitor(period)
        for k in range(HOLD_STEPS + 4):
            rest.update(np.array([0.0, 0.0, speed * period * k]), supported)
            assert (rest.time > 0.0) == (rests and k >= HOLD_STEPS - 1)
    rest.update(np.zeros(3), True)  # a jump
    assert rest.time == 0.0
