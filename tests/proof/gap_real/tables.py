"""What stands above and below the tables of docs/real_flights.md, and the tables of a fleet."""

from __future__ import annotations

from collections.abc import Sequence

from inclined_landing.eval.gap.report.words import residual_sentences
from inclined_landing.eval.gap.result import Diagnosis, PlantGap
from tests.proof.gap_real.attitude import Lean
from tests.proof.gap_real.halves import Fleet, Stability
from tests.proof.gap_real.thrust import Law
from tests.proof.shared import cell, table_of

_SETS = 5  # told of a diagnosis


def section(title: str, *parts: str | Sequence) -> str:
    """Return a heading with sentences and tables of rows below it."""
    texts = [part if isinstance(part, str) else table_of(part) for part in parts]
    return "\n\n".join([f"## {title}", *(text.rstrip() for text in texts if text)]) + "\n"


def fleet(s: Fleet) -> str:
    """Return what was named, how much of the gap closed, and how stable it is."""
    d = s.diagnosis
    judged = (
        ("left out in turn", d),
        ("first halves fitted, second judged", s.first),
        ("second halves fitted, first judged", s.second),
    )
    return section(
        s.title,
        f"{len(d.flights)} flights, verdict `{d.verdict}`.",
        [gap_row(f"{name}, {plant}", gap) for name, part in judged for plant, gap in part.gap.items()],
        stability(s.stability),
        [
            {"all regimes": f"{row.channel} {row.unit}", "before": row.before, "after": row.after}
            | {"noise": row.floor}
            for row in d.where
            if row.regime == "all"
        ],
        [
            {"channel": name, "noise": x.noise, "disturbance": f"{x.size:.3g} {list(x.size_ci95)} {x.unit}"}
            | {"correlation time": f"{x.time:.2g} {list(x.time_ci95)} s"}
            for name, x in d.disturbance.items()
        ],
        [{"probability": x.probability, "set": ", ".join(x.effects) or "nothing"} for x in d.sets[:_SETS]],
        *(f"Named, {name}: {named(part)}" for name, part in judged),
        *residual_sentences(d),
    )


def gap_row(name: str, gap: PlantGap) -> dict:
    """Return the position errors [cm] one second ahead."""
    row = {"1 s position error": name, "before cm": 100 * gap.before, "after cm": 100 * gap.after}
    return row | {"noise cm": 100 * gap.floor, "closed": f"{100 * gap.closed:.0f} %"}


def stability(rows: Sequence[Stability]) -> list[dict]:
    """Return every parameter fitted to all flights and to their halves."""
    return [
        {"effect": r.effect, "parameter": f"{r.parameter} {r.unit}", "all": r.all, "first halves": r.first}
        | {"second halves": r.second, "difference / 95 %": r.apart}
        for r in rows
    ]


def named(d: Diagnosis) -> str:
    """Return the effects with their classes and values."""
    return "; ".join(
        f"{'/'.join(e.members)} ({e.probability:.2f}) "
        + ", ".join(f"{k} {p.value:.4g}" for k, p in e.parameters.items())
        for e in d.effects
    )


def law(result: Law) -> str:
    """Return thrust against PWM, voltage and height."""
    return section(
        "thrust of nanobench",
        f"F/m = {cell(result.level)} m/s² (PWM/55000)^({cell(result.pwm)}) (V/3.5)^({cell(result.voltage)}), "
        f"sag {cell(result.sag)} V per 10 000 PWM, "
        f"{100 * result.samples.ratio.std():.1f} % rms left in {len(result.samples)} rows",
        result.near.to_dict("records"),
    )


def lean(found: Lean) -> str:
    """Return what the onboard estimate misses in proportion to the speed."""
    return (
        f"Onboard estimate less motion capture [rad s/m], {found.flights} flights: "
        f"roll {cell(found.roll)} by the speed to the left, pitch {cell(found.pitch)} by the forward speed.\n"
    )
