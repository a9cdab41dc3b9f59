"""The tables of a blind set in Markdown, and the figure of its probabilities."""

from __future__ import annotations

from matplotlib.figure import Figure

from inclined_landing.eval.base import style

from ..shared import table
from .score import OUTCOMES

_TITLES = {
    "workflow": "Gap workflow",
    "tuning": "Parameter tuning only",
    "sparse": "Sparse regression of residual accelerations (pysindy)",
}


def markdown(results: dict) -> str:
    """Every method's tables, with the set and its seed."""
    parts = [f"Blind set `{results['set']}`, seed {results['seed']}, {results['cases']} cases\n"]
    for method, result in results["methods"].items():
        parts.append(f"### {_TITLES[method]}\n")
        for header, lines in (cells(result["table"]), family_cells(result["families"])):
            parts.append(table(header, lines))
        if words := calibrated(result["calibration"]):
            parts.append(words + "\n")
    return "\n".join(parts)


def cells(counts: list[dict]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table as text; outcomes that never occur are left out."""
    shown = [name for name in OUTCOMES if any(line[name] for line in counts)]
    plants = sorted({plant for line in counts for plant in line["closed"]})
    header = ["stratum", "cases", *shown, "good [95 %]", "right cause found", "among sure and possible"]
    header += ["sure names wrong", "also flagged", "parameter error"]
    header += ["intervals that hold", *(f"gap closed, {plant}" for plant in plants), "seconds"]
    lines = []
    for line in counts:
        row = [line["stratum"], str(line["cases"]), *(str(line[name]) for name in shown)]
        row += [_share(line["good"]), _share(line["first"], interval=False)]
        row += [_share(line["among"], interval=False), _count(line["sure"]), str(line["also flagged"])]
        row += [_median(line["error"]), _share(line["covered"])]
        row += [_median(line["closed"].get(plant)) for plant in plants]
        row += ["" if line["seconds"] is None else f"{line['seconds']:.1f}"]
        lines.append(row)
    return header, lines


def family_cells(families: list[dict]) -> tuple[list[str], list[list[str]]]:
    """Good cases of every family by stratum, as text."""
    strata = list(dict.fromkeys(name for one in families for name in one["strata"]))
    header = ["family", "all good [95 %]", *strata, "calibration error", "log score"]
    lines = []
    for one in families:
        row = [one["family"], _share(one["all"])]
        row += [_count(one["strata"].get(name)) for name in strata]
        c = one["calibration"]
        row += ["", ""] if c is None else [f"{c['error']:.2f}", f"{c['log score']:.2f}"]
        lines.append(row)
    return header, lines


def calibrated(calibration: dict | None) -> str:
    """How far the probabilities can be believed, in a sentence."""
    if calibration is None:
        return ""
    return (
        f"Probabilities of the likeliest set in {calibration['cases']} cases: expected calibration error "
        f"{calibration['error']:.3f} in ten bins; log score of the truth {calibration['log score']:.2f}."
    )


def _count(proportion: dict | None) -> str:
    return "" if proportion is None else f"{proportion['count']}/{proportion['of']}"


def _share(proportion: dict, interval: bool = True) -> str:
    if proportion["share"] is None:
        return ""
    text = f"{100 * proportion['share']:.0f} %"
    if interval:
        text += " [{:.0f}, {:.0f}]".format(*(100 * end for end in proportion["interval"]))
    return text


def _median(value: dict | None) -> str:
    return "" if value is None else f"{100 * value['median']:.1f} %"


def reliability(results: dict) -> Figure | None:
    """Share of right answers against the probability given to them; None where no method gives any."""
    shown = {name: one["calibration"] for name, one in results["methods"].items() if one["calibration"]}
    if not shown:
        return None
    with style.styled():
        figure = Figure(figsize=(4.6, 4.9), layout="constrained")
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=style.MUTED, lw=1.2, ls=(0, (5, 2)), zorder=1, label="as believed")
        looks = zip((style.BLUE, style.ORANGE, style.GREEN), "os^")
        for (colour, mark), (name, one) in zip(looks, shown.items()):
            x = [b["probability"] for b in one["bins"]]
            y = [b["right"]["share"] for b in one["bins"]]
            low = [max(0.0, s - b["right"]["interval"][0]) for s, b in zip(y, one["bins"])]
            high = [max(0.0, b["right"]["interval"][1] - s) for s, b in zip(y, one["bins"])]
            axes.errorbar(x, y, [low, high], fmt=mark, color=colour, capsize=3, label=_TITLES[name])
            for a, b, c in zip(x, y, one["bins"]):
                axes.annotate(str(c["right"]["of"]), (a, b), (5, -10), textcoords="offset points", fontsize=8)
        axes.set(xlim=(0, 1.02), ylim=(-0.02, 1.02))
        axes.set(xlabel="probability of the likeliest set", ylabel="share of the cases where it is right")
        style.legend_below(axes, ncols=1)
    return figure
