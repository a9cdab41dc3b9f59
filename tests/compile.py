"""Compile what most tests call, in two processes, before their workers start and each of them would do it.

python -m tests.compile
"""

import multiprocessing
import sys
import tempfile
from pathlib import Path

import numpy as np


def training() -> None:
    """One step of every kind of plant, then a tiny training."""
    from inclined_landing.models.plants import PLANTS, make_plant
    from inclined_landing.train import cli

    for kind in PLANTS:
        plant = make_plant(kind, 3)
        plant.reset(np.arange(3), plant.state.copy())
        plant.step(np.zeros((3, 4)))
    with tempfile.TemporaryDirectory() as folder:
        size = "--environments 4 --rollout 32 --batch-size 64 --steps 256 --threads 1 --no-report"
        cli.main(["landing", *size.split(), "--out", str(Path(folder) / "run")])


def flights() -> None:
    """A flight of the independent simulator, then the diagnosis of one."""
    from tests.eval.gap import test_diagnosis
    from tests.validation.simulator import control, flight
    from tests.validation.simulator.vehicle import World

    path = np.zeros((10, control.REF_SIZE))
    path[:, control.REF_POSITION + 2] = 1.0
    flight.fly(path, World(), np.random.default_rng(0), warm_up=0.1)
    test_diagnosis.quick(test_diagnosis.flights(count=2, seconds=4.0))


if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=part) for part in (training, flights)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    sys.exit(max(process.exitcode or 0 for process in processes))
