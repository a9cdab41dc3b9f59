"""`gap-example`: the flights that `landing-eval gap-example` copies, made anew."""

from __future__ import annotations

import tomllib

import numpy as np

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.eval.gap.gap_example import HIDDEN, introduce, write_hidden
from tests.validation.gap_blind.causes import Drawn
from tests.validation.gap_blind.generate import fly_all, write_csv

_NUMBERS = {name: next(iter(values.values())) for name, values in tomllib.loads(HIDDEN).items()}
DRAWN = Drawn(
    world={{"rotor_drag": "drag_scale"}.get(name, name): size for name, size in _NUMBERS.items()},
    parameters=_NUMBERS,
)
SETS = {"fit": 10, "heldout": 10}  # every kind of ordinary flight once in each


def command(out: Folder, seed: Seed = 0) -> None:
    """Write twenty flights with hidden effects, from an independent simulator.

    Args:
        out: new folder for fit/*.csv, heldout/*.csv, hidden.toml and truth.toml.
        seed: of paths and noise.
    """
    with runs.staged_run(out) as folder:
        for k, (name, count) in enumerate(SETS.items()):
            (folder / name).mkdir()
            recordings = fly_all(DRAWN, np.random.default_rng((seed, k)), count=count)
            for j, recording in enumerate(recordings):
                write_csv(recording, folder / name / f"{name}_{j + 1:02d}.csv")
        write_hidden(folder)
    introduce(out)
