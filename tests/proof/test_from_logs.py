"""The table of docs/from_logs_to_policy.md: its cases can be hidden, and its rows are told from results."""

import pytest

from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from tests import ROOT
from tests.proof import from_logs
from tests.proof.simulator import World

DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", from_logs.CASES)
def test_a_case_is_hidden_in_the_simulator_and_known_to_the_library(name):
    hidden = from_logs.CASES[name]
    assert set(hidden.world) <= set(World._fields)
    assert LIBRARY[name].apply(load_vehicle(), hidden.parameters) != load_vehicle()
    assert f"| {name.replace('_', ' ')} |" in (DOCS / "from_logs_to_policy.md").read_text("utf-8")


def test_strict_landings_are_counted():
    assert from_logs.strict("landing-nominal", load_vehicle())["count"] == 250
