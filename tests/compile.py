"""Compile what most tests call, once, before their workers start and each of them would do it.

python -m tests.compile
"""

import tempfile
from pathlib import Path

import numpy as np

from inclined_landing.models.plants import PLANTS, make_plant
from inclined_landing.train import cli
from tests.proof.simulator import control, flight
from tests.proof.simulator.vehicle import World


def main() -> None:
    """One step of every kind of plant, one flight of the independent simulator, one tiny training."""
    for kind in PLANTS:
        for n in (1, 3):  # arrays of one vehicle have another layout
            plant = make_plant(kind, n)
            plant.reset(np.arange(n), plant.state.copy())
            plant.step(np.zeros((n, 4)))
    path = np.zeros((10, control.REF_SIZE))
    path[:, control.REF_POSITION + 2] = 1.0
    flight.fly(path, World(), np.random.default_rng(0), warm_up=0.1)
    with tempfile.TemporaryDirectory() as folder:
        size = "--environments 4 --rollout 32 --batch-size 64 --steps 256 --threads 1 --no-report"
        cli.main(["landing", *size.split(), "--out", str(Path(folder) / "run")])


if __name__ == "__main__":
    main()
