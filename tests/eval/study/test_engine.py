"""The engine of all studies: from cases to rows, tables, figures and sentences."""

import itertools
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from inclined_landing.envs.shared import progress
from inclined_landing.envs.shared.measures import STRICT, TOUCHED, alone, median_of, with_ends
from inclined_landing.eval.study import panels, show
from inclined_landing.eval.study.engine import Case, Contrast, Panel, Study, View, run
from inclined_landing.eval.study.flights import SharedFlights
from inclined_landing.models.base.errors import UserError

SPEED = median_of("speed", "speed", "m/s")


def flights_of(landed, of=4):
    """Return `of` flights, the first `landed` of which land, with speeds 1, 2, 3 ... m/s."""
    return pd.DataFrame({"strict": np.arange(of) < landed, "speed": np.arange(1.0, of + 1.0)})


def study_of(landed, views, **options):
    """Return a study of two policies on two vehicles; landed: flights that land, by policy and vehicle."""
    cases = [
        Case({"policy": policy, "vehicle": vehicle}, lambda n=n: flights_of(n))
        for (policy, vehicle), n in landed.items()
    ]
    return Study(name="one", title="One", cases=cases, views=views, remarks=lambda _: ["said"], **options)


LANDED = dict(zip(itertools.product("ab", ("light", "heavy")), (4, 2, 3, 1)))


def test_flights_are_counted_by_their_labels_and_pooled_over_the_others():
    views = [View(("policy", "vehicle"), (STRICT, SPEED)), View(("policy",), (STRICT,))]
    (results,) = run([study_of(LANDED, views)])
    for (policy, vehicle), n in LANDED.items():
        row = results.one(STRICT, policy=policy, vehicle=vehicle)
        assert (row["count"], row["flights"], row["value"]) == (n, 4, n / 4)
        assert row["low"] < row["value"] or n == 0
    assert [row["count"] for row in results.all(STRICT, vehicle=None)] == [6, 4]
    speed = results.one(SPEED, policy="a", vehicle="light")
    assert speed["value"] == 2.5 and (speed["min"], speed["max"]) == (1.0, 4.0)
    assert len({tuple(row) for row in show.document("x", [results])["rows"]}) == 1  # one shape


def test_tables_that_are_simulated_together_can_be_read_in_any_order():
    shared = SharedFlights(flights_of(landed) for landed in range(4))
    assert [shared.table(k)["strict"].sum() for k in (2, 0, 3, 2)] == [2, 0, 3, 2]


def test_flights_without_a_label_are_not_in_its_view():
    cases = [
        Case({"policy": "a", "speed_of": 1.0}, lambda: flights_of(1)),
        Case({"policy": "a"}, lambda: flights_of(4)),
    ]
    views = [View(("speed_of",), (STRICT,)), View(("policy",), (STRICT,))]
    study = Study(name="one", title="One", cases=cases, views=views, remarks=lambda _: [])
    (results,) = run([study])
    assert results.one(STRICT, policy=None)["flights"] == 4
    assert results.one(STRICT, policy="a")["flights"] == 8


def test_measures_among_some_flights():
    landed = median_of("speed", "speed", "m/s", among="strict")
    (results,) = run([study_of({("a", "light"): 2}, [View(("policy",), (landed, SPEED))])])
    by_landing, overall = results.rows
    assert (by_landing["value"], by_landing["flights"]) == (1.5, 2)
    assert (overall["value"], overall["flights"]) == (2.5, 4)


def test_differences_are_paired():
    """By flight: the vehicles' differences are -1/4 each, on the same starts."""
    views = [View(("policy",), (STRICT,)), Contrast(("vehicle",), (STRICT,), unit="flight")]
    (results,) = run([study_of(LANDED, views)])
    for vehicle in ("light", "heavy"):
        row = results.one("strict difference", policy="b", vehicle=vehicle)
        assert row["value"] == -0.25 and row["low"] < -0.25 < row["high"] and row["flights"] == 4
    alone = {key: n for key, n in LANDED.items() if key[0] == "a"}
    (results,) = run([study_of(alone, views)])
    assert not results.all("strict difference")


def test_a_table_has_a_row_for_each_set_of_labels():
    views = [View(("policy", "vehicle"), (STRICT, SPEED), "all")]
    (results,) = run([study_of(LANDED, views, heads={"vehicle": "of"})])
    (section,) = show.sections(results)
    (table,) = section.tables
    assert table.heads == ("policy", "of", "flights", "strict [%]", "speed [m/s]")
    assert table.rows[1][:3] == ("", "heavy", "4")
    assert table.rows[1][3].startswith("50.0 [") and table.rows[1][4].startswith("2.50 (")
    assert section.text == ["said"] and "Wilson" in section.remarks[0]


@pytest.mark.parametrize("show_cell, text", [(with_ends, "0.00 (0.00 to 1,234.50)"), (alone, "0.00")])
def test_cells_have_no_minus_before_zero(show_cell, text):
    row = {"value": -0.004, "low": -0.0, "high": 1234.5, "statistic": "median", "count": 3}
    assert show_cell(row, 1.0, 2) == text
    assert show_cell(row | {"count": 1}, 1.0, 2) == "0.00"


def test_the_terminal_begins_with_the_answer_and_has_the_lowest_rows_of_long_tables(capsys):
    landed = {(policy, f"v{k:02}"): 4 - 3 * (k in (7, 20)) for policy in "ab" for k in range(30)}
    show.show(run([study_of(landed, [View(("vehicle", "policy"), (STRICT, SPEED), "all")])]))
    printed = capsys.readouterr().out.splitlines()
    assert printed[:3] == ["One", "said", "All: strict [%], the lowest 10 of 30 rows"]
    rows = [line.split() for line in printed if line[2:3] == "v" and line[3].isdigit()]
    assert len(rows) == 10 and len(printed) < 25
    assert [row[0] for row in rows if row[1] == "25.0"] == ["v07", "v20"]


def test_figures_show_every_number():
    numbers = {("a", 0.9): 2, ("a", 1.0): 4, ("b", 0.9): 3, ("b", 1.0): 1}
    study = study_of(
        numbers,
        [View(("policy", "vehicle"), (STRICT,))],
        panels=[Panel("Over thrust", STRICT, "vehicle", "thrust [1]"), Panel("By name", STRICT, "vehicle")],
    )
    (results,) = run([study])
    left, right = panels.draw(results).axes
    lines = [line.get_xydata() for line in left.lines if line.get_gid() == "share"]
    np.testing.assert_allclose(lines, [[[0.9, 50], [1.0, 100]], [[0.9, 75], [1.0, 25]]])
    assert [text.get_text() for text in right.get_yticklabels()] == ["0.9", "1.0"]
    marks = [bar.lines[0].get_xydata() for bar in right.containers]
    np.testing.assert_allclose(np.concatenate(marks)[:, 0], [50, 100, 75, 25])


def test_long_work_says_how_long_it_takes_and_what_is_done(monkeypatch, capsys):
    study = study_of({("one", f"vehicle {k}"): 1 for k in range(3)}, [View(("policy",), (STRICT,))])
    run([study])
    assert not capsys.readouterr().err.strip()
    clock = iter(range(0, 10_000, 100))
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    run([study])
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("100 s: 1 of 3 cases, about 3 min left, one, vehicle 0: 1 of 4 flights")
    assert [line.partition(",")[0] for line in said[1:]] == ["200 s: 2 of 3 cases", "300 s: 3 of 3 cases"]


def test_a_simulation_that_diverges_is_said_with_its_case():
    def diverge():
        raise FloatingPointError("vehicle 3 diverged")

    case = Case({"policy": "wild", "vehicle": "heavy"}, diverge)
    study = Study(
        name="one", title="One", cases=[case], views=[View(("policy",), (TOUCHED,))], remarks=lambda _: []
    )
    with pytest.raises(UserError, match="wild, heavy: vehicle 3 diverged"):
        run([study])
