"""The library of effects as tables: `landing-eval effects`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import tyro

from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.effects import LIBRARY, Effect

if TYPE_CHECKING:
    from rich.table import Table


def command(
    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = (), /
) -> None:
    """List the physical effects that a model may lack: formula, size, remedy.

    Args:
        names: effects to show in detail (default: all in one table).
    """
    from inclined_landing.envs.shared.tables import printer, say

    for name in names:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)!r}; {choices(LIBRARY, name)}")
    console = printer()
    if not names:
        console.print(_overview())
        say(f"The library has {len(LIBRARY)} effects; landing-eval effects NAME shows the details of one.")
    for name in names:
        console.print(_sheet(LIBRARY[name]))


def _overview() -> Table:
    """Return a table of all effects."""
    from rich.table import Table

    table = Table(box=None, header_style="bold")
    for title in ("effect", "formula", "a plausible size", "shows in"):
        table.add_column(title, no_wrap=title == "effect", overflow="fold")
    for effect in LIBRARY.values():
        sizes = (f"{p.name} {p.plausible:g} {'' if p.unit == '1' else p.unit}" for p in effect.parameters)
        table.add_row(effect.name, effect.formula, "\n".join(sizes), ", ".join(effect.regimes))
    return table


def _sheet(effect: Effect) -> Table:
    """Return a table of the details of an effect."""
    from rich.table import Table

    table = Table(title=effect.name, title_justify="left", show_header=False, box=None)
    parameters = "\n".join(
        f"{p.name} ({p.unit}): neutral {p.neutral:g}, plausible {p.plausible:g}, from {p.bounds[0]:g} to "
        f"{p.bounds[1]:g}, negligible within {p.negligible:g}"
        for p in effect.parameters
    )
    sheet = {
        "what": effect.description,
        "formula": effect.formula,
        "source": effect.source,
        "parameters": parameters,
        "shows in": ", ".join(effect.regimes),
        "confused with": ", ".join(effect.confused_with),
        "measured otherwise": effect.told_by,
        "identify fits": ", ".join(p.constant.name for p in effect.parameters if p.constant),
        "remedy": effect.remedy,
        "needs in the log": ", ".join(effect.requires),
    }
    for title, text in sheet.items():
        if text:
            table.add_row(title, text)
    return table
