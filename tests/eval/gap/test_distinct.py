"""Copies and parts of a flight are evidence once, and no evaluation of what is fitted."""

import dataclasses
import gzip
import os
import shutil

import numpy as np
import pandas
import pytest

from inclined_landing.eval.gap.measured.usable import (
    check_unused,
    distinct,
    fingerprint,
    read_flights,
    usable_flights,
)
from inclined_landing.eval.logs import write_log
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.eval.logs.test_checks import flight


def named(log, name):
    return dataclasses.replace(log, name=name)


FLIGHT, OTHER = flight(0, name="a"), flight(1, name="b")
AGAIN = {
    "copied": FLIGHT,
    "cut out": FLIGHT.rows(slice(300, 900)),
    "every second row": FLIGHT.rows(slice(None, None, 2)),
    "later, and turned once more": dataclasses.replace(
        FLIGHT, t=FLIGHT.t + 5.0, attitude=FLIGHT.attitude + [0.0, 0.0, 2.0 * np.pi]
    ),
    "without its voltage": dataclasses.replace(FLIGHT, voltage=None),
}


@pytest.mark.parametrize("how", AGAIN)
def test_a_flight_counts_once_however_it_comes_again(how):
    again = named(AGAIN[how], "again")
    logs, heldout, aside, notes = distinct([FLIGHT, OTHER, again], [])
    assert [log.name for log in logs] == ["a", "b"] and not heldout and not notes
    assert [(one.flight, one.reason) for one in aside] == [("again", "it is the same flight as a.")]
    with pytest.raises(UserError, match="again holds the same flight as a; fitting and evaluation need"):
        distinct([FLIGHT, OTHER], [again])
    check_unused([OTHER], {"again": fingerprint(again)}, "of the reference")
    with pytest.raises(UserError, match="a holds the same flight as again of the reference"):
        check_unused([OTHER, FLIGHT], {"again": fingerprint(again)}, "of the reference")


def test_of_flights_that_overlap_each_row_counts_once():
    first, second = (
        named(FLIGHT.rows(FLIGHT.t <= 8.0), "first"),
        named(FLIGHT.rows(FLIGHT.t >= 5.0), "second"),
    )
    logs, _, aside, notes = distinct([first, second], [])
    assert [len(log) for log in logs] == [801, 399] and logs[1].t[0] > 8.0 and not aside
    assert notes == ("second: 43 % of its rows are those of first: they count once",)
    # What a cut-out of the fitted flight does not have may be held out.
    (fitted,), (rest,), _, _ = distinct([first], [FLIGHT])
    assert len(fitted) == 801 and rest.t[0] > 8.0


def test_the_order_in_which_flights_are_given_changes_nothing():
    """Samples of the flights are drawn by their place, and of copies the first one counts."""
    logs = [named(flight(k), f"flight {k}") for k in (10, 2, 1)]
    logs.append(named(logs[0], "flight 11"))  # a copy of flight 10
    for given in (logs, logs[::-1]):
        usable = usable_flights(given, [], load_vehicle(), None)
        assert [f.name for f in usable.fitted] == ["flight 1", "flight 2", "flight 10"]
        assert [one.flight for one in usable.set_aside] == ["flight 11"]


def test_flights_that_rest_at_one_place_are_two():
    logs = []
    for name, log in (("one", FLIGHT), ("other", OTHER)):
        position, attitude = np.round(log.position, 3), np.round(log.attitude, 2)
        position[:400], attitude[:400] = [0.0, 0.0, 0.05], 0.0
        logs.append(dataclasses.replace(log, name=name, position=position, attitude=attitude))
    assert distinct(logs, [])[0] == logs


@pytest.mark.parametrize("how", ["copy", "hard link", "packed", "fewer digits, millimetres"])
def test_files_of_one_flight_are_known_by_what_they_hold(tmp_path, how):
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    write_log(a, FLIGHT)
    if how == "copy":
        shutil.copy(a, b)
    elif how == "hard link":
        os.link(a, b)
    elif how == "packed":
        b.write_bytes(gzip.compress(a.read_bytes()))
    else:
        table = pandas.read_csv(a)
        table = table.assign(**{f"{name}_mm": (1e3 * table[name]).round(3) for name in "xyz"})
        table.drop(columns=list("xyz")).round(6).to_csv(b, index=False)
    flights = read_flights([str(a), str(b)])
    assert [one.flight for one in distinct(flights.logs, [])[2]] == ["b"]
    with pytest.raises(UserError, match="a holds the same flight as b of the reference"):
        read_flights([str(a)], reference=[str(b)])
