"""Table and figures of known causes in real flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from inclined_landing.eval.base import style
from inclined_landing.models import storage

from ..shared import table

BARS = {
    "sure": ("known causes of medium size or more, named sure", 0.80),
    "possible": ("the same, among the possible", 0.95),
    "wrong": ("sure names that are wrong", 0.05),
    "interval": ("told sizes within the 95 % interval", 0.85),
    "nothing": ("nothing changed, but a sure name", 0.10),
    "unknown": ("causes outside the library that are flagged", 1.0),
}
HEADER = (
    *("set", "told", "flights", "verdict", "sure", "possible", "told size", "found", "rough"),
    *("error after 1 s, cm", "tuning"),
)


def summary(results: Sequence[dict]) -> dict[str, tuple[int, int]]:
    """Return the counts of `BARS`: how many, and of how many."""
    answered = [r for r in results if "error" not in r and r["kind"] != "dose"]
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
    lines += [_unknown_counts(results), _errors(results), _tuning_counts(results)]
    return "\n".join(lines)


def _unknown_counts(results: Sequence[dict]) -> str:
    """Return how often the verdict is `unknown` where the library has the cause, or nothing was changed."""
    known = [r for r in results if "error" not in r and r["kind"] in ("cause", "nothing")]
    counts = [
        f"{sum(r['verdict'] == 'unknown' for r in rows)}/{len(rows)} {words}"
        for words, rows in (
            ("known causes", [r for r in known if r["kind"] == "cause"]),
            ("rows with nothing changed", [r for r in known if r["kind"] == "nothing"]),
        )
    ]
    return f"called unknown as well: {', '.join(counts)}"


def _errors(results: Sequence[dict]) -> str:
    """Return the median error one second ahead, before and after, where a right name is sure."""
    rows = [r for r in results if "error" not in r and r["kind"] == "cause" and r["right sure"]]
    ends = [[r[when] for r in rows if r[when] is not None] for when in ("before", "after")]
    before, after = (f"{100 * np.median(one):.0f}" if one else "-" for one in ends)
    return f"error one second ahead where a right name is sure, median: {before} to {after} cm"


def _tuning_counts(results: Sequence[dict]) -> str:
    """Return on how many causes of medium size or more tuning has a right name, and its wrong names."""
    rows = [(r, r["tuning"]) for r in results if r.get("tuning")]
    clear = [one for r, one in rows if r["kind"] == "cause" and r["strength"] != "weak"]
    right, names = sum(one["right"] for one in clear), sum(len(one["names"]) for _, one in rows)
    wrong = sum(one["wrong"] for _, one in rows)
    counted = f"right among its names {right}/{len(clear)}; {wrong} of its {names} names are wrong"
    return f"parameter tuning: {counted}"


def line(r: dict) -> str:
    """Return a row as a line of progress."""
    if "error" in r:
        return f"{r['set']}: {r['name']}: {r['error']}"
    if r["kind"] == "dose":
        return f"{r['set']}: {r['name']}: {r['parameter']} {_found(r)}"
    return f"{r['set']}: {r['name']}: {', '.join(_names(r, True)) or r['verdict']} ({r['seconds']:.0f} s)"


def _found(r: dict) -> str:
    """Return what was found of a told size or dose, with its interval."""
    if not r["found"]:
        return ""
    low, high = r["found"]["ci95"]
    return f"{r['found']['value']:.3g} [{low:.3g}, {high:.3g}]"


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
            lines.append([r["set"], r["name"], "", "not read: " + r["error"], *[""] * 7])
            continue
        if r["kind"] == "dose":
            told = f"{r['parameter']} at {r['dose']:g}"
            lines.append([r["set"], r["name"], str(r["flights"][0]), *[""] * 3, told, _found(r), *[""] * 3])
            continue
        told = f"{r['told']['of']} {r['told']['value']:g}" if r["told"] else ""
        error = "" if r["before"] is None else f"{100 * r['before']:.0f} to {100 * r['after']:.0f}"
        verdict = r["verdict"] + (
            f"; inconsistent: {', '.join(r['inconsistent'])}" if r["inconsistent"] else ""
        )
        one = r["tuning"]
        tuning = f"{'right' if one['right'] else 'missed'}, {one['wrong']} wrong" if one else ""
        sure, possible = "; ".join(_names(r, True)), ", ".join(_names(r, False))
        flights = f"{r['flights'][0]} and {r['flights'][1]}"
        rough = "" if r["rough"] is None else f"{r['rough']:.3g}"
        lines.append(
            [r["set"], r["name"], flights, verdict, sure, possible, told, _found(r), rough, error, tuning]
        )
    return lines


def markdown(results: Sequence[dict]) -> str:
    """Return the table and the counts."""
    return summary_text(results) + "\n\n" + table(HEADER, cells(results))


def draw(results: Sequence[dict]) -> Figure:
    """Draw identified over documented sizes: thrust, wind, and the loss of a cut propeller."""
    results = [r for r in results if "error" not in r and r["kind"] != "dose"]
    told = [r for r in results if r["found"] and r["told"]]
    with style.styled():
        figure = Figure(figsize=(9.6, 3.5), layout="constrained")
        thrust, wind, cut = figure.subplots(1, 3)
        _told_against_found(thrust, [r for r in told if r["told"]["of"] == "thrust"])
        thrust.set_title("Thrust / mass, relative", loc="left")
        thrust.set(xlabel="documented", ylabel="identified")
        _told_against_found(wind, [r for r in told if r["told"]["of"] == "wind"])
        wind.set_title("Wind", loc="left")
        wind.set(xlabel="documented [m/s]", ylabel="identified [m/s]")
        for r in (r for r in results if r["dose"] is not None):
            if r["found"]:
                _with_interval(cut, r["dose"], r["found"])
            else:
                cut.plot(r["dose"], 0.0, "o", mfc="none", color=style.colour(1), ms=5)
        cut.set_title("Shortened propeller M3", loc="left")
        cut.set(xlabel="length cut off [mm]", ylabel="identified share of thrust lost")
        cut.plot([], [], "o", color=style.colour(0), label="named")
        cut.plot([], [], "o", mfc="none", color=style.colour(1), label="not named")
        cut.legend(frameon=False, loc="lower right")
    return figure


def draw_gains(results: Sequence[dict]) -> Figure:
    """Draw the identified gain of the attitude loop against the gain that was set."""
    with style.styled():
        figure = Figure(figsize=(4.2, 3.2), layout="constrained")
        axes = figure.subplots()
        for r in results:
            if r["kind"] == "dose" and "error" not in r:
                _with_interval(axes, r["dose"], r["found"])
        axes.set(xlabel="documented gain KR [N m/rad]", ylabel="identified gain / model gain")
    return figure


def _with_interval(axes, at: float, size: dict, marker: str = "o", colour: int = 0, **look) -> None:
    """Draw a value and its 95 % interval."""
    low, high = size["ci95"]
    ends = [[size["value"] - low], [high - size["value"]]]
    axes.errorbar(at, size["value"], yerr=ends, fmt=marker, color=style.colour(colour), ms=5, lw=1.3, **look)


def _told_against_found(axes, rows: Sequence[dict]) -> None:
    sets = list(dict.fromkeys(r["set"] for r in rows))
    for r in rows:
        k = sets.index(r["set"])
        hollow = {"mfc": "none"} if r["kind"] == "unknown" else {}
        _with_interval(axes, r["told"]["value"], r["found"], style.marker(k), k, **hollow)
    for k, name in enumerate(sets):
        axes.plot([], [], style.marker(k), color=style.colour(k), label=name)
    if rows:
        span = np.array([min(r["told"]["value"] for r in rows), max(r["told"]["value"] for r in rows)])
        span = span + np.ptp(span) * np.array([-0.12, 0.12]) + np.array([-1e-3, 1e-3])
        axes.plot(span, span, color="0.6", lw=1, zorder=0)
        axes.legend(frameon=False, loc="upper left")


def write(out: Path, results: Sequence[dict]) -> None:
    """Write table.md, causes.json, causes.png and gains.png into a folder."""
    figure, gains = draw(results), draw_gains(results)
    storage.write_text(out / "table.md", markdown(results))
    storage.write_text(
        out / "causes.json", storage.to_json({"rows": list(results), "summary": summary(results)})
    )
    style.save_figure(figure, out / "causes.png")
    style.save_figure(gains, out / "gains.png")
