"""The flights of others, where they are at hand: ../shared/data beside the repository, never in it."""

import numpy as np
import pytest

from inclined_landing.eval.gap import diagnose
from inclined_landing.models.parameters import load_vehicle
from tests import ROOT
from tests.proof.gap_real import attitude, halves, pads, thrust
from tests.proof.gap_real.command import MOTORS, flights

DATA = ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured flights at {DATA}")


@needs_data
def test_gap_of_the_papers_interface_closes_on_flights_left_out():
    """Two flights of one day, each judged with the other fitted; at least 70 % of the gap closes."""
    logs = flights(DATA / "utias_fmpc", "utias_20250421_*.csv.gz")
    vehicle = load_vehicle()
    d = diagnose(logs, vehicle, curves=False)
    assert d.gap["analytic"].closed > 0.9
    assert "thrust_scale" in d.effects[0].members
    # Of scale, bias and mass only the thrust in hover shows: 0.80 within what else differs by flight.
    c = d.apply(vehicle)
    thrust = c.thrust_per_pwm * vehicle.hover_pwm + c.effects_thrust_bias
    assert 0.76 < thrust / (c.body_mass * c.environment_gravity) < 0.83


@needs_data
def test_effects_are_the_same_in_both_halves():
    logs = flights(DATA / "utias_fmpc", "utias_20250421_*.csv.gz")
    values = {
        "thrust_scale": {"scale": 0.8},
        "mocap_tilt": {"roll": 0.045, "pitch": 0.02},
        "attitude_trim": {"roll": -0.015, "pitch": -0.02},
        "attitude_gain": {"scale": 0.8},
    }
    for row in halves.stability(logs, load_vehicle(), values):
        assert row.apart < 1.0, row


@needs_data
def test_tilt_of_the_motion_capture_shows_on_the_floor_too():
    """The offset that the flown accelerations need is the attitude measured at rest, within 15 mrad."""
    vehicle = load_vehicle()
    tilts = [attitude.tilt(log, vehicle) for log in flights(DATA / "utias_fmpc", "utias_*.csv.gz")]
    assert len(tilts) == 3
    for t in tilts:
        np.testing.assert_allclose(t.flown, t.rest, atol=0.015)
        assert abs(t.flown[0]) > 0.04
    assert tilts[0].flown[1] > 0.015 > -0.015 > tilts[2].flown[1]  # another rigid body on the other day


@needs_data
def test_thrust_follows_voltage_and_floor():
    result = thrust.law(flights(DATA / "nanobench", "nb_*.csv.gz", str(MOTORS)), load_vehicle())
    value, half = result.voltage
    assert value - half > 0.0
    assert 0.5 < value < 1.7
    near = result.near
    assert near.ratio[near.below <= 0.05].min() > 1.03
    assert abs(near.ratio[near.above >= 0.12] - 1.0).max() < 0.03


@needs_data
def test_known_changes_of_the_hardware():
    table, _ = pads.compare(DATA / "crazypad", load_vehicle())
    says = {f"{r.vehicle} {r.condition}": r.says for r in table.itertuples()}
    for change in ("E8 add_weight_W1_near_M3_M4", "E8 cut_propeller_M3_3mm", "E9 add_weight_W3_near_M3"):
        assert says[change] == "more force, M3 works harder"
    for change in ("E8 tape_on_propeller_M1_M3_M4", "E8 cut_propeller_M3_1mm", "E9 cut_propeller_M3_1mm"):
        assert says[change] == "nothing"
