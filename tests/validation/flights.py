"""`flights`: sources of public flights, and their files as documented CSV."""

from __future__ import annotations

import gzip
import hashlib
import io
import sys
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import NewFolder
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from tests.validation.convert import PublicSet, convert, public_sets

PROGRAM = "python -m tests.validation flights"
SetAndFiles = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SET [FILE ...]]")]


def command(public: SetAndFiles = (), /, *, out: NewFolder = None) -> None:
    """List public sets of measured flights with their licences, or convert one to documented CSV.

    Args:
        public: name of a set, and unmodified files of its repository.
        out: new folder for the converted flights, one .csv.gz each, and source.txt.
    """
    sets = public_sets()
    if not public:
        print("\n\n".join(_where(key, known) for key, known in sets.items()))
        print(f"\n{len(sets)} sets of measured flights are available: {', '.join(sets)}.")
        return
    name, *files = public
    if name not in sets:
        raise UserError(f"unknown set {shown(name)!r}; choose from {', '.join(sets)}")
    if not files:
        print(_where(name, sets[name]))
        return
    if out is None:
        raise UserError("give a new folder for the converted flights with --out DIR")
    seen: dict[str, str] = {}
    with runs.staged_run(out) as folder:
        for file in files:
            flight, table, notes = convert(name, Path(file))
            text = table.to_csv(index=False, lineterminator="\n").encode()
            key = hashlib.sha256(text).hexdigest()
            if key in seen:
                print(f"{shown(file, 250)}: the same flight as {seen[key]}, skipped", file=sys.stderr)
                continue
            if (folder / f"{flight}.csv.gz").exists():
                raise UserError(f"{shown(file, 250)}: two files contain the flight {flight}")
            seen[key] = file
            storage.write_bytes(folder / f"{flight}.csv.gz", _packed(text))
            for note in notes:
                print(f"{shown(file, 250)}: {note}", file=sys.stderr)
        storage.write_text(folder / "source.txt", _where(name, sets[name]) + "\n")
    print(f"{len(seen)} flights were converted into {out}.")


def _packed(text: bytes) -> bytes:
    """Return gzipped bytes, always the same for the same text."""
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", mtime=0) as file:
        file.write(text)
    return packed.getvalue()


def _where(name: str, known: PublicSet) -> str:
    folder = known.repository.rsplit("/", 1)[1]
    return "\n".join(
        (
            known.title,
            f"  git clone {known.repository} && git -C {folder} checkout {known.commit[:7]}",
            f"  {PROGRAM} {name} {folder}/{known.files} --out {name}",
            f"  licence: {known.licence}",
            f"  cite: {known.cite}",
        )
    )
