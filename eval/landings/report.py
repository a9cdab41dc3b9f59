"""The evaluation of a study's landings: shares, quantiles, sensitivities, maps and sentences."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from inclined_landing.envs.shared.measures import Measure, Row, median_of, share, share_of, with_ends
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.landings import maps
from inclined_landing.eval.landings.landing import OUTCOMES
from inclined_landing.eval.landings.parameters import known_parameters
from inclined_landing.eval.landings.sensitivity import variance_shares
from inclined_landing.eval.landings.study import LandingStudy, Levels, Range
from inclined_landing.eval.study import engine
from inclined_landing.eval.study.engine import Results, View, fact

_MATTERS = 0.02  # a share of the variance below this is not worth a sentence
_CM: dict[str, Any] = {"shown_unit": "cm", "factor": 100.0}
_OUTCOMES = (
    "a landing rests if the vehicle is still and on its feet at the end; it tips over if it tilts by more "
    "than 60 degrees from the normal, or ends on anything but its feet; it slides off if it leaves over the "
    "edge in contact, or still moves in contact at the end; it bounces off if it leaves over the edge "
    "through the air, and misses if the slab is not touched from above"
)
_INDEX = (
    "shares of the variance: from one fit of a sum of functions of a parameter each, so that together they "
    "are at most 100 %; the rest is interactions and chance; negative where a parameter counteracts another "
    "that it is correlated with; 95 % jackknife intervals"
)
SHARES = tuple(share_of(name, name, note=_OUTCOMES) for name in OUTCOMES)
QUANTILES = (
    median_of("peak_force", "peak normal force", "N"),
    median_of("impulse", "impulse of the first 0.1 s", "N s", shown_unit="mN s", factor=1e3),
    median_of("slide_distance", "slide distance", "m", **_CM),
    median_of("settling_time", "settling time of landings that come to rest", "s"),
    median_of("touchdown_time", "time of the touchdown", "s"),
    median_of("touchdown_normal_speed", "normal speed at touchdown", "m/s"),
    median_of("touchdown_tangential_speed", "downhill speed at touchdown", "m/s"),
    median_of("touchdown_attitude_error", "attitude error at touchdown", "rad"),
    median_of("largest_tilt", "largest tilt after touchdown", "rad"),
    median_of("bounces", "bounces after touchdown", "1", shown_unit=""),
)


def _index(name: str, title: str) -> Measure:
    def cell(row: Row, factor: float, digits: int) -> str:
        return with_ends({**row, "statistic": "share"}, factor, digits)

    return Measure(name=f"index_{name}", title=title, statistic=share, cell=cell, note=_INDEX)


SENSITIVITIES = (
    _index("rests", "variance of rest"),
    _index("peak_force", "peak force"),
    _index("slide_distance", "slide distance"),
    _index("settling_time", "settling time"),
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensitivities(View):
    """The share of the variance of each result by each varied parameter."""

    varied: tuple[str, ...]

    def rows(self, landings: pd.DataFrame) -> Iterator[dict[str, Any]]:
        """Yield a row for each parameter and measure; landings without the result are omitted."""
        parameters = [landings[name].to_numpy() for name in self.varied]
        results = {m.name: landings[m.name.removeprefix("index_")].to_numpy(float) for m in self.measures}
        shares = {name: variance_shares(parameters, values) for name, values in results.items()}
        about = {"statistic": "share of the variance", "unit": "1", "flights": len(landings), "value": None}
        for k, parameter in enumerate(self.varied):
            for name, found in shares.items():
                known = {} if found is None else dict(zip(("value", "low", "high"), map(float, found[k])))
                yield {"parameter": parameter, "measure": name} | about | known


@dataclasses.dataclass(frozen=True, kw_only=True)
class Boundaries(View):
    """The boundaries at which half of the landings rest on the maps of a study, in report units."""

    drawn: Mapping[tuple[str, str], maps.Map]

    def rows(self, landings: pd.DataFrame) -> Iterator[dict[str, Any]]:
        """Yield a row for each crossing along a row or a column of a map."""
        for (x, y), one in self.drawn.items():
            for along in "xy":
                for line in maps.boundary(one, along):
                    for crossing in line["crossings"]:
                        labels = {"x": x, "y": y, "along": along, "place": line["place"]}
                        about = {"measure": "half_rest", "statistic": "interpolated", "unit": ""}
                        above = {"rests_above": crossing["rests_above"]}
                        yield labels | about | {"value": crossing["at"], **above}


def count(study: LandingStudy, landings: pd.DataFrame) -> Results:
    """Return the statistics of a study's landings, from a table with parameters, results and `outcome`."""
    known = known_parameters(study.vehicle)
    landings = landings.assign(**{name: landings["outcome"] == name for name in OUTCOMES})
    outcome = landings["outcome"].map(OUTCOMES.index).to_numpy()
    drawn = {
        (x, y): maps.make_map(known[x], known[y], landings[x].to_numpy(), landings[y].to_numpy(), outcome)
        for x, y in study.maps
    }
    fixed = {name: float(landings[name].iloc[0]) for name in known if name not in study.varied}
    if study.starts:  # these are part of the start states
        fixed = {n: x for n, x in fixed.items() if n == "inclination" or not known[n].at_touchdown}
    described = engine.Study(
        name="landings",
        title=study.title or "Landing study",
        cases=(),
        views=[
            View((), SHARES, "outcomes", across=True),
            Sensitivities(("parameter",), SENSITIVITIES, "sensitivities", varied=study.varied),
            View((), QUANTILES, "forces, distances, times", across=True),
            Boundaries(("x", "y", "along", "place"), (), drawn=drawn),
        ],
        remarks=partial(_remarks, study),
        series="parameter",
        facts=facts(study),
        draw=partial(_draw, drawn, fixed),
    )
    return engine.evaluate(described, landings)


def facts(study: LandingStudy) -> list[Row]:
    """Return the parameters of a study in report units, and the settings of the simulation."""
    found, given = [fact("study", "question", study.question)], {p.name: p for p in study.parameters}
    for name, entry in known_parameters(study.vehicle).items():
        value, p = entry.default / entry.factor, given.get(name)
        if p is not None:
            found.append(fact(entry.label, "values", _values(p, entry.factor), entry.unit))
        elif not (math.isnan(value) or (study.policy and entry.at_touchdown and name != "inclination")):
            found.append(fact(entry.label, "default", value, entry.unit))
    begin = "just above the surface; until the motors are cut, the thrust and the attitude are held"
    if study.policy:
        begin = f"where the policy {study.policy} enters the goal box, from the frozen grid"
    about = {"landings begin": begin, "sampling": study.sampling, "seed": study.seed}
    about |= {"landings": study.total, "vehicle mass [kg]": study.vehicle.body_mass}
    found += [fact("simulation", name, value) for name, value in about.items()]
    found.append(fact("simulation", "start states", len(study.starts)))
    return [*found, fact("RK4", "step", study.timestep, "s"), fact("RK4", "duration", study.duration, "s")]


def _values(p: Levels | Range, factor: float) -> str:
    if isinstance(p, Levels):
        more = f", ... ({len(p.values)} values)" if len(p.values) > 12 else ""
        return ", ".join(f"{x / factor:.4g}" for x in p.values[:12]) + more
    ends = f"{p.low / factor:.4g} to {p.high / factor:.4g}, {p.distribution}"
    return ends + f" ({p.mean / factor:.4g} ± {p.deviation / factor:.4g})" * (p.distribution == "normal")


def _draw(drawn: Mapping[tuple[str, str], maps.Map], fixed: dict[str, float], out: Path) -> dict[str, str]:
    """Write the maps into a folder, and return their captions."""
    captions = {}
    for (x, y), one in drawn.items():
        file = save_figure(maps.map_figure(one, fixed), out / f"map_{x}_{y}.png")
        captions[file.name] = maps.map_words(one, fixed)
    return captions


def _remarks(study: LandingStudy, results: Results) -> list[str]:
    """Return sentences on the shares of the outcomes and the parameters that determine rest."""
    parts = []
    for measure in SHARES:
        row = results.one(measure)
        if row["count"]:
            parts.append(f"{measure.title} {measure.text(row).replace(' [', ' % [')}")
    said = [f"Of {study.total} landings: {', '.join(parts)} (95 % Wilson intervals)."]
    known, landings = known_parameters(), results.flights
    rows = [(row["value"] or 0.0, row["parameter"]) for row in results.all("index_rests")]
    helps = {name: "more" if landings[name].corr(landings["rests"]) > 0 else "less" for _, name in rows}
    names = [
        f"{known[name].label} {100 * index:.0f} % ({helps[name]} of it helps)"
        for index, name in sorted(rows, key=lambda row: -row[0])
        if index >= _MATTERS
    ]
    if names:
        total = sum(index for index, _ in rows)
        said.append(
            f"Share of the variance of rest by each parameter: {', '.join(names)}. Together the parameters "
            f"explain {100 * total:.0f} %, the rest are interactions and chance."
        )
    return said
