"""What a study says: summary.json, figures, one self-contained HTML page, a table for the terminal."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.page import embedded, render
from inclined_landing.eval.base.statistics import proportion, spread
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.base.tables import new_table, printer
from inclined_landing.eval.landings import maps, sensitivity
from inclined_landing.eval.landings.landing import OUTCOMES, RESULTS
from inclined_landing.eval.landings.study import Levels, Study, known_parameters
from inclined_landing.models import storage

_OUTPUTS = {
    "peak_force": ("peak normal force", "N", 1.0),
    "impulse": ("impulse of the first 0.1 s", "mN s", 1e-3),
    "slide_distance": ("slide distance", "cm", 1e-2),
    "settling_time": ("settling time of those that rest", "s", 1.0),
    "touchdown_normal_speed": ("normal speed at the touch", "m/s", 1.0),
    "touchdown_tangential_speed": ("downhill speed at the touch", "m/s", 1.0),
    "bounces": ("flights after the touch", "1", 1.0),
}
_SENSITIVE = ("peak_force", "slide_distance", "settling_time")
_CSS_PIXELS = 0.55  # per pixel of a figure, so that all have one text size
_MATTERS = 0.02  # a first-order index below this is not worth a sentence


def write(study: Study, table: pa.Table, out: Path) -> dict:
    """Write everything that is made from the results; returns the summary."""
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
        "study": {key: value for key, value in study.to_dict().items() if key not in ("starts", "vehicle")},
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
    figures = []
    for x, y in study.maps:
        one = maps.make_map(known[x], known[y], columns[x], columns[y], outcome)
        file = save_figure(maps.map_figure(one, fixed), out / f"map_{x}_{y}.png")
        limits = {f"along_{axis}": maps.boundary(one, axis) for axis in "xy"}
        summary["maps"].append({"x": x, "y": y, "file": file.name, "half_rest": limits})
        figures.append({"file": file, "text": boundary_sentence(one, limits)})
    if varied:
        profiles = maps.profile_figure([(known[name], column) for name, column in varied.items()], outcome)
        file = save_figure(profiles, out / "profiles.png")
        text = "Shares of the outcomes over each parameter, everything else varying as the study says."
        figures.append({"file": file, "text": text})
    summary["discussion"] = discussion(summary)
    storage.write_text(out / "index.html", page(study, summary, figures, fixed))
    storage.write_json(out / "summary.json", summary)
    return summary


def boundary_sentence(one: maps.Map, limits: dict[str, list[dict]]) -> str:
    """Where half of the landings rest, at the ends and in the middle of the map."""
    text = f"Of all landings in this map {100 * one.counts[:, :, 0].sum() / one.counts.sum():.1f} % rest. "
    # Walk along the axis on which there is one crossing more often.
    single = {axis: [r for r in limits[f"along_{axis}"] if len(r["crossings"]) == 1] for axis in "xy"}
    axis = max(single, key=lambda a: len(single[a]) / len(limits[f"along_{a}"]))
    found = single[axis]
    if not found:
        return (
            text
            + f"Nowhere is there one clear boundary; the best cell has {100 * np.nanmax(one.rests):.0f} %."
        )
    walked, other = (one.x, one.y) if axis == "x" else (one.y, one.x)
    pick = [found[0], found[len(found) // 2], found[-1]] if len(found) > 2 else found
    unit, other_unit = (" " + p.unit if p.unit != "1" else "" for p in (walked, other))
    places = []
    for row in pick:
        crossing = row["crossings"][0]
        side = "above" if crossing["rests_above"] else "below"
        places.append(f"{side} {crossing['at']:.3g}{unit} at {row['place']:.3g}{other_unit}")
    text += f"More than half rest with the {walked.label} {', '.join(places)} ({other.label})."
    gap = _over_quasi_static(one, limits["along_y"])
    if gap is not None:
        text += (
            f" The boundary lies {gap:+.3f} in friction from tan(inclination), median over the columns"
            + (": holding the slope is necessary, stopping on it takes more." if gap > 0.02 else ".")
        )
    return text


def _over_quasi_static(one: maps.Map, columns: list[dict]) -> float | None:
    """Median distance in friction of the boundary from tan(inclination), for maps of these two."""
    if (one.x.name, one.y.name) != ("inclination", "friction"):
        return None
    gaps = [
        row["crossings"][0]["at"] - math.tan(math.radians(row["place"]))
        for row in columns
        if row["crossings"] and row["crossings"][0]["rests_above"]
    ]
    return float(np.median(gaps)) if gaps else None


def discussion(summary: dict) -> list[str]:
    """Sentences that follow from the numbers."""
    known = known_parameters()
    said = []
    parts = []
    for name in OUTCOMES:
        share = summary["outcomes"][name]
        if share["count"]:
            low, high = (100 * x for x in share["interval"])
            parts.append(f"{name} {100 * share['share']:.1f} % [{low:.1f}, {high:.1f}]")
    said.append(f"Of {summary['landings']} landings: " + ", ".join(parts) + " (95 % Wilson intervals).")
    rows = [r for r in summary["sensitivities"] if r["first_order"]["rests"]["index"] is not None]
    rows.sort(key=lambda r: -r["first_order"]["rests"]["index"])
    strong = [r for r in rows if r["first_order"]["rests"]["index"] >= _MATTERS]
    if strong:
        names = [
            f"{known[r['parameter']].label} ({100 * r['first_order']['rests']['index']:.0f} %, "
            f"{'helps' if (r['log_odds'] or 0) > 0 else 'harms'})"
            for r in strong
        ]
        said.append("Whether it rests varies alone with " + ", ".join(names) + " of the variance.")
        rest = 1.0 - sum(r["first_order"]["rests"]["index"] for r in strong)
        if rest > 0.1:
            said.append(
                f"The remaining {100 * rest:.0f} % is in combinations of parameters and in what the study "
                "does not vary by itself (the start states)."
            )
    weak = [known[r["parameter"]].label for r in rows if r["first_order"]["rests"]["index"] < _MATTERS]
    if weak:
        said.append(
            f"Alone, {', '.join(weak)} change{'s' if len(weak) == 1 else ''} it by less than "
            f"{100 * _MATTERS:.0f} % of the variance."
        )
    force, settle = summary["results"]["peak_force"], summary["results"]["settling_time"]
    if force["median"] is not None:
        said.append(
            f"The slab pushes with up to {force['median']:.2f} N (median of the peaks; 95 % stay below "
            f"{force['p95']:.2f} N)."
        )
    if settle["median"] is not None:
        said.append(
            f"Those that rest are still {settle['median']:.2f} s after the touch (median; 95 % within "
            f"{settle['p95']:.2f} s)."
        )
    if summary["outcomes"]["diverges"]["count"]:
        said.append("Some simulations diverged; they are counted apart and are no landing of any kind.")
    return said


def page(study: Study, summary: dict, figures: list[dict], fixed: dict[str, float]) -> str:
    """The HTML page, everything inside."""
    known = known_parameters(study.vehicle)
    rows = []
    for p in study.parameters:
        entry = known[p.name]
        if isinstance(p, Levels):
            values = ", ".join(f"{x / entry.factor:.4g}" for x in p.values[:12])
            values += f", ... ({len(p.values)} values)" if len(p.values) > 12 else ""
        else:
            values = f"{p.low / entry.factor:.4g} to {p.high / entry.factor:.4g}, {p.distribution}"
            if p.distribution == "normal":
                values += f" ({p.mean / entry.factor:.4g} ± {p.deviation / entry.factor:.4g})"
        rows.append((entry.label, values, entry.unit))
    given = {p.name for p in study.parameters}
    defaults = [
        (known[name].label, f"{value / known[name].factor:.4g}", known[name].unit)
        for name, value in fixed.items()
        if name not in given and not math.isnan(value)
    ]
    outputs = []
    for name, (label, unit, factor) in _OUTPUTS.items():
        s = summary["results"][name]
        cells = [None if s[k] is None else s[k] / factor for k in ("p5", "median", "p95", "max")]
        outputs.append((label, unit, *("-" if c is None else f"{c:.3g}" for c in cells)))
    sensitivities = []
    for row in summary["sensitivities"]:
        odds = row["log_odds"]
        cells = [_index(row["first_order"][name]) for name in ("rests", *_SENSITIVE)]
        sensitivities.append((known[row["parameter"]].label, "-" if odds is None else f"{odds:+.2f}", *cells))
    return render(
        __package__,
        "report.html.j2",
        title=study.title or "Landing study",
        versions=summary["versions"],
        study=study,
        summary=summary,
        colours=maps.COLOURS,
        parameters=rows,
        defaults=defaults,
        start_height=f"{1e3 * fixed['start_height']:g}" if "start_height" in fixed else "some",
        outputs=outputs,
        sensitivities=sensitivities,
        figures=[
            {
                "text": figure["text"],
                "data": embedded(figure["file"].read_bytes()),
                "width": round(_png_width(figure["file"]) * _CSS_PIXELS),
            }
            for figure in figures
        ],
    )


def _png_width(file: Path) -> int:
    """Pixels, from the PNG header."""
    return int.from_bytes(file.read_bytes()[16:20], "big")


def _index(value: dict) -> str:
    if value["index"] is None:
        return "-"
    low, high = value["interval"]
    return f"{value['index']:.2f} [{low:.2f}, {high:.2f}]"


def show(summary: dict, out: Path | None = None) -> None:
    """Print the outcomes and the sensitivities."""
    known = known_parameters()
    console = printer()
    title = summary["study"]["title"] or "landing study"
    outcomes = new_table(title, "outcome", "landings", "share [%]")
    for name, share in summary["outcomes"].items():
        if share["count"]:
            low, high = (100 * x for x in share["interval"])
            outcomes.add_row(name, str(share["count"]), f"{100 * share['share']:.1f} [{low:.1f}, {high:.1f}]")
    console.print(outcomes)
    if summary["sensitivities"]:
        columns = ("parameter", "log odds of resting per s.d.", "alone, of resting", "of peak force")
        rows = new_table("Sensitivities", *columns)
        for row in summary["sensitivities"]:
            odds, first = row["log_odds"], row["first_order"]
            rows.add_row(
                known[row["parameter"]].label,
                "-" if odds is None else f"{odds:+.2f}",
                _index(first["rests"]),
                _index(first["peak_force"]),
            )
        console.print(rows)
    for sentence in summary["discussion"][1:]:
        console.print(sentence)
    if out is not None:
        console.print(f"page: {out / 'index.html'}")
