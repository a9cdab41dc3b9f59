"""`landing-eval gap-example`: twenty flights that come with the package, to try the gap workflow on.

`python -m tests.validation gap-example`, in the repository, made them with an independent simulator.
"""

from __future__ import annotations

import tomllib
import zipfile
from importlib import resources
from pathlib import Path

from inclined_landing.eval.base.options import RunFolder

HIDDEN = """# What is hidden in these flights: landing-eval gap should name these effects, with these sizes.
thrust_scale = { scale = 0.9 }  # worn propellers
rotor_drag = { lateral = 3.0, axial = 3.0 }  # a vehicle that is not streamlined
ground_effect = { strength = 5.0 }  # a floor that the model lacks
"""


def command(out: RunFolder) -> None:
    """Write twenty example flights with hidden effects, as input for gap.

    Args:
        out: new folder for fit/*.csv, heldout/*.csv, hidden.toml, which lists the hidden effects, and
            truth.toml, the vehicle with them, to test policies on.
    """
    from inclined_landing.envs.shared import runs

    flights = resources.files(__package__).joinpath("example_flights.zip")
    with runs.staged_run(out) as folder, flights.open("rb") as file, zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
        write_hidden(folder)
    introduce(out)


def write_hidden(folder: Path) -> None:
    """Write what is hidden in the flights: its names and sizes, and the true vehicle."""
    from inclined_landing.models.base import storage
    from inclined_landing.models.effects import apply
    from inclined_landing.models.parameters import load_vehicle, write_vehicle

    storage.write_text(folder / "hidden.toml", HIDDEN)
    write_vehicle(folder / "truth.toml", apply(load_vehicle(), tomllib.loads(HIDDEN)))


def introduce(out: Path) -> None:
    """Print what the flights in a folder are, and the command that is given them."""
    from inclined_landing.envs.shared.tables import say

    command = f"landing-eval gap {out}/fit/*.csv --heldout {out}/heldout/*.csv --out {out}/report"
    print(f"To name the effects that the model lacks: {command}")
    say(
        f"{out} contains twenty flights with hidden effects; those in its folder heldout are to be held out. "
        f"{out / 'hidden.toml'} lists the hidden effects; read it afterwards. "
        f"{out / 'truth.toml'} is the true vehicle, to test policies on."
    )
