"""Table, figures and page of known causes in real flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base import style
from inclined_landing.eval.base.page import embedded, png, render
from inclined_landing.models import storage

BARS = {
    "sure": ("known causes of medium size or more, named sure", 0.80),
    "possible": ("the same, among the possible", 0.95),
    "wrong": ("sure names that are wrong", 0.05),
    "interval": ("told sizes within the 95 % interval", 0.85),
    "nothing": ("nothing changed, but a sure name", 0.10),
    "unknown": ("causes outside the library that are flagged", 1.0),
}
HEADER = (
    *(
        "set",
        "told",
        "flights",
        "verdict",
        "sure",
        "possible",
        "told size",
        "found",
        "rough",
        "error after 1 s, cm",
    ),
    *("tuning", "sparse regression"),
)


def summary(results: Sequence[dict]) -> dict[str, tuple[int, int]]:
    """Return the counts of `BARS`: how many, and of how many."""
    answered = [r for r in results if "error" not in r]
    causes = [r for r in answered if r["kind"] == "cause"]
    clear = [r for r in causes if r["strength"] != "weak"]
    told = [r for r in causes if r["told"]]
    nothing = [r for r in answered if r["kind"] == "nothing"]
    outside = [r for r in answered if r["kind"] == "unknown"]
    return {
        "sure": (sum(r["right sure"] for r in clear), len(clear)),
        "possible": (sum(r["right possible"] for r in clear), len(clear)),
        "wrong": (sum(len(r["wrong"]) for r in answered), sum(r["sure names"] for r in answered)),
        "interval": (sum(_holds(r) for r in told), len(told)),
        "nothing": (sum(bool(r["sure names"]) for r in nothing), len(nothing)),
        "unknown": (sum(r["flagged"] for r in outside), len(outside)),
    }


def _holds(r: dict) -> bool:
    """Return whether interval and told size, with what it is uncertain by, overlap."""
    if r["found"] is None:
        return False
    low, high = r["found"]["ci95"]
    return low - r["told"]["tolerance"] <= r["told"]["value"] <= high + r["told"]["tolerance"]


def summary_text(results: Sequence[dict]) -> str:
    """Return the counts beside their bars, a line each."""
    lines = []
    for key, (count, of) in summary(results).items():
        words, bar = BARS[key]
        sign = "at most" if key in ("wrong", "nothing") else "at least"
        share = f"{100 * count / of:.0f} %" if of else "none"
        lines.append(f"{words}: {count}/{of} ({share}; {sign} {100 * bar:.0f} %)")
    return "\n".join(lines)


def line(r: dict) -> str:
    """Return a row as a line of progress."""
    if "error" in r:
        return f"{r['set']}: {r['name']}: {r['error']}"
    return f"{r['set']}: {r['name']}: {', '.join(_names(r, True)) or r['verdict']} ({r['seconds']:.0f} s)"


def _names(r: dict, sure: bool) -> list[str]:
    if sure:
        return [_sized(e) for e in r["named"] if e["sure"]]
    named = [f"{_sized(e)}" for e in r["named"] if not e["sure"]]
    return named + [name for name in r["possible"]]


def _sized(e: dict) -> str:
    numbers = ", ".join(
        f"{p['value']:.3g} [{p['ci95'][0]:.3g}, {p['ci95'][1]:.3g}]" for p in e["parameters"].values()
    )
    return f"{e['name']} {numbers}"


def cells(results: Sequence[dict]) -> list[list[str]]:
    """Return the table's lines as text."""
    lines = []
    for r in results:
        if "error" in r:
            lines.append([r["set"], r["name"], "", "not read: " + r["error"], *[""] * 8])
            continue
        told = f"{r['told']['of']} {r['told']['value']:g}" if r["told"] else ""
        found = ""
        if r["found"]:
            low, high = r["found"]["ci95"]
            found = f"{r['found']['value']:.3g} [{low:.3g}, {high:.3g}]"
        error = "" if r["before"] is None else f"{100 * r['before']:.0f} to {100 * r['after']:.0f}"
        verdict = r["verdict"] + (
            f"; inconsistent: {', '.join(r['inconsistent'])}" if r["inconsistent"] else ""
        )
        others = [_baseline(r["baselines"].get(method)) for method in ("tuning", "sparse")]
        sure, possible = "; ".join(_names(r, True)), ", ".join(_names(r, False))
        flights = f"{r['flights'][0]} and {r['flights'][1]}"
        rough = "" if r["rough"] is None else f"{r['rough']:.3g}"
        lines.append(
            [r["set"], r["name"], flights, verdict, sure, possible, told, found, rough, error, *others]
        )
    return lines


def _baseline(one: dict | None) -> str:
    if one is None:
        return ""
    return f"{'right' if one['right'] else 'missed'}, {one['wrong']} wrong"


def markdown(results: Sequence[dict]) -> str:
    """Return the table and the counts."""
    rows = ["| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER)]
    rows += ["| " + " | ".join(row) + " |" for row in cells(results)]
    return summary_text(results) + "\n\n" + "\n".join(rows) + "\n"


def draw(results: Sequence[dict]) -> Figure:
    """Draw identified over documented sizes: thrust, wind, and the loss of a cut propeller."""
    good = [r for r in results if "error" not in r and r["found"]]
    with style.styled():
        figure = Figure(figsize=(9.6, 3.5), layout="constrained")
        thrust, wind, dose = figure.subplots(1, 3)
        _told_against_found(thrust, [r for r in good if r["told"] and r["told"]["of"] == "thrust"])
        thrust.set(
            xlabel="documented thrust/mass, relative [1]", ylabel="identified thrust/mass, relative [1]"
        )
        _told_against_found(wind, [r for r in good if r["told"] and r["told"]["of"] == "wind"])
        wind.set(xlabel="documented wind [m/s]", ylabel="identified wind [m/s]")
        cut = [r for r in results if "error" not in r and r["dose"] is not None]
        for r in cut:
            size = r["found"]
            if size:
                low, high = size["ci95"]
                ends = [[size["value"] - low], [high - size["value"]]]
                dose.errorbar(
                    r["dose"], size["value"], yerr=ends, fmt="o", color=style.colour(0), ms=5, lw=1.2
                )
            else:
                dose.plot(r["dose"], 0.0, "o", mfc="none", color=style.colour(1), ms=5)
        dose.set(xlabel="length cut off propeller M3 [mm]", ylabel="identified thrust loss of rotor M3 [1]")
        dose.plot([], [], "o", color=style.colour(0), label="named")
        dose.plot([], [], "o", mfc="none", color=style.colour(1), label="not named")
        dose.legend(frameon=False, loc="upper left")
    return figure


def _told_against_found(axes, rows: Sequence[dict]) -> None:
    sets = list(dict.fromkeys(r["set"] for r in rows))
    for r in rows:
        low, high = r["found"]["ci95"]
        value, k = r["found"]["value"], sets.index(r["set"])
        axes.errorbar(
            r["told"]["value"],
            value,
            yerr=[[value - low], [high - value]],
            fmt=style.marker(k),
            ms=6,
            lw=1.4,
            color=style.colour(k),
        )
    for k, name in enumerate(sets):
        axes.plot([], [], style.marker(k), color=style.colour(k), label=name)
    if rows:
        span = np.array([min(r["told"]["value"] for r in rows), max(r["told"]["value"] for r in rows)])
        span = span + np.ptp(span) * np.array([-0.12, 0.12]) + np.array([-1e-3, 1e-3])
        axes.plot(span, span, color="0.6", lw=1, zorder=0)
        axes.legend(frameon=False, loc="upper left")


def write(out: Path, results: Sequence[dict]) -> None:
    """Write table.md, causes.json, causes.png and report.html into a folder."""
    figure = draw(results)
    storage.write_text(out / "table.md", markdown(results))
    storage.write_text(
        out / "causes.json", storage.to_json({"rows": list(results), "summary": summary(results)})
    )
    style.save_figure(figure, out / "causes.png")
    page = render(
        __package__,
        "report.html.j2",
        title="Known causes in real flights",
        header=list(HEADER),
        lines=cells(results),
        summary=summary_text(results).splitlines(),
        figure=embedded(png(figure)),
        versions=runs.versions(),
    )
    storage.write_text(out / "report.html", page)
