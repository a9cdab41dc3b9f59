"""The vehicle's own position, by a Lighthouse or a Flow deck: what it shows, and what it cannot fly."""

import json
import math

import numpy as np
import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from inclined_landing.eval import cli
from inclined_landing.eval.flying import positions
from inclined_landing.eval.flying.positions import FLOW, LIGHTHOUSE, OnboardPosition
from inclined_landing.eval.flying.simulated.body import Body
from inclined_landing.eval.flying.simulated.sensors import DeckQuality, PositioningDeck
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle

VEHICLE = load_vehicle()
UNSURE = np.full(3, 2 * positions.UNSURE) ** 2
SURE = np.full(3, 1e-3)


class _Moved:
    """A body on a straight way at a velocity (3,), above the floor or above a slab of a height."""

    def __init__(self, velocity, slab=0.0):
        self.velocity, self.slab, self.time = np.array(velocity), slab, 0.0

    def state_at(self, time):
        state = np.zeros(13)
        state[:3], state[3:6] = np.array([0.0, 0.0, 1.5]) + time * self.velocity, self.velocity
        return state

    def ground_below(self, position):
        return self.slab


def errors(kind, velocity, seconds, flights=40, blind=False):
    """Errors (flights, 3) [m] after some seconds of a straight way, from what was shown at its beginning."""
    found = []
    for k in range(flights):
        body = _Moved(velocity)
        deck = PositioningDeck(kind, body, 0.0, np.random.default_rng(k))
        first = deck.estimate(0.0)[0] - body.state_at(0.0)[:3]
        deck.blind = blind
        for t in np.arange(0.01, seconds + 1e-9, 0.01):
            shown = deck.estimate(t)[0]
        found.append(shown - body.state_at(seconds)[:3] - (first if kind == "flow" else 0.0))
    return np.array(found)


def test_a_lighthouse_is_off_by_centimetres_and_does_not_drift():
    """Offset, and scale at 2 m: hypot(1, 2) cm on an axis at most; 120 draws of it stay within 3.5 of it."""
    q = DeckQuality()
    found = errors("lighthouse", (0.2, 0.0, 0.0), 10.0)
    limit = 3.5 * math.hypot(q.offset, 2.0 * q.scale, 0.0) + 3.5 * q.noise + q.late * 0.2
    assert 0.003 < np.sqrt((found**2).mean()) and np.abs(found).max() < limit


def test_a_flow_deck_drifts_with_the_way_and_sees_its_height():
    short, long = (errors("flow", (0.5, 0.0, 0.0), seconds) for seconds in (1.0, 16.0))
    drifts = [np.sqrt((found[:, 1] ** 2).mean()) for found in (short, long)]
    # A velocity error that is remembered for T drifts by s sqrt(2 T t): 12 cm in 16 s, and 40 draws of it.
    q = DeckQuality()
    expected = q.drift * math.sqrt(2 * q.drift_time * 16.0)
    assert drifts[0] < 0.03 and 0.6 * expected < drifts[1] < 1.4 * expected
    assert np.abs(long[:, 2]).max() < 0.02


def test_a_flow_deck_takes_the_platform_for_the_floor():
    over = PositioningDeck("flow", _Moved((0.0, 0.0, 0.0), slab=1.0), 0.0, np.random.default_rng(0))
    assert over.estimate(0.0)[0][2] == pytest.approx(0.5, abs=0.01)
    body = Body(VEHICLE, start=(1.0, 0.0))
    assert body.ground_below(np.array([0.0, 0.0, 2.0])) == pytest.approx(VEHICLE.platform_surface_height)
    assert body.ground_below(np.array([1.0, 0.0, 2.0])) == 0.0
    free = Body(VEHICLE, start=(1.0, 0.0), platform=False)
    assert free.ground_below(np.array([0.0, 0.0, 2.0])) == 0.0


def test_a_blind_deck_is_lost_and_says_so():
    deck = PositioningDeck("lighthouse", _Moved((0.0, 0.0, 0.0)), 0.0, np.random.default_rng(0))
    assert deck.estimate(0.0)[1] < positions.UNSURE**2
    deck.blind = True
    for t in np.arange(0.01, 1.0, 0.01):
        variance = deck.estimate(t)[1]
    assert variance > positions.UNSURE**2
    assert np.linalg.norm(errors("lighthouse", (0.0, 0.0, 0.0), 3.0, 8, True), axis=1).mean() > 0.3


def test_positions_are_believed_while_the_filter_knows_its_velocity():
    shown = OnboardPosition(LIGHTHOUSE, (0.0, 0.0), 0.0, 0.02)
    shown.add_position(1.0, np.ones(3))
    assert shown.latest() is None  # nothing is known of it yet
    shown.add_variance(SURE)
    shown.add_position(2.0, np.ones(3))
    shown.add_position(3.0, np.array([math.nan, 0.0, 0.0]))
    shown.add_variance(UNSURE)
    shown.add_position(4.0, np.ones(3))
    assert shown.latest().time == 2.0 and shown.latest().position.tolist() == [1.0, 1.0, 1.0]


def test_a_flow_deck_begins_where_one_says_it_stands():
    shown = OnboardPosition(FLOW, (1.0, -0.5), math.pi / 2, 0.02)
    shown.add_variance(SURE)
    shown.add_position(0.0, np.array([0.3, 0.1, 0.05]))  # whatever it shows there
    shown.add_position(1.0, np.array([1.3, 0.1, 1.05]))  # a metre forward, a metre up
    np.testing.assert_allclose(shown.latest().position, [1.0, 0.5, 1.02], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"deck.bcLighthouse4": "1", "deck.bcFlow2": "1"}, LIGHTHOUSE),
        ({"deck.bcLighthouse4": "0", "deck.bcFlow2": "1"}, FLOW),
        ({"deck.bcFlow2": "1"}, FLOW),
    ],
)
def test_the_deck_is_found_by_its_parameter(values, found):
    assert positions.find_deck(values.__getitem__) == found
    with pytest.raises(UserError, match="neither a Lighthouse deck"):
        positions.find_deck(dict.fromkeys(values, "0").__getitem__)


def test_a_landing_by_lighthouse(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["fly", "--simulated", "--position", "onboard", "--deck", "lighthouse", "--start=1,1.5"]
    assert cli.main([*words, "--seed=2", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "onboard position (Lighthouse deck)" in said and "1 of 1 landed" in said
    assert json.loads((out / "fly.json").read_text("utf-8"))["position"] == "onboard"
    assert cli.main([*words, "--fault=deck-blind@air+2", "--out", str(tmp_path / "blind")]) == 3
    assert "no position" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--position=onboard"], "no deck to know its position by"),
        (["--position=onboard", "--deck=flow"], "takes the platform for the floor"),
        (["--position=onboard", "--deck=lamp"], "unknown deck lamp; known are lighthouse, flow"),
        (["--position=onboard", "--mocap=poses:1"], "--mocap is of"),
        (["--position=gps"], "must be mocap or onboard"),
        (["--deck=flow"], "--deck is of --position onboard"),
        (["--fault=deck-blind"], "needs a deck"),
    ],
)
def test_what_cannot_be_flown_by_it_is_one_sentence(words, said, tmp_path, capsys):
    assert cli.main(["fly", "--simulated", *words, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1 and not (tmp_path / "out").exists()
