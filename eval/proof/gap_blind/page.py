"""The tables of a blind set, as Markdown and as one self-contained HTML page."""

from __future__ import annotations

from inclined_landing.eval.base.page import render

from .score import OUTCOMES

_TITLES = {
    "workflow": "Gap workflow",
    "tuning": "Parameter tuning only",
    "sparse": "Sparse regression of residual accelerations (pysindy)",
}


def markdown(results: dict) -> str:
    """Every method's table, with the set and its seed."""
    head = f"Blind set `{results['set']}`, seed {results['seed']}, {results['cases']} cases\n"
    parts = [head]
    for method, result in results["methods"].items():
        header, lines = cells(result["table"])
        parts.append(f"### {_TITLES[method]}\n")
        parts.append("| " + " | ".join(header) + " |")
        parts.append("|" + "---|" * len(header))
        parts += ["| " + " | ".join(line) + " |" for line in lines]
        parts.append("")
    return "\n".join(parts)


def cells(table: list[dict]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table as text; outcomes that never occur are left out."""
    shown = [name for name in OUTCOMES if any(line[name] for line in table)]
    plants = sorted({plant for line in table for plant in line["closed"]})
    header = [
        "stratum",
        "cases",
        *shown,
        "good [95 %]",
        "right cause found",
        "also flagged",
        "parameter error",
    ]
    header += [f"gap closed, {plant}" for plant in plants] + ["seconds"]
    lines = []
    for line in table:
        row = [line["stratum"], str(line["cases"]), *(str(line[name]) for name in shown)]
        row += [_share(line["good"]), _share(line["first"], interval=False), str(line["also flagged"])]
        row += [_median(line["error"])] + [_median(line["closed"].get(plant)) for plant in plants]
        row += ["" if line["seconds"] is None else f"{line['seconds']:.1f}"]
        lines.append(row)
    return header, lines


def _share(proportion: dict, interval: bool = True) -> str:
    text = f"{100 * proportion['share']:.0f} %"
    if interval:
        text += " [{:.0f}, {:.0f}]".format(*(100 * end for end in proportion["interval"]))
    return text


def _median(value: dict | None) -> str:
    return "" if value is None else f"{100 * value['median']:.1f} %"


def page(results: dict) -> str:
    """One self-contained HTML page: the tables, then every case with label and answer."""
    methods = [
        {"title": _TITLES[name], "table": cells(result["table"]), "cases": result["cases"]}
        for name, result in results["methods"].items()
    ]
    return render(
        __package__,
        "report.html.j2",
        title="Blind test of the gap workflow",
        results=results,
        methods=methods,
        versions=results.get("versions", {}),
    )
