"""The loop that flies policies under conditions, and the output of a study: tables, figures, page.

A study is a set of conditions. Its module flies every policy under each (`fly_all`), counts, and returns a
`Study`: numbers, a row for each flight, sections with tables, and figures.
"""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.progress import Progress

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.shared.tables import count_words, printer
from inclined_landing.eval.base.claims import Section, show_sections
from inclined_landing.eval.policies.tables import Panel, Row, outcomes_table
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

LONG = 60.0  # s of work, from which it says how long it takes, and every result as it comes
SHORT = 10.0  # s of a first case, much of which may be compiling: the estimate is made from the second

Key = tuple[str, str]  # names of a policy and a condition
Work = Mapping[Key, Callable[[], pd.DataFrame]]


def named_policies(texts: Sequence[str]) -> dict[str, str]:
    """Return policies by name, from arguments of the command line: POLICY or LABEL=POLICY.

    A POLICY is a file, a shipped policy or a run folder; files of the same name are distinguished by their
    folders. Raises UserError if two have the same name.
    """
    labelled = ["=" in text and not os.path.exists(text) for text in texts]
    words = [text.partition("=")[::2] if split else ("", text) for text, split in zip(texts, labelled)]
    files = [Path(policy).name.removesuffix(".zip") for _, policy in words]
    found: dict[str, str] = {}
    for (label, policy), file in zip(words, files):
        folder = Path(policy).parent.name
        name = label or (f"{folder}/{file}" if files.count(file) > 1 and folder else file)
        if not (policy and name.isprintable()):
            raise UserError(
                f"a policy must be POLICY or LABEL=POLICY, not {shown(label + '=' + policy, 60)!r}"
            )
        if name in found:
            raise UserError(f"policy {shown(name, 100)} is named twice")
        found[name] = policy
    return found


def fly_all(work: Work) -> dict[Key, pd.DataFrame]:
    """Return the flights of each policy under each condition, a row each; progress is shown on stderr.

    Raises UserError, with the names of policy and condition, where the simulation diverges.
    """
    console = printer(Console(stderr=True, markup=False, highlight=False))
    found: dict[Key, pd.DataFrame] = {}
    began, lines, long, untimed = time.monotonic(), list[str](), False, 0
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("flying", total=len(work))
        for (policy, condition), fly in work.items():
            try:
                flights = found[policy, condition] = fly()
            except FloatingPointError as error:
                raise UserError(f"{policy}, {condition}: {error}") from error
            progress.advance(bar)
            lines.append(f"{condition}, {policy}: {_short(flights)}")
            now = time.monotonic()
            if len(found) == 1 and now - began < SHORT:
                began, untimed = now, 1
                continue
            expected = (now - began) / (len(found) - untimed) * len(work)
            if not long and expected > LONG and len(found) < len(work):
                long = True
                progress.console.print(f"{len(work)} x {len(flights)} flights: about {expected / 60:.0f} min")
            if long:
                progress.console.print("\n".join(lines), soft_wrap=True)
                lines.clear()
    return found


def _short(flights: pd.DataFrame) -> str:
    """Return in words how many flights met the criterion that is counted."""
    counted = next(name for name in ("at_rest", "within", "strict") if name in flights)
    names = {"at_rest": "at rest", "within": "within 5 cm"}
    what = f"flights {names[counted]}" if counted in names else "flights"
    return count_words(proportion(flights[counted].sum(), len(flights)), what)


def joined(flown: Mapping[Key, pd.DataFrame]) -> pd.DataFrame:
    """Return all flights in one table, `policy` and `condition` in front; truth values are 0 and 1."""
    tables = []
    for (policy, condition), flights in flown.items():
        flags = dict.fromkeys(flights.select_dtypes(bool).columns, int)
        tables.append(flights.astype(flags))
        tables[-1].insert(0, "policy", policy)
        tables[-1].insert(1, "condition", condition)
    return pd.concat(tables, ignore_index=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """The results of policies under the conditions of a study."""

    name: str  # of its JSON file and its figure
    title: str
    report: dict[str, Any]  # plain numbers
    flights: pd.DataFrame  # of `joined`
    heads: Sequence[str]  # of the labels of `rows`
    rows: Sequence[Row]  # of the table
    panels: Sequence[Panel]  # of the figure
    share: str = "successful landings"  # what the figure shows the share of
    remarks: Sequence[str]  # under the table: what is counted, and what came out

    @property
    def section(self) -> Section:
        """Return the section of the page."""
        table = outcomes_table(self.heads, self.rows)
        figure = {self.name: f"Share of {self.share}, with 95 % intervals."}
        return Section(self.name, self.title, [], [], [table], figure, list(self.remarks))

    def show(self) -> None:
        """Print the table and the results."""
        show_sections([self.section])


def write_studies(folder: Path, studies: Sequence[Study]) -> None:
    """Write numbers, flights, figures and one page of all studies into a folder."""
    # Here, because most commands that fly policies draw nothing.
    from inclined_landing.eval.base.page import embedded, png, render
    from inclined_landing.eval.base.style import save_figure
    from inclined_landing.eval.policies.panels import draw_panels

    images = {}
    for study in studies:
        storage.write_json(folder / f"{study.name}.json", study.report)
        figure = draw_panels(study.panels, study.share)
        save_figure(figure, folder / f"{study.name}.png")
        save_figure(figure, folder / f"{study.name}.pdf")
        images[study.name] = embedded(png(figure))
    flights = pd.concat([study.flights.assign(study=study.name) for study in studies])
    storage.write_text(folder / "flights.csv", csv(flights))
    page = render(
        __package__,
        "studies.html.j2",
        title="Policies under changed conditions",
        sections=[study.section for study in studies],
        images=images,
        run=shlex.join(["landing-eval", *sys.argv[1:]]),
        versions=studies[0].report["versions"],
    )
    storage.write_text(folder / "index.html", page)


def csv(flights: pd.DataFrame) -> str:
    """Return a table of flights as CSV."""
    return flights.to_csv(index=False, float_format="%.6g")
