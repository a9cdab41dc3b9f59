"""The flights of others, where they are at hand: ../shared/data beside the repository, never in it."""

import numpy as np
import pytest

from inclined_landing.eval.gap import diagnose
from inclined_landing.models.parameters import load_vehicle
from tests import ROOT
from tests.validation import gap_real

DATA = ROOT.parent / "shared" / "data"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured flights at {DATA}")


@pytest.mark.slow
def test_gap_of_the_papers_interface_closes_on_flights_left_out():
    """Two flights of one day, each judged with the other fitted; at least 70 % of the gap closes."""
    logs = gap_real.flights(DATA / "utias_fmpc", "utias_20250421_*.csv.gz")
    vehicle = load_vehicle()
    d = diagnose(logs, vehicle, curves=False)
    assert d.gap["analytic"].closed > 0.9
    assert "thrust_scale" in d.effects[0].members
    # Of scale, bias and mass only the thrust in hover shows: 0.80 within what else differs by flight.
    c = d.apply(vehicle)
    thrust = c.thrust_per_pwm * vehicle.hover_pwm + c.effects_thrust_bias
    assert 0.76 < thrust / (c.body_mass * c.environment_gravity) < 0.83


def test_tilt_of_the_motion_capture_shows_on_the_floor_too():
    """The offset that the flown accelerations need is the attitude measured at rest, within 15 mrad."""
    vehicle = load_vehicle()
    logs = gap_real.flights(DATA / "utias_fmpc", "utias_*.csv.gz")
    tilts = [gap_real.tilt(log, vehicle) for log in logs]
    assert len(tilts) == 3
    for t in tilts:
        for angle in ("roll", "pitch"):
            assert t[f"{angle} by the flight"] == pytest.approx(t[f"{angle} on the floor"], abs=0.015)
        assert abs(t["roll by the flight"]) > 0.04
    pitch = [t["pitch by the flight"] for t in tilts]
    assert pitch[0] > 0.015 > -0.015 > pitch[2]  # another rigid body on the other day


def test_known_changes_of_the_hardware():
    table, _ = gap_real.compare(DATA / "crazypad", load_vehicle())
    says = {f"{r.vehicle} {r.condition}": r.says for r in table.itertuples()}
    for change in ("E8 add_weight_W1_near_M3_M4", "E8 cut_propeller_M3_3mm", "E9 add_weight_W3_near_M3"):
        assert says[change] == "more force, M3 works harder"
    for change in ("E8 tape_on_propeller_M1_M3_M4", "E8 cut_propeller_M3_1mm", "E9 cut_propeller_M3_1mm"):
        assert says[change] == "nothing"


def test_motor_lag_is_that_of_the_vehicle_file():
    lags = {lag["log"]: lag for lag in map(gap_real.motor_lag, (DATA / "arp_sysid").glob("arp_*.csv.gz"))}
    good = [lag["rate"] for lag in lags.values() if lag["fit %"] > 50.0]
    assert len(good) == 2
    np.testing.assert_allclose(good, load_vehicle().thrust_lag_rate, rtol=0.2)
