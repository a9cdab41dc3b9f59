"""Flights for the replay page: what is flown again, simulated beside a log, drawn, and written."""

import base64
import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from inclined_landing.envs.flights import record_flights, resimulate
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.cli import main
from inclined_landing.eval.logs import FlightLog, write_log
from inclined_landing.eval.pictures.to_rest import to_rest
from inclined_landing.eval.replay.measured import from_log
from inclined_landing.eval.replay.recording import from_flight
from inclined_landing.eval.replay.scene import scene
from inclined_landing.models.attitude import ROLL, VX
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.geometry import PARTS, shapes_of
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants.recorder import still
from inclined_landing.models.scene import build_spec

V = load_vehicle()


def flown(name, point, vehicle=V):
    policy = load_policy(name, vehicle=vehicle)
    return record_flights(policy, "mujoco", hover_states([point], policy.task.vehicle))[0]


@pytest.fixture(scope="module")
def landing():
    return flown("landing", (0.9, 1.7))


def log_of(flight, name="flight", noise=0.0, rate=100.0):
    """What a perfect tracking system would have logged of a flight, evenly, with its commands."""
    t = np.arange(0.0, flight.t[-1], 1.0 / rate)
    columns = [np.interp(t, flight.t, column) for column in flight.state.T]
    state = np.stack(columns, axis=1)
    held = np.searchsorted(flight.t, t + 1e-9, side="right") - 1
    wrong = noise * np.random.default_rng(3).standard_normal((len(t), 3))
    return FlightLog(name, t, state[:, :3] + wrong, state[:, ROLL : ROLL + 3], flight.commands[held])


# --- flown again ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name, point", [("touchdown-nominal", (0.9, 1.7)), ("setpoint", (0.6, 0.3, 1.0))])
def test_commands_flown_again_give_the_same_states(name, point):
    flight = flown(name, point)
    steps = resimulate(flight)
    stride = round((flight.t[1] - flight.t[0]) / (steps.t[1] - steps.t[0]))
    np.testing.assert_array_equal(steps.state[::stride], flight.state)
    np.testing.assert_array_equal(steps.commands[:-1:stride], flight.commands[:-1])


def test_a_landing_is_followed_to_rest(landing):
    """At the end the slope carries the weight: the forces sum to it within the trembling of 0.02 m/s, 5 %."""
    steps = resimulate(to_rest(landing))
    assert steps.t[-1] > landing.duration + 0.3
    assert still(steps.state, steps.platform)[-1] and not steps.commands[-1].any()
    weight = V.body_mass * V.environment_gravity
    net = np.mean([force.sum(axis=0) for force in steps.forces[-20:]], axis=0)
    np.testing.assert_allclose(net, [0, 0, weight], atol=0.05 * weight)
    recording = from_flight(landing, "x", "mujoco")
    np.testing.assert_array_equal(recording.t, steps.t)
    times = dict((name, t) for t, name in recording.events)
    assert times["goal box"] == landing.duration < times["first touch"] < times["at rest"] < steps.t[-1]
    assert "motors cut there, at rest" in recording.outcome


# --- a log and its simulation --------------------------------------------------------------------------


def test_the_model_follows_its_own_flight_and_not_that_of_another():
    """A log made by the vehicle itself: what is left is the start state's smoothing. With a tenth less
    thrust, 0.1 g for half a second is 12 cm."""
    flight = flown("setpoint", (0.6, 0.3, 1.0))
    log = log_of(flight)
    apart = {}
    for name, vehicle in (("own", V), ("weak", LIBRARY["thrust_scale"].apply(V, {"scale": 0.9}))):
        (measured, simulated), _ = from_log(log, vehicle, platform=False, horizon=0.5, plant="mujoco")
        reached = np.stack([np.interp(simulated.t, measured.t, c) for c in measured.position.T], axis=1)
        ends = simulated.restarts - 1
        apart[name] = np.linalg.norm(simulated.position - reached, axis=1)[ends]
        begins = simulated.restarts
        np.testing.assert_allclose(simulated.position[begins], reached[begins], atol=0.02)
    assert simulated.t[-1] == measured.t[-1] and np.all(np.diff(simulated.t) >= 0)
    assert np.median(apart["own"]) < 0.01
    assert 0.08 < np.median(apart["weak"]) < 0.16


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_the_velocity_of_a_log_is_smoothed(jitter):
    """Noise s of rows dt apart leaves s/dt / sqrt(sum k^2) over k = -10 .. 10, 3.6 mm/s for 1 mm; a sine of
    A w = 1 m/s, w = 2/s loses w^2 dt^2 (3*10*11 - 1)/30 = 0.44 % of it. Differences have 71 mm/s."""
    random = np.random.default_rng(4)
    t = np.arange(90) / 100 + 0.01 * jitter * random.uniform(-1, 1, 90)
    position = 0.5 * np.sin(2.0 * t)[:, None] + [0.0, 1.0, 2.0] + 1e-3 * random.standard_normal((90, 3))
    log = FlightLog("short", t, position, np.zeros((90, 3)), np.tile([4e4, 0.0, 0.0, 0.0], (90, 1)))
    (measured,), _ = from_log(log, V, platform=False, horizon=1.0, plant="mujoco")
    inside = slice(10, -10)
    error = measured.velocity[inside] - np.cos(2.0 * t)[inside, None]
    assert np.sqrt(np.mean(error**2)) < 0.0036 + 0.0044


def test_time_on_the_ground_is_not_simulated():
    """Two seconds at rest before a flight: without a floor the vehicle would fall 20 m meanwhile."""
    flight = log_of(flown("setpoint", (0.6, 0.3, 1.0)))
    stand = np.arange(0.0, 2.0, 0.01)
    level = np.linspace([0.6, 0.3, 0.02], [0.6, 0.3, 0.02], len(stand))
    log = dataclasses.replace(
        flight,
        t=np.concatenate([stand, 2.0 + flight.t]),
        position=np.concatenate([level, flight.position]),
        attitude=np.concatenate([0.0 * level, flight.attitude]),
        command=np.concatenate([np.zeros((len(stand), 4)), flight.command]),
    )
    (_, simulated), _ = from_log(log, V, platform=False, horizon=1.0, plant="mujoco")
    assert simulated.t[0] >= 2.0 and simulated.t[-1] > 7.5
    assert np.abs(simulated.position).max() < 1.5


def test_a_log_too_short_to_simulate_is_shown_and_said(landing):
    log = log_of(landing)
    found, notes = from_log(log.rows(slice(0, 40)), V, platform=True, horizon=1.0, plant="mujoco")
    assert [recording.kind for recording in found] == ["measured"]
    assert any("no simulation of flight" in note for note in notes)
    assert found[0].inclination == V.platform_inclination


# --- the scene -----------------------------------------------------------------------------------------


def test_geometry_is_the_vehicle_files():
    vehicle = dataclasses.replace(V, rotor_arm=0.05, platform_depth=0.7, arena_x=(-2.0, 2.0))
    drawn = scene(vehicle, -0.3)
    shapes = shapes_of(build_spec(vehicle).compile())
    feet = shapes.centres[0, shapes.parts == PARTS.index("feet")]
    np.testing.assert_allclose([foot["position"] for foot in drawn["feet"]], feet, atol=1e-6)
    slab = next(geom for geom in drawn["world"] if geom["name"] == "slab_drawn")
    assert slab["size"][1] == pytest.approx(0.35) == drawn["platform"]["half"][1]
    assert slab["quaternion"] == pytest.approx([np.cos(0.15), 0, -np.sin(0.15), 0], abs=1e-6)
    assert drawn["arena"][0] == [-2.0, 2.0]
    assert scene(vehicle, None)["platform"] is None
    assert not any(geom["name"] in ("slab_drawn", "prism") for geom in scene(vehicle, None)["world"])


# --- the command ---------------------------------------------------------------------------------------


def content(page: Path) -> dict:
    return json.loads(re.search(r'id="content">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)[1])


def test_a_page_of_a_policy_and_a_log_with_a_hostile_name(tmp_path, landing, capsys):
    """6 s at the engine's steps, its commands, a log with its simulation: below 1.5 MB, three.js included."""
    name = "<img src=x onerror=alert(1)> & <script>alert(2)<!--.csv"
    steps = flown("setpoint", (0.6, 0.3, 1.0))
    write_log(tmp_path / name, log_of(steps, noise=1e-4))
    out = tmp_path / "new" / "page.html"
    start = ["--start", "0.6,0.3,1"]
    assert main(["replay", "setpoint", str(tmp_path / name), "--out", str(out), *start]) == 0
    text = out.read_text("utf-8")
    assert len(text) < 1.5e6 and "alert(2)<" not in text and "<img" not in text
    flights = content(out)["flights"]
    assert [flight["kind"] for flight in flights] == ["flown", "measured", "simulated"]
    assert flights[1]["name"] == name.removesuffix(".csv")
    position = np.frombuffer(base64.b64decode(flights[0]["position"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(position, resimulate(steps).state[:, :3], atol=1e-6)
    velocity = np.frombuffer(base64.b64decode(flights[0]["velocity"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(velocity[-1], steps.state[-1, VX : VX + 3], atol=1e-6)
    assert "restarted at the measured state every 1 s" in capsys.readouterr().out
    assert not re.search(r'(src|href)="?https?:', text)  # nothing is fetched
