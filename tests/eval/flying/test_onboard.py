"""The vehicle's own position, by a Lighthouse deck: what it shows, and what it cannot fly."""

import json
import math

import numpy as np
import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.flying import positions
from inclined_landing.eval.flying.positions import OnboardPosition
from inclined_landing.eval.flying.simulated.sensors import LATE, NOISE, OFFSET, SCALE, Lighthouse
from inclined_landing.eval.flying.simulated.world import URI, World
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.models.base.errors import UserError

UNSURE = np.full(3, 2 * positions.UNSURE) ** 2
SURE = np.full(3, 1e-3)


class _Moved:
    """A body on a straight way at a velocity (3,)."""

    def __init__(self, velocity):
        self.velocity, self.time = np.array(velocity), 0.0

    def state_at(self, time):
        state = np.zeros(13)
        state[:3], state[3:6] = np.array([0.0, 0.0, 1.5]) + time * self.velocity, self.velocity
        return state


def errors(velocity, seconds, flights=40, blind=False):
    """Errors (flights, 3) [m] after some seconds of a straight way."""
    found = []
    for k in range(flights):
        body = _Moved(velocity)
        deck = Lighthouse(body, np.random.default_rng(k))
        deck.blind = blind
        for t in np.arange(0.01, seconds + 1e-9, 0.01):
            shown = deck.estimate(t)[0]
        found.append(shown - body.state_at(seconds)[:3])
    return np.array(found)


def test_a_lighthouse_is_off_by_centimetres_and_does_not_drift():
    """Offset, and scale at 2 m: hypot(1, 2) cm on an axis at most; 120 draws of it stay within 3.5 of it."""
    found = errors((0.2, 0.0, 0.0), 10.0)
    limit = 3.5 * math.hypot(OFFSET, 2.0 * SCALE, 0.0) + 3.5 * NOISE + LATE * 0.2
    assert 0.003 < np.sqrt((found**2).mean()) and np.abs(found).max() < limit


def test_a_blind_deck_is_lost_and_says_so():
    deck = Lighthouse(_Moved((0.0, 0.0, 0.0)), np.random.default_rng(0))
    assert deck.estimate(0.0)[1] < positions.UNSURE**2
    deck.blind = True
    for t in np.arange(0.01, 1.0, 0.01):
        variance = deck.estimate(t)[1]
    assert variance > positions.UNSURE**2
    assert np.linalg.norm(errors((0.0, 0.0, 0.0), 3.0, 8, True), axis=1).mean() > 0.3


def test_positions_are_believed_while_the_filter_knows_its_velocity():
    shown = OnboardPosition()
    shown.add_position(1.0, np.ones(3))
    assert shown.latest() is None  # nothing is known of it yet
    shown.add_variance(SURE)
    shown.add_position(2.0, np.ones(3))
    shown.add_position(3.0, np.array([math.nan, 0.0, 0.0]))
    shown.add_variance(UNSURE)
    shown.add_position(4.0, np.ones(3))
    assert shown.latest().time == 2.0 and shown.latest().position.tolist() == [1.0, 1.0, 1.0]


def test_a_vehicle_without_the_deck_cannot_fly_by_it():
    world = World(seed=1)
    radio = Radio(world, world, 0.5)
    radio.connect(URI)
    with pytest.raises(UserError, match="no deck that measures its position"):
        radio.onboard_position()


def test_a_landing_by_lighthouse(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["fly", "--simulated", "--position", "onboard", "--start=1,1.5"]
    assert cli.main([*words, "--seed=2", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "onboard position (Lighthouse deck)" in said and "Of 1 flight, 1 reached the goal box" in said
    assert json.loads((out / "fly.json").read_text("utf-8"))["position"] == "onboard"


@pytest.mark.slow
def test_a_deck_that_goes_blind_ends_the_flight(tmp_path, capsys):
    words = ["fly", "--simulated", "--position", "onboard", "--start=1,1.5", "--seed=2"]
    assert cli.main([*words, "--fault=deck-blind@air+2", "--out", str(tmp_path / "blind")]) == 3
    assert "no position" in capsys.readouterr().out


def test_a_deck_that_the_vehicle_does_not_fly_by_cannot_fail(tmp_path, capsys):
    assert cli.main(["fly", "--simulated", "--fault=deck-blind", "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "deck-blind needs --position onboard" in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()
