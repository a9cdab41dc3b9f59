"""`causes`: known causes in real flights of five laboratories against what the gap workflow names."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from inclined_landing.eval.base import style
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError

from ..shared import in_processes
from . import page
from .rows import Row, answer, known_rows


def command(
    data: tyro.conf.Positional[Path],
    /,
    out: Path,
    *,
    half: Literal["development", "heldout", "fresh", "all"] = "development",
    only: tuple[str, ...] = (),
    processes: Annotated[int, tyro.conf.arg(metavar="INT")] = 2,
) -> None:
    """Known causes in real flights of five laboratories: is the right one named, and how large (minutes)?

    Args:
        data: folder with the clones of the five repositories (`tests.validation.flights` says which).
        out: folder for table.md, causes.json, and figures; rows that are in it are kept.
        half: flights that the workflow was looked at with, those that were held out, or those that came last.
        only: names of repositories.
        processes: rows at a time.
    """
    rows = [r for r in known_rows() if half in (r.half, "all") and (not only or r.set in only)]
    if not rows:
        known = sorted({r.set for r in known_rows()})
        raise UserError(f"no rows; --only takes {', '.join(known)}, and not all have every half")
    if not 1 <= processes <= 64:
        raise UserError(f"--processes must lie from 1 to 64, not {processes}")
    if not data.is_dir():
        raise UserError(f"{data}: no folder; it must hold the clones of the repositories")
    folder = out / "rows"
    style.make_folder(folder)
    missing = [r for r in rows if not (folder / f"{r.key}.json").exists()]
    for (_, row), result in in_processes(_row, [(data, row) for row in missing], processes):
        storage.write_text(folder / f"{row.key}.json", storage.to_json(result))
        print(page.line(result), file=sys.stderr, flush=True)
    results = [json.loads((folder / f"{r.key}.json").read_text("utf-8")) for r in rows]
    page.write(out, results)
    print(page.summary_text(results))


def _row(data: Path, row: Row) -> dict:
    """Return the answer to a row, or why there is none."""
    try:
        return answer(data, row)
    except UserError as error:
        return {"set": row.set, "name": row.name, "kind": row.kind, "half": row.half, "error": str(error)}
