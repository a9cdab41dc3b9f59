"""Whole flights of the pilot in the simulated vehicle, what ends them early, and the logs they leave."""

import contextlib
import dataclasses
import errno
import itertools
import json
import os
import sys
import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from inclined_landing.envs import load_policy
from inclined_landing.envs.hover import TOLERANCE
from inclined_landing.eval import cli
from inclined_landing.eval.flying import pilot as pilot_module
from inclined_landing.eval.flying import positions, safety
from inclined_landing.eval.flying.flight_log import FlightLogWriter
from inclined_landing.eval.flying.interfaces import RealClock
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan, read_planned
from inclined_landing.eval.flying.positions import TrackedBody, open_capture
from inclined_landing.eval.flying.report import FlightReport, describe_all
from inclined_landing.eval.flying.safety import Phase
from inclined_landing.eval.flying.simulated.world import URI, Setting, World
from inclined_landing.eval.flying.surroundings import Surroundings
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.eval.flying.watchdog import Watchdog
from inclined_landing.eval.gap.measured.windows import prepare
from inclined_landing.eval.gap.plan import pieces
from inclined_landing.eval.gap.plan.pieces import setpoints
from inclined_landing.eval.logs import read_log
from inclined_landing.eval.logs.log import GAP_SECONDS
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle

SETTING = Setting(start=(-1.0, 0.0))
NEAR = (-1.0, 1.6)  # a start that is soon reached


@pytest.fixture(scope="module")
def policies():
    return load_policy("landing-nominal"), load_policy("setpoint")


def flown(policies, tmp_path=None, *, dry=False, setting=SETTING, start=NEAR, seed=1, before=None, **options):
    """A flight: pilot, report, world. policies: of a landing, or a plan. before: called with the pilot."""
    world = World(setting, seed=seed)
    plan = policies if isinstance(policies, FlightPlan) else FlightPlan.landing(*policies, start)
    radio = Radio(world, world, plan.surroundings.vehicle.command_angle_limit, dry=dry)
    radio.connect(URI)
    options = {"say": lambda line: None, "hang_limit": 30.0} | options
    pilot = Pilot(radio, world, world.view, plan, **options)
    assert all(check.passed for check in pilot.check())
    if before is not None:
        before(pilot)
    with contextlib.nullcontext() if tmp_path is None else FlightLogWriter(tmp_path / "flight.csv") as log:
        report = pilot.fly(log)
    radio.close()
    return pilot, report, world


def broken(policy, answer):
    """A policy that answers anything but an action."""
    copy = dataclasses.replace(policy)
    object.__setattr__(copy, "predict", answer)
    return copy


def test_a_flight_lands_and_leaves_a_log_that_is_read_the_same_evening(policies, tmp_path):
    """The first set-point unlocks the thrust, the last ones stop the motors: lost packets must not matter."""
    lost = {"arm": 3, "stop": 8}

    def lossy(pilot):
        up = pilot.radio.link.up
        link = up.arrival

        def arrival(time):
            when = "stop" if pilot.phase is Phase.OVER else "arm"
            lost[when] -= 1
            return None if lost[when] >= 0 else link(time)

        up.arrival = arrival

    _, report, world = flown(policies, tmp_path, before=lossy)
    assert report.outcome == "goal box" and not report.touched and report.error is None
    assert max(lost.values()) < 0
    running = world.trace.time[world.trace.command[:, 0] > 0.0]
    assert abs(running[-1] - (world.time - pilot_module.AFTER_FLIGHT_TIME)) < 0.1
    assert np.linalg.norm(report.start[[0, 2]] - NEAR) < TOLERANCE + 0.01
    assert abs(report.goal[1]) < 0.05, "y is held"
    truth = world.trace
    assert world.thrust == 0.0
    assert report.rests == bool(truth.touching[-1, 0] and np.linalg.norm(truth.state[-1, 3:6]) < 0.05)
    log = read_log(tmp_path / "flight.csv")
    assert not log.missing and log.voltage is not None and log.contact[0]
    # What was logged is what truly was: 0.5 mm and 0.004 rad of noise, up to 9 ms late with 3 m/s.
    t0 = truth.time[np.argmin(np.abs(truth.time - (truth.time[-1] - log.t[-1])))]
    t = log.t - log.t[0]
    shift = min(
        (np.interp(t + t0 + late, truth.time, truth.state[:, 2]) for late in np.arange(-0.3, 0.3, 0.004)),
        key=lambda z: np.abs(z - log.position[:, 2]).mean(),
    )
    assert np.abs(shift - log.position[:, 2]).mean() < 0.01
    assert log.command[0, 0] == 0.0 and log.command[-1, 0] == 0.0 and log.command[:, 0].max() > 30_000
    measured = prepare(log, load_vehicle(), platform=True)
    assert len(measured.starts) >= 5 and np.isfinite(measured.voltage).all()


def reference(seconds=3.0, reach=0.3):
    """A hover of a second and a run of so many metres along y, turning to the left."""
    path = pieces.Path(*ways(seconds, reach), ())
    return setpoints(path, load_vehicle())


def ways(seconds, reach):
    t = np.arange(round(seconds * pieces.RATE)) / pieces.RATE
    u = np.clip((t - 0.8) / (seconds - 1.6), 0.0, 1.0)
    s = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)  # at rest at both ends
    return np.outer(1 - s, [-1.4, 0.0, 1.2]) + np.outer(s, [-1.4, reach, 1.2]), 1.0 * s


def room(vehicle=None, **options):
    vehicle = vehicle or load_vehicle()
    return Surroundings(vehicle, vehicle.platform_inclination, **options)


def planned(policies):
    return FlightPlan.along(reference(), policies[1], room())


def test_a_planned_flight_is_followed_logged_and_set_down(policies, tmp_path):
    """In the closed loop the vehicle stays within a few centimetres, and what was sent is in its heading."""
    _, report, world = flown(planned(policies), tmp_path)
    assert report.outcome == "plan flown" and report.succeeded and not report.landed
    assert report.astray < 0.12  # 5 cm of the hand-over, and what 1.5 m/s2 for a lag of 0.2 s come to
    truth = world.trace
    assert world.thrust == 0.0 and truth.touching[-1, 2], "on the floor"
    end = reference().position[-1]
    assert np.linalg.norm(truth.state[:, :3] - end, axis=1).min() < 0.05
    log = read_log(tmp_path / "flight.csv")
    assert not log.missing
    turned = (log.attitude[:, 2] > 0.9) & (log.position[:, 2] > 1.0)
    assert turned.any() and np.abs(log.attitude[:, 2]).max() < 1.2
    assert np.abs(log.command[turned, 1:3]).max() < 0.2  # a hover at 57 deg: near level in its own heading


def test_a_vehicle_that_leaves_its_plan_is_set_down(policies, monkeypatch):
    monkeypatch.setattr(safety, "ASTRAY_LIMIT", 0.001)
    _, report, world = flown(planned(policies))
    assert report.outcome == report.retreat.name == "astray" and not report.succeeded
    assert world.thrust == 0.0 and world.trace.touching[-1, 2], "on the floor"


def test_a_planned_flight_is_checked_against_the_room(tmp_path):
    around, path = room(), tmp_path / "flight.csv"
    path.write_text(reference().csv())
    found = read_planned(path, around)
    assert np.abs(found.table() - reference().table()).max() < 1e-6
    near = room(dataclasses.replace(load_vehicle(), arena_y=(-0.5, 0.4)))
    with pytest.raises(UserError, match="fence"):
        read_planned(path, near)
    moved = reference()
    path.write_text(dataclasses.replace(moved, position=moved.position + [1.4, 0.0, 0.0]).csv())
    with pytest.raises(UserError, match="--no-platform"):
        read_planned(path, around)
    assert read_planned(path, room(present=False)).seconds == pytest.approx(2.99)


IMPOSSIBLE = {  # changes of rows 120 on, and what is said of them
    "velocity and a position that disagree": ("position", lambda x: x + [0.0, 0.1, 0.0]),
    "commands a PWM outside": ("command", lambda x: x * [0.0, 1.0, 1.0, 1.0]),
    "leans beyond 30 deg": ("command", lambda x: x + [0.0, 0.6, 0.0, 0.0]),
    "turns faster than": ("command", lambda x: x + [0.0, 0.0, 0.0, 4.0]),
    "accelerations that are not the change": ("acceleration", lambda x: x + [0.0, 0.0, 1.0]),
    "leans otherwise than its acceleration": ("attitude", lambda x: x + [0.03, 0.0, 0.0]),
}


@pytest.mark.parametrize("said", IMPOSSIBLE)
def test_what_no_vehicle_flies_is_refused_before_take_off(said, tmp_path):
    flight, path = reference(), tmp_path / "flight.csv"
    column, change = IMPOSSIBLE[said]
    values = getattr(flight, column).copy()
    values[120:] = change(values[120:])
    path.write_text(dataclasses.replace(flight, **{column: values}).csv())
    with pytest.raises(UserError, match=f"{said}.* after 1.2 s"):
        read_planned(path, room())


@pytest.mark.parametrize("cell", ['"', "x" * 200_000])
def test_a_plan_that_is_no_csv_is_refused(cell, tmp_path):
    rows = reference().csv().splitlines()
    (tmp_path / "flight.csv").write_text("\n".join([*rows[:100], cell + rows[100], *rows[101:]]))
    with pytest.raises(UserError, match=r"planned flight .*flight\.csv (is not CSV|has an empty)"):
        read_planned(tmp_path / "flight.csv", room())


@pytest.mark.slow
def test_a_stop_that_cannot_be_sent_becomes_an_emergency_stop(policies):
    def fail():
        raise RuntimeError("for the test")

    _, report, world = flown(policies, before=lambda pilot: setattr(pilot.radio, "stop", fail))
    assert report.outcome == "goal box" and world.thrust == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["touchdown", "touchdown-nominal"])
def test_a_touchdown_comes_to_rest_by_its_own_command(name, policies):
    """In space, by its own roll, and in the plane, where the other policy's roll holds y."""
    _, report, world = flown((load_policy(name), policies[1]))
    assert report.outcome == "at rest" and report.rests
    assert world.trace.touching[-1, 0] and np.linalg.norm(world.trace.state[-1, 3:6]) < 0.05


@pytest.mark.slow
def test_a_landing_policy_that_gives_nan_is_landed_by_the_other(policies, tmp_path):
    nan = broken(policies[0], policies[0].predict)

    def before(pilot):
        enter = pilot._enter

        def entered(phase):
            enter(phase)
            object.__setattr__(nan, "predict", lambda o: np.full((len(o), 2), np.nan))

        pilot._enter = entered

    _, report, world = flown((nan, policies[1]), tmp_path, before=before)
    assert report.outcome == "bad action" and report.retreat.name == "bad action"
    assert world.thrust == 0.0 and world.trace.touching[-1, 2], "on the floor"
    assert np.abs(world.trace.state[-1, 3:6]).max() < 0.1
    assert not read_log(tmp_path / "flight.csv").missing


@pytest.mark.parametrize(
    "where",
    ["interrupt", *(pytest.param(where, marks=pytest.mark.slow) for where in ("say", "log", "setpoint"))],
)
def test_whatever_raises_the_motors_stop(where, policies, tmp_path):
    """Printing, the log, Ctrl-C, the set-point policy: each ends with motors off and a whole log."""

    def fail(*_):
        raise KeyboardInterrupt if where == "interrupt" else RuntimeError("for the test")

    def before(pilot):
        step = pilot._command

        def command(estimate):
            if estimate.state[2] > 1.0:
                if where == "log":
                    pilot._log.command = fail
                elif where == "setpoint":
                    object.__setattr__(pilot.plan.setpoint, "predict", lambda o: np.full((len(o), 3), np.nan))
                else:
                    fail() if where == "interrupt" else pilot._print("anything")
            return step(estimate)

        pilot._command = command

    setpoint = dataclasses.replace(policies[1])
    options = {"say": fail} if where == "say" else {}
    _, report, world = flown((policies[0], setpoint), tmp_path, before=before, **options)
    wanted = {"interrupt": "interrupted", "setpoint": "bad set-point action"}.get(where, "error")
    assert report.outcome == wanted and world.thrust == 0.0
    assert ("for the test" in (report.error or "")) == (wanted == "error")
    assert (tmp_path / "flight.csv").is_file() and not (tmp_path / "flight.unfinished.csv").exists()
    assert not read_log(tmp_path / "flight.csv").missing


@pytest.mark.slow
def test_a_control_loop_that_hangs_is_noticed(policies):
    def slow(observation):
        time.sleep(1.2)
        return policies[0].predict(observation)

    hanging = broken(policies[0], lambda o: policies[0].predict(o))

    def before(pilot):
        object.__setattr__(hanging, "predict", slow)

    _, report, world = flown((hanging, policies[1]), hang_limit=1.0, before=before)
    assert report.outcome == "hang" and world.thrust == 0.0


def test_the_watchdog_bites_once_and_only_then(monkeypatch):
    now, bites = [0.0], []
    monkeypatch.setattr(
        "inclined_landing.eval.flying.watchdog.time", SimpleNamespace(monotonic=lambda: now[0])
    )
    with Watchdog(0.1, lambda: bites.append(1)) as watchdog:
        for _ in range(5):
            now[0] += 0.09
            watchdog.feed()
            time.sleep(0.05)
        assert not watchdog.triggered and not bites
        now[0] += 0.11
        until(lambda: watchdog.triggered)
        time.sleep(0.1)
    assert bites == [1]


def test_a_dry_run_moves_nothing(policies, monkeypatch):
    monkeypatch.setattr("inclined_landing.eval.flying.pilot.DRY_RUN", 1.0)
    said = []
    pilot, report, world = flown(policies, dry=True, say=said.append)
    assert report.outcome == "dry run" and not world.trace.command[:, 0].any()
    assert sum("would command PWM" in line for line in said) >= 2 and pilot.phase is Phase.OVER


def test_checks_refuse_what_must_not_fly(policies):
    def failed(change=lambda world: None, **plan):
        world = World(SETTING, seed=3)
        radio = Radio(world, world, 0.5)
        radio.connect(URI)
        change(world)
        pilot = Pilot(radio, world, world.view, FlightPlan.landing(*policies, NEAR, **plan))
        found = {check.name for check in pilot.check() if not check.passed}
        with pytest.raises(ValueError, match="checks"):
            pilot.fly()
        radio.close()
        return found

    assert failed(change=lambda f: setattr(f.body, "voltage_drop", 0.7)) == {"battery"}
    assert failed(stand=0.5) == {"height"}
    assert "motion capture" in failed(change=lambda f: setattr(f.view, "blind", True))
    assert "motion capture" in failed(change=lambda f: setattr(f.view, "frozen", True))


def test_a_log_holds_what_it_is_told(tmp_path):
    path = tmp_path / "f.csv"
    with FlightLogWriter(path) as log:
        log.begin(100.0)
        for k in range(400):
            t = 100.0 + 0.01 * k
            if not 150 <= k < 200:  # blind
                log.pose(t + 0.004, np.array([0.1, 0.2, 1 + 0.001 * k]), k < 10)
            log.attitude(t + 0.002, 0.0, 0.1 + 0.001 * (k % 3), 3.1 + 0.001 * k)
            log.voltage(t, 4.0)
            if k % 2 == 0 and not 300 <= k < 350:  # nothing is sent for half a second
                log.command(t, np.array([30_000.0 + k, 0.0, 0.1, 0.0]))
        log.pose(100.0, np.full(3, np.nan), False)
        rows = (tmp_path / "f.unfinished.csv").read_text("utf-8").splitlines()
        assert len(rows) > 200, "it is written as it goes"
    assert not (tmp_path / "f.unfinished.csv").exists()
    found = read_log(path)
    assert np.diff(found.t).min() > 0 and found.contact.sum() == 10
    np.testing.assert_allclose(found.position[:, 2], 1 + 0.1 * found.t, atol=2e-3)
    np.testing.assert_allclose(np.unwrap(found.attitude[:, 2]), 3.1 + 0.1 * (found.t + 0.002), atol=1e-3)
    assert found.command[-1, 0] == 30_398.0
    unseen, unsent = found.gap_starts
    assert found.t[unseen] < 1.5 and found.t[unseen + 1] == pytest.approx(2.0, abs=0.011)
    # Held by the writer, then by the reader; rows every 10 ms.
    assert 2.98 <= found.t[unsent] <= 2.98 + 2 * GAP_SECONDS + 0.011
    assert found.t[unsent + 1] == pytest.approx(3.5, abs=0.011)
    with pytest.raises(UserError, match="already exists"):
        FlightLogWriter(path)


def test_motion_capture_by_library():
    """Its calls, with a body that appears in the third frame."""
    frames = itertools.count()
    body = SimpleNamespace(
        position=np.array([1.0, 2.0, 3.0]), rotation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)
    )

    class System:
        def __init__(self):
            self.rigidBodies = {"other": body}

        def waitForNextFrame(self):
            time.sleep(0.002)
            if next(frames) == 2:
                self.rigidBodies = {"other": body, "cf": body}

    tracked = TrackedBody(System(), "cf", RealClock(), latency=0.01)
    tracked.await_first()
    pose = tracked.latest()
    assert pose.position.tolist() == [1.0, 2.0, 3.0] and pose.attitude.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert 0.005 < time.monotonic() - pose.time < 1.0
    for wrong in ("vicon", "vicon:host", "a::b", ":::"):
        with pytest.raises(UserError, match="TYPE:HOST:BODY"):
            open_capture(wrong, RealClock())


@pytest.mark.parametrize(
    ("code", "limit", "said"),
    [
        ("import time; time.sleep(60)", 0.5, "no answer in 0.5 s"),
        ("raise RuntimeError('no such type')", 20.0, "no such type"),
    ],
    ids=["silent", "refuses"],
)
def test_motion_capture_that_is_silent_or_refuses_is_said(code, limit, said, tmp_path, monkeypatch):
    (tmp_path / "motioncapture.py").write_text(f"def connect(kind, options):\n    {code}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "motioncapture", SimpleNamespace())
    monkeypatch.setattr(positions, "CONNECTING", limit)
    with pytest.raises(UserError, match=said):
        open_capture("vicon:nowhere:cf", RealClock())


def test_the_command_writes_what_happened(tmp_path, capsys):
    """Of a policy of any slope over that of the arena."""
    words = ["fly", "landing-3d", "--simulated", "--start=1.5,1.8", "--inclination", "-15", "--seed=3"]
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "Of 1 flight, 1 reached the goal box (1 without" in said and "; at rest on the slope" in said
    told = json.loads((tmp_path / "out" / "fly.json").read_text("utf-8"))
    assert told["flights"][0]["landed"] and told["flights"][0]["log"] == "flight_01.csv"
    simulated = ["fly", "landing", "--simulated", "--start=1,1.5", "--out", str(tmp_path / "new")]
    for wrong in (
        [*simulated, "--inclination=-10"],
        [*simulated, "--fault=mocap-frozen@0"],  # the checks fail
        ["fly"],
    ):
        assert cli.main(wrong) == 2
    assert not (tmp_path / "new").exists()


def test_a_full_disk_does_not_hide_how_the_flight_ended(tmp_path, capsys, monkeypatch):
    """The log fails in flight, which ends it, fly.json afterwards: both files are named."""
    note = FlightLogWriter.command

    def command(self, time, command):
        if self._written > 1.0:
            self._rows = SimpleNamespace(writerow=fail)
        note(self, time, command)

    def fail(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(FlightLogWriter, "command", command)
    monkeypatch.setattr("os.replace", fail)
    words = ["fly", "landing", "--simulated", "--start=1,1.5", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 2
    said = capsys.readouterr()
    assert "ended early: error" in said.out
    assert said.err.count("\n") == 1 and "Traceback" not in said.err
    assert "flight_01.unfinished.csv: no space left" in said.err and "fly.json: no space left" in said.err
    assert len((tmp_path / "out" / "flight_01.unfinished.csv").read_text("utf-8").splitlines()) > 50


def test_a_watchdog_that_is_gone_is_said_once_and_reported(policies):
    said, looks = [], itertools.count()
    _, report, _ = flown(policies, say=said.append, guarded=lambda: next(looks) < 50)
    assert report.outcome == "goal box" and report.unguarded
    assert sum("the watchdog process" in line for line in said) == 1


def until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.05)


def test_the_last_line_counts_touches_and_rest():
    """A flight that reaches the goal box may still touch first, or not come to rest."""
    box = partial(FlightReport, "goal box", goal=np.zeros(13), landing_time=2.0)
    reports = [box(rests=True), box(rests=True, touched=True), box(rests=False), FlightReport("tilt")]
    said = "of 4 flights, 3 reached the goal box (2 without touching the platform before) and 2 came to rest"
    assert describe_all(reports, "landing").startswith(said)
    assert describe_all(reports[:1], "touchdown") == "of 1 flight, 1 came to rest on the slope"
    assert describe_all([FlightReport("plan flown")], "plan") == "1 of 1 flight followed the plan"
