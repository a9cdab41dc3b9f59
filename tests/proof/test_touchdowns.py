"""Measured touchdowns on a flat floor are found, simulated and fitted."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests import ROOT
from tests.proof import touchdowns

V = load_vehicle()
FLIGHTS = ROOT.parent / "shared" / "data" / "nanobench"
measured_flights = pytest.mark.skipif(
    not FLIGHTS.is_dir(),
    reason="the measured flights are not beside the repository (../shared/data/nanobench)",
)


@measured_flights
def test_measured_touchdowns():
    found = touchdowns.find_touchdowns(touchdowns.read_flights(FLIGHTS), V)
    assert len(found) == 8
    assert all(0.35 < d.down < 0.72 and 0.9 < d.thrust < 1.1 and d.tilt < 0.06 for d in found)
    # Straight from heights at 100 Hz: 0.44 to 0.60 was read off the authors' smoothed speeds.
    assert 0.5 < np.median([d.restitution for d in found]) < 0.6
    fit = touchdowns.fit(next(d for d in found if "B8_star" in d.flight), V)
    assert fit.rms < 0.5e-3  # m; Vicon alone scatters by some 0.2 mm
    assert fit.restitution == pytest.approx(0.60, abs=0.08) and not fit.at_bound


@measured_flights
@pytest.mark.slow
def test_touchdowns_are_reproduced_and_predicted():
    summary = touchdowns.compare(FLIGHTS, V)["summary"]
    assert summary["worst rms mm"] < 1.0  # 60 ms before to 100 ms after
    assert 0.4 < summary["median restitution"] < 0.65  # in the range read off the data
    assert 4.0 < summary["median contact time ms"] < 20.0  # samples every 10 ms
    assert summary["rebound predicted from the others, rms m/s"] < 0.1  # with their median setting


def bouncing_flight(path: Path, restitution: float) -> None:
    """A flight as NanoBench logs it: hover, descent at 0.6 m/s, a bounce in an instant."""
    t = np.arange(0.0, 4.0, 0.01)
    touch = 2.5
    z = np.where(t < 1.0, 0.054 + 0.9, 0.054 + 0.6 * (touch - t))
    z = np.where(t > touch, 0.054 + restitution * 0.6 * (t - touch), z)
    columns = {name: np.zeros_like(t) for name in touchdowns._COLUMNS}
    columns |= {"t": t, "z": z, "qw": np.ones_like(t)}
    columns |= {"vz": np.gradient(z, t)} | {name: np.full_like(t, 40_000.0) for name in touchdowns._MOTORS}
    table = np.stack(list(columns.values()), axis=1)
    with gzip.open(path, "wt") as file:
        np.savetxt(file, table, delimiter=",", header=",".join(columns), comments="")


def test_a_made_up_bounce_is_found_and_fitted(tmp_path):
    bouncing_flight(tmp_path / "nb_made_up.csv.gz", 0.5)
    (touchdown,) = touchdowns.find_touchdowns(touchdowns.read_flights(tmp_path), V)
    assert touchdown.restitution == pytest.approx(0.5, abs=0.01)
    assert touchdown.down == pytest.approx(0.6, abs=0.01) and touchdown.thrust == pytest.approx(1.0)
    fit = touchdowns.fit(touchdown, V)
    # The setting's restitution is that of a drop under gravity; with thrust near the weight the same
    # spring gives up to 0.05 more or less.
    assert fit.restitution == pytest.approx(0.5, abs=0.08) and fit.rms < 0.5e-3


def test_folders_that_hold_no_flights_are_refused(tmp_path):
    with pytest.raises(UserError, match="holds no NanoBench flights"):
        touchdowns.read_flights(tmp_path)
    with gzip.open(tmp_path / "nb_a.csv.gz", "wt") as file:
        file.write("t,x\n0,0\n")
    with pytest.raises(UserError, match="lacks the column y"):
        touchdowns.read_flights(tmp_path)
    (tmp_path / "nb_a.csv.gz").write_bytes(b"no gzip")
    with pytest.raises(UserError, match="lacks the column t"):
        touchdowns.read_flights(tmp_path)
