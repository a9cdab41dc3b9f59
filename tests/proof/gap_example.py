"""`gap-example`: the flights that `landing-eval gap-example` copies, made anew."""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.eval.gap.gap_example import introduce
from tests.proof.gap_blind.causes import Drawn
from tests.proof.gap_blind.generate import fly_all, write_csv

# Worn propellers, a vehicle that is not streamlined, and a floor nobody modelled.
HIDDEN = Drawn(
    world={"thrust_scale": 0.9, "drag_scale": 3.0, "ground_effect": 5.0},
    parameters={"thrust_scale": 0.9, "rotor_drag": 3.0, "ground_effect": 5.0},
)
SETS = {"fit": 10, "heldout": 10}  # every kind of ordinary flight once in each


def command(out: Folder, seed: Seed = 0) -> None:
    """Twenty flights with hidden effects, of an independent simulator, to try gap.

    Args:
        out: new folder for fit/*.csv and heldout/*.csv.
        seed: of paths and noise.
    """
    with runs.staged_run(out) as folder:
        for k, (name, count) in enumerate(SETS.items()):
            (folder / name).mkdir()
            recordings = fly_all(HIDDEN, np.random.default_rng((seed, k)), count=count)
            for j, recording in enumerate(recordings):
                write_csv(recording, folder / name / f"{name}_{j + 1:02d}.csv")
    introduce(out)
