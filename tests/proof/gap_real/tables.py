"""The tables of docs/real_flights.md in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from inclined_landing.eval.gap.report.words import residual_sentences
from inclined_landing.eval.gap.result import Diagnosis, PlantGap
from inclined_landing.models.vehicle import Vehicle
from tests.proof.gap_real.alignment import Estimate, PoseAlignment
from tests.proof.gap_real.attitude import Lean, Loop, Tilt
from tests.proof.gap_real.halves import Fleet, Stability
from tests.proof.gap_real.thrust import Lag, Law

_SETS = 5  # told of a diagnosis


def fleet(s: Fleet) -> str:
    """What was named, how much of the gap closed, and how stable it is."""
    d = s.diagnosis
    lines = [f"## {s.title}", "", f"{len(d.flights)} flights, verdict `{d.verdict}`.", ""]
    lines += ["| 1 s position error | before | after | noise | closed |", "|---|---|---|---|---|"]
    for name, part in (
        ("left out in turn", d),
        ("first halves fitted, second judged", s.first),
        ("second halves fitted, first judged", s.second),
    ):
        lines += [_gap(f"{name}, {plant}", gap) for plant, gap in part.gap.items()]
    lines += [
        "",
        *stability(s.stability),
        "",
        "| all regimes | before | after | noise |",
        "|---|---|---|---|",
    ]
    for row in d.where:
        if row.regime == "all":
            sizes = (row.before, row.after, row.floor)
            unit = row.unit.replace("m/s2", "m/s²")
            lines.append(f"| {row.channel} {unit} | " + " | ".join(f"{x:.2g}" for x in sizes) + " |")
    lines += ["", *disturbances(d), "", *sets(d), ""]
    lines += ["Named on all flights: " + named(d)]
    lines += ["Named on first halves: " + named(s.first), "Named on second halves: " + named(s.second), ""]
    return "\n".join([*lines, *residual_sentences(d), ""])


def disturbances(d: Diagnosis) -> list[str]:
    """Noise and disturbance of every channel."""
    lines = ["| channel | noise | disturbance | correlation time |", "|---|---|---|---|"]
    for channel, x in d.disturbance.items():
        size = f"{x.size:.3g} [{x.size_ci95[0]:.3g}, {x.size_ci95[1]:.3g}] {x.unit}".replace("s2", "s²")
        time = f"{x.time:.2g} [{x.time_ci95[0]:.2g}, {x.time_ci95[1]:.2g}] s"
        lines.append(f"| {channel} | {x.noise:.2g} | {size} | {time} |")
    return lines


def sets(d: Diagnosis) -> list[str]:
    """The most probable sets of effects."""
    lines = ["| probability | set |", "|---|---|"]
    for one in d.sets[:_SETS]:
        lines.append(f"| {one.probability:.2f} | {', '.join(one.effects) or 'nothing'} |")
    return lines


def _gap(name: str, gap: PlantGap) -> str:
    return (
        f"| {name} | {100 * gap.before:.1f} cm | {100 * gap.after:.1f} cm | "
        f"{100 * gap.floor:.1f} cm | {100 * gap.closed:.0f} % |"
    )


def stability(rows: Sequence[Stability]) -> list[str]:
    """Every parameter fitted to all flights and to their halves."""
    lines = ["| effect | parameter | all | first halves | second halves | difference / 95 % |"]
    lines += ["|---|---|---|---|---|---|"]
    for r in rows:
        cells = [f"{v:.4g} ± {h:.2g}" for v, h in (r.all, r.first, r.second)]
        unit = "" if r.unit == "1" else f" {r.unit}"
        lines.append(f"| {r.effect} | {r.parameter}{unit} | {' | '.join(cells)} | {r.apart:.2f} |")
    return lines


def given(title: str, gap: PlantGap, rows: Sequence[Stability]) -> str:
    """Effects that were given instead of found."""
    lines = [f"## {title}", "", "| 1 s position error | before | after | noise | closed |"]
    lines += ["|---|---|---|---|---|", _gap("left out", gap), "", *(stability(rows) if rows else ()), ""]
    return "\n".join(lines)


def named(d: Diagnosis) -> str:
    """The effects with their classes and values."""
    return "; ".join(
        f"{'/'.join(e.members)} ({e.probability:.2f}) "
        + ", ".join(f"{k} {p.value:.4g}" for k, p in e.parameters.items())
        for e in d.effects
    )


def law(result: Law) -> str:
    """Thrust against PWM, voltage and height."""
    lines = ["## thrust of nanobench", ""]
    lines.append(
        f"F/m = {result.level[0]:.2f} ± {result.level[1]:.2f} m/s² "
        f"(PWM/55000)^({result.pwm[0]:.2f} ± {result.pwm[1]:.2f}) "
        f"(V/3.5)^({result.voltage[0]:.2f} ± {result.voltage[1]:.2f}), "
        f"sag {result.sag[0]:.2f} ± {result.sag[1]:.2f} V per 10 000 PWM, "
        f"{100 * result.samples.ratio.std():.1f} % rms left in {len(result.samples)} rows"
    )
    lines += ["", "| height above rest | thrust ratio | flights | rows |", "|---|---|---|---|"]
    for r in result.near.itertuples():
        lines.append(
            f"| {100 * r.above:.0f} to {100 * r.below:.0f} cm | {r.ratio:.3f} ± {r.half:.3f} | "
            f"{r.flights} | {r.rows} |"
        )
    return "\n".join([*lines, ""])


def pads(table: pd.DataFrame, slopes: dict[str, float]) -> str:
    """Known hardware changes in hover."""
    head = "| vehicle, change | total % | M3 % | offset x mm | offset y mm | diagonal % | told |"
    lines = ["## crazypad", "", head, "|---|---|---|---|---|---|---|"]
    for _, r in table.iterrows():
        cells = [
            f"{r[q]:.1f} ± {r[f'{q}_half']:.1f}" for q in ("total", "M3", "offset_x", "offset_y", "diagonal")
        ]
        name = f"{r['vehicle']} {r['condition'].replace('_', ' ')}"
        lines.append(f"| {name} | {' | '.join(cells)} | {r['says']} |")
    lines += ["", f"Request per volt: {slopes['total']:.1f} ± {slopes['total_half']:.1f} %/V.", ""]
    return "\n".join(lines)


def lags(found: Sequence[Lag], vehicle: Vehicle) -> str:
    """Motor lag beside that of the vehicle file."""
    lines = ["## arp_sysid", "", f"Motor lag; the vehicle file has {vehicle.thrust_lag_rate:.1f} 1/s.", ""]
    lines += ["| log | rate 1/s | spinning up | spinning down | fit |", "|---|---|---|---|---|"]
    for x in found:
        lines.append(f"| {x.log} | {x.rate:.1f} | {x.up:.1f} | {x.down:.1f} | {x.fit:.0f} % |")
    return "\n".join([*lines, ""])


def streams(
    title: str, names: Sequence[str], poses: Sequence[PoseAlignment], late: Sequence[Estimate]
) -> str:
    """How the streams of each flight agree in time, and where the tracked point is."""
    lines = [f"## {title}", "", "| flight | attitude late ms | commands late ms | tracked point above mm |"]
    lines += ["|---|---|---|---|"]
    for name, pose, commands in zip(names, poses, late):
        estimates = (pose.delay, commands, pose.height)
        cells = [f"{1e3 * x.value:.0f} ± {1e3 * x.half_width:.0f}" for x in estimates]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def lean(found: Lean) -> str:
    """What the onboard estimate misses in proportion to the speed."""
    cells = [f"{1e3 * value:.0f} ± {1e3 * half:.0f} mrad" for value, half in (found.roll, found.pitch)]
    return (
        f"Onboard estimate less motion capture, per 1 m/s, {found.flights} flights: "
        f"roll {cells[0]} by the speed to the left, pitch {cells[1]} by the forward speed.\n"
    )


def loops(found: Sequence[Loop], tilts: Sequence[Tilt], vehicle: Vehicle) -> str:
    """Attitude loops and tilted motion capture, flight by flight."""
    tau = vehicle.attitude_time_constant
    lines = ["## attitude", "", "| flight | axis | k | tau s | delay s | fit | "]
    lines[-1] += f"fit with tau {tau:.3f}, no delay |"
    lines += ["|---|---|---|---|---|---|---|"]
    for x in found:
        lines.append(
            f"| {x.flight} | {x.axis} | {x.gain:.2f} | {x.time_constant:.3f} | {x.delay:.3f} | "
            f"{x.fit:.0f} % | {x.nominal_fit:.0f} % |"
        )
    lines += ["", "| flight | roll, pitch on the floor | roll, pitch from the flight | drag x, y 1/s |"]
    lines += ["|---|---|---|---|"]
    for t in tilts:
        rest = "not on record" if t.rest is None else f"{t.rest[0]:.3f}, {t.rest[1]:.3f} rad"
        flown, drag = t.flown, t.drag
        lines.append(
            f"| {t.flight} | {rest} | {flown[0]:.3f}, {flown[1]:.3f} rad | {drag[0]:.2f}, {drag[1]:.2f} |"
        )
    return "\n".join([*lines, ""])
