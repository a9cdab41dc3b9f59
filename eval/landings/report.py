"""The report of a study: summary.json, figures, one self-contained HTML page, a terminal table."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pyarrow as pa

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.page import embedded, render
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.landings import maps, sensitivity
from inclined_landing.eval.landings.landing import OUTCOMES, RESULTS
from inclined_landing.eval.landings.parameters import known_parameters
from inclined_landing.eval.landings.study import Study
from inclined_landing.models.base import storage

_SENSITIVE = ("peak_force", "slide_distance", "settling_time")
_CSS_PIXELS = 0.55  # per pixel of a figure, so that all have one text size
_ROUNDING = 1e-9  # of a quantity in a table
_MATTERS = 0.02  # a first-order index below this is not worth a sentence


def write(study: Study, table: pa.Table, out: Path) -> dict:
    """Write all derived outputs and return the summary."""
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    outcome = np.array([OUTCOMES.index(name) for name in columns["outcome"]])
    known = known_parameters(study.vehicle)
    varied = {name: columns[name] for name in study.varied}
    fixed = {name: float(columns[name][0]) for name in known if name not in varied}
    if study.starts:  # these are part of the start states
        fixed = {
            name: x for name, x in fixed.items() if name == "inclination" or not known[name].at_touchdown
        }
    rests = outcome == OUTCOMES.index("rests")
    summary = {
        "command": "contact",
        "study": {
            key: value for key, value in dataclasses.asdict(study).items() if key not in ("starts", "vehicle")
        },
        "start_states": len(study.starts),
        "landings": len(outcome),
        "outcomes": {name: proportion((outcome == k).sum(), len(outcome)) for k, name in enumerate(OUTCOMES)},
        "results": {name: spread(columns[name]) | {"meaning": RESULTS[name]} for name in RESULTS},
        "sensitivities": sensitivity.table(
            varied, {name: columns[name] for name in _SENSITIVE}, rests, study.seed
        ),
        "maps": [],
        "versions": runs.versions(),
    }
    figures = {}
    for x, y in study.maps:
        one = maps.make_map(known[x], known[y], columns[x], columns[y], outcome)
        file = save_figure(maps.map_figure(one, fixed), out / f"map_{x}_{y}.png")
        limits = {f"along_{axis}": maps.boundary(one, axis) for axis in "xy"}
        summary["maps"].append({"x": x, "y": y, "file": file.name, "half_rest": limits})
        figures[file] = maps.map_words(one, fixed)
    summary["discussion"] = discussion(summary)
    storage.write_text(out / "index.html", page(study, summary, figures, fixed))
    storage.write_json(out / "summary.json", summary)
    return summary


def discussion(summary: dict) -> list[str]:
    """Return the sentences that follow from the numbers."""
    known = known_parameters()
    parts = [f"{name} {share:.1f} % [{low:.1f}, {high:.1f}]" for name, _, share, low, high in _seen(summary)]
    said = [f"Of {summary['landings']} landings: {', '.join(parts)} (95 % Wilson intervals)."]
    # (index, label, does more of it help) of the parameters, the strongest first
    rows = [
        (row["first_order"]["rests"]["index"] or 0.0, known[row["parameter"]].label, row["log_odds"])
        for row in summary["sensitivities"]
    ]
    names = [
        f"{label} {100 * index:.0f} % ({'more' if (odds or 0) > 0 else 'less'} of it helps)"
        for index, label, odds in sorted(rows, key=lambda row: -row[0])
        if index >= _MATTERS
    ]
    if names:
        said.append(f"Share of the outcome's variance explained by each parameter alone: {', '.join(names)}.")
        if (total := sum(index for index, _, _ in rows)) > 1.0:
            said.append(f"These shares are estimates: together they come to {100 * total:.0f} %.")
    return said


def _seen(summary: dict) -> list[tuple]:
    """Return name, count, share and interval [%] of the outcomes that occur."""
    return [
        (name, share["count"], 100 * share["share"], *(100 * x for x in share["interval"]))
        for name, share in summary["outcomes"].items()
        if share["count"]
    ]


def page(study: Study, summary: dict, figures: dict[Path, str], fixed: dict[str, float]) -> str:
    """Return the HTML page, everything inside; figures: captions by file."""
    given = {p.name for p in study.parameters}
    pictures = []
    for file, text in figures.items():
        data = file.read_bytes()
        pixels = int.from_bytes(data[16:20], "big")  # the width in a PNG header
        pictures.append({"text": text, "data": embedded(data), "width": round(pixels * _CSS_PIXELS)})
    return render(
        __package__,
        "report.html.j2",
        title=study.title or "Landing study",
        versions=summary["versions"],
        study=study,
        summary=summary,
        seen=_seen(summary),
        colours=maps.COLOURS,
        known=known_parameters(study.vehicle),
        defaults={name: x for name, x in fixed.items() if name not in given and not math.isnan(x)},
        start_height=f"{1e3 * fixed['start_height']:g}" if "start_height" in fixed else "a few",
        sensitive=("rests", *_SENSITIVE),
        figures=pictures,
        number=_number,
    )


def _number(x: float) -> str:
    """Return a number with three digits; 0 for rounding errors of either sign."""
    return f"{0.0 if abs(x) < _ROUNDING else x:.3g}"


def show(summary: dict, out: Path) -> None:
    """Print the outcomes and the discussion."""
    outcomes = new_table(summary["study"]["title"] or "landing study", "outcome", "landings", "share [%]")
    for name, count, share, low, high in _seen(summary):
        outcomes.add_row(name, str(count), f"{share:.1f} [{low:.1f}, {high:.1f}]")
    show_table(outcomes)
    counted, *more = summary["discussion"]
    say(*more, f"{counted} The page is {out / 'index.html'}.")
