"""The policy flown from the frozen grid in both plants: success, time to land and final state."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.base.claims import Claim, Section, Table, number
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import WORDS
from inclined_landing.models.attitude import PITCH, VX, VZ, X, Z
from inclined_landing.models.plants import AnalyticPlant, MujocoPlant

ALPHA = WORDS.tables["closed_loop"]["samples"]["low"]  # of each two-sample test
QUANTITIES = ("time", "x", "z", "vx", "vz", "pitch")
UNITS = ("s", "m", "m", "m/s", "m/s", "deg")
_COLUMNS = [X, Z, VX, VZ, PITCH]
# The plants by the name the report gives them.
PAPER, EXTENDED, KINEMATIC, VEHICLE = (
    "equations (paper)",
    "equations with rate loop",
    "MuJoCo, kinematic",
    "MuJoCo, rate loop",
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Flights of two plants from the same starts, those successful in both."""

    first: str
    second: str
    same: float  # share of starts with the same outcome
    steps: np.ndarray  # (k,) control steps that the second takes longer
    period: float  # s, of a control step
    distance: dict[str, float]  # Kolmogorov-Smirnov, of each quantity
    p: dict[str, float]
    final: float  # m, largest distance of the final positions of flights of equal length

    def first_to_second(self) -> np.ndarray:
        """Return (3,) 5 % quantile, median and 95 % quantile of the second's time minus the first's [s]."""
        return np.quantile(self.steps * self.period, [0.05, 0.5, 0.95])

    def statement(self) -> str:
        """Return one sentence on the two samples."""
        significant = [q for q in QUANTITIES if self.p[q] < ALPHA]
        if not significant:
            return (
                f"{self.second} against {self.first}: no quantity differs between the two samples at the "
                f"{ALPHA:.0%} level (Kolmogorov-Smirnov, smallest p = {number(min(self.p.values()))})."
            )
        parts = ", ".join(f"{q} (D = {self.distance[q]:.2f}, p = {number(self.p[q])})" for q in significant)
        return f"{self.second} against {self.first}: the samples differ at the {ALPHA:.0%} level in {parts}."


def fly(policy: Policy, starts: np.ndarray) -> dict[str, list[Flight]]:
    """Return the policy's flights from `starts` (k, 2), by plant."""
    states = landing_starts.at_rest(policy.task, starts)
    n, v = len(states), policy.task.vehicle
    plants = {
        PAPER: AnalyticPlant(n, v),
        EXTENDED: AnalyticPlant(n, v, attitude="rate_loop", substeps=flying.FINE),
        KINEMATIC: MujocoPlant(n, v, attitude="kinematic"),
        VEHICLE: MujocoPlant(n, v),
    }
    return {name: record_flights(policy, plant, states) for name, plant in plants.items()}


def quantities(flights: list[Flight]) -> np.ndarray:
    """Return (k, 6) time to land [s] and final x, z, vx, vz, pitch [deg] of the flights."""
    rows = np.array([[f.duration, *f.state[-1, _COLUMNS]] for f in flights])
    rows[:, -1] = np.degrees(rows[:, -1])
    return rows


def compare(flown: dict[str, list[Flight]], first: str, second: str) -> Comparison | None:
    """Return the comparison of two plants; None when fewer than ten flights succeed in both."""
    from scipy.stats import ks_2samp

    pairs = [(a, b) for a, b in zip(flown[first], flown[second]) if a.success and b.success]
    same = np.mean(
        [a.success == b.success and a.touched == b.touched for a, b in zip(flown[first], flown[second])]
    )
    if len(pairs) < 10:
        return None
    a, b = (quantities([pair[k] for pair in pairs]) for k in (0, 1))
    tests = [ks_2samp(a[:, k], b[:, k]) for k in range(len(QUANTITIES))]
    equal = [(p, q) for p, q in pairs if len(p.t) == len(q.t)]
    final = max((np.linalg.norm(p.state[-1, :3] - q.state[-1, :3]) for p, q in equal), default=np.nan)
    return Comparison(
        first,
        second,
        float(same),
        np.array([len(q.t) - len(p.t) for p, q in pairs]),
        float(pairs[0][0].t[1]),
        {name: float(t.statistic) for name, t in zip(QUANTITIES, tests)},
        {name: float(t.pvalue) for name, t in zip(QUANTITIES, tests)},
        float(final),
    )


def claims(flown: dict[str, list[Flight]], twins: list[Comparison]) -> list[Claim]:
    """Return the claims: the same model flies the same, and the policy is as successful in both plants."""
    result = []
    for c in twins:
        claim = functools.partial(WORDS.claim, "closed_loop", name=f"{c.second} and {c.first}")
        result += [
            claim("outcome", c.same),
            claim("time", float(np.mean(c.steps == 0))),
            claim("final", c.final),
            claim("samples", min(c.p.values()), quantities=len(QUANTITIES)),
        ]
    share = {name: np.mean([f.strict for f in flights]) for name, flights in flown.items()}
    return [*result, WORDS.claim("closed_loop", "success", abs(share[VEHICLE] - share[PAPER]))]


def section(policy: Policy, starts: np.ndarray) -> tuple[Section, dict]:
    """Return the section, and the flights by plant for its figure."""
    flown = fly(policy, starts)
    twins = [compare(flown, PAPER, KINEMATIC), compare(flown, EXTENDED, VEHICLE)]
    cross = compare(flown, PAPER, VEHICLE)
    rows, summary = [], {}
    for name, flights in flown.items():
        landed = [f for f in flights if f.success]
        share = proportion(sum(f.strict for f in flights), len(flights))
        middle = np.median(quantities(landed), axis=0) if landed else np.full(6, np.nan)
        summary[name] = {"strict": share, "median": dict(zip(QUANTITIES, middle))}
        rows.append(
            (name, f"{len(landed)} of {len(flights)}", f"{share['count']} of {len(flights)}", *middle)
        )
    compared = [c for c in twins if c is not None]
    if len(compared) < len(twins) or cross is None:
        fewest = min(sum(f.success for f in fs) for fs in flown.values())
        found, tables = [WORDS.claim("closed_loop", "few", fewest)], []
        remarks = ["Too few landings for a comparison."]
    else:
        found = claims(flown, compared)
        remarks = [c.statement() for c in (*compared, cross)]
        early, middle, late = cross.first_to_second()
        remarks.append(
            f"From the same start, {cross.second} lands {middle:+.2f} s later than {cross.first} (median; "
            f"90 % of the starts: {early:+.2f} to {late:+.2f} s). Another loop is another closed-loop "
            "flight: both reach the goal, by ways that differ."
        )
        tests = [
            (q, *(f"{number(c.distance[q])} ({number(c.p[q])})" for c in (*compared, cross)))
            for q in QUANTITIES
        ]
        heads = tuple(f"{c.second} – {c.first}" for c in (*compared, cross))
        tables = [
            Table("Two-sample distance D (and p) of Kolmogorov and Smirnov", ("quantity", *heads), tests)
        ]
    heads = ("plant", "success", "without touching", *(f"{q} [{u}]" for q, u in zip(QUANTITIES, UNITS)))
    part = WORDS.section(
        "closed_loop",
        found,
        {"policy": policy.path.name, "starts": len(starts)},
        tables=[Table("Landings and medians at the goal box", heads, rows), *tables],
        remarks=remarks,
        data={
            "plants": summary,
            "comparisons": [dataclasses.asdict(c) for c in (*twins, cross) if c is not None],
        },
    )
    return part, flown
