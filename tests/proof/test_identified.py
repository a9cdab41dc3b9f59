"""The shipped vehicles that were identified, and what is told of their flights."""

import re

import pytest

from inclined_landing.eval.logs.flights.convert import public_sets
from inclined_landing.models.parameters import load_vehicle, locate_vehicle

from .causes.rows import _expanded
from .identified.command import vehicles


@pytest.mark.parametrize("name", vehicles())
def test_a_shipped_vehicle_is_what_its_entry_says(name):
    entry, vehicle = vehicles()[name], load_vehicle(name)
    assert vehicle.body_mass == entry["mass"] and vehicle != load_vehicle(entry["base"])
    text = locate_vehicle(name).read_text("utf-8")
    assert f'based_on = "{entry["base"]}"' in text
    assert public_sets()[entry["set"]].commit[:7] in text


def test_no_flight_of_the_heldout_half_of_the_causes_is_among_them():
    """Those are the odd ones from log100 on, and of the flights with a load."""
    for entry in vehicles().values():
        patterns = [*entry["fitted"], *(p for one in entry["judged"] for p in one["flights"])]
        flights = [flight for pattern in patterns for flight in _expanded(pattern)]
        assert not any("payload" in flight for flight in flights)
        numbers = [int(n) for flight in flights for n in re.findall(r"logs/log(\d+)", flight)]
        assert all(n < 100 or n % 2 == 0 for n in numbers)
        fitted = {flight for pattern in entry["fitted"] for flight in _expanded(pattern)}
        assert not fitted & {f for one in entry["judged"] for p in one["flights"] for f in _expanded(p)}
