"""`landing-eval benchmark`: the speed of steps, actions and training on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.measures import Measure, median
from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.models.base.errors import UserError

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.envs.sb3 import BatchVecEnv
    from inclined_landing.eval.study.engine import Results

VEHICLES = 256
_PLANTS = {
    "mujoco RK4": ("mujoco", {}),
    "mujoco implicitfast": ("mujoco", {"integrator": "implicitfast"}),
    "hybrid RK4": ("hybrid", {}),
    "hybrid implicitfast": ("hybrid", {"integrator": "implicitfast"}),
    "analytic": ("analytic", {}),
}
_BLOCK, _REPEATS = 15, 10  # control steps that are timed together, and how often
_ACTIONS = 2000  # number of actions that are timed one by one
_TRAINING_STEPS = 100_000


def middle(values: np.ndarray) -> dict[str, Any]:
    """Return the median with the range."""
    found = median(values)
    return found | {"low": found["min"], "high": found["max"]}


RATE, ACTION, TRAINING = (
    Measure(
        name=name,
        title=title,
        statistic=middle,
        unit=unit,
        digits=digits,
        note="median (smallest to largest)",
    )
    for name, title, unit, digits in (
        ("steps_per_second", "steps per second, with task, reward and resets", "1/s", 0),
        ("action_us", "microseconds for an action", "us", 1),
        ("training_steps_per_second", "steps per second of training", "1/s", 0),
    )
)


def command(
    *,
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Measure the speed of steps, actions and training on this machine (about a minute).

    Args:
        seed: seed for actions and training.
        json: print only JSON on standard output.
        out: new folder for benchmark.json and a page.
    """
    import pandas as pd

    from inclined_landing.envs.policy import load_policy
    from inclined_landing.eval.study import engine
    from inclined_landing.eval.study.show import hand_over

    before = os.getloadavg()[0]
    measured = [
        *({"plant": name, RATE.name: x} for name, rates in step_rates(_REPEATS, seed).items() for x in rates),
        *({ACTION.name: x} for x in action_times(load_policy("landing"), _ACTIONS, seed)),
        {TRAINING.name: training_rate(_TRAINING_STEPS, seed)},
    ]
    loads = {"before": before, "after": os.getloadavg()[0]}
    study = engine.Study(
        name="benchmark",
        title=f"Speed on this machine, {VEHICLES} vehicles",
        cases=(),
        views=[
            engine.View(("plant",), (RATE,), "control steps, by plant", across=True),
            engine.View((), (ACTION, TRAINING), "actions and training", across=True),
        ],
        remarks=_remarks,
        series="plant",
        facts=[engine.fact("load of this machine", name, load) for name, load in loads.items()],
    )
    hand_over("benchmark", [engine.count(study, pd.DataFrame(measured))], json=json, out=out)


def step_rates(repeats: int, seed: int) -> dict[str, list[float]]:
    """Return control steps per second of 256 vehicles under random actions, for each plant.

    A step is one of `BatchVecEnv`, including task, reward, resets and episode statistics. The plants are
    measured alternately, so that other load on the machine affects all of them.
    """
    from inclined_landing.envs.batch import BatchEnv
    from inclined_landing.envs.sb3 import BatchVecEnv
    from inclined_landing.envs.tasks import make_task
    from inclined_landing.models.plants import make_plant

    rng = np.random.default_rng(seed)
    task = make_task("landing", pwm_centre="hover")
    environments: dict[str, BatchVecEnv] = {}
    rates: dict[str, list[float]] = {label: [] for label in _PLANTS}
    for label, (kind, options) in _PLANTS.items():
        batch = BatchEnv(task, make_plant(kind, VEHICLES, task.vehicle, **options), seed)
        environments[label] = BatchVecEnv(batch)
        environments[label].reset()
        batch.length[:] = rng.integers(0, task.max_steps, VEHICLES)  # so that resets spread evenly
    for repeat in range(repeats + 2):
        actions = rng.uniform(-1, 1, (_BLOCK, VEHICLES, len(task.action_names)))
        for label, environment in environments.items():
            began = time.perf_counter()
            for action in actions:
                environment.step(action)
            if repeat >= 2:  # the first blocks compile and warm up
                rates[label].append(_BLOCK * VEHICLES / (time.perf_counter() - began))
    return rates


def action_times(policy: Policy, repeats: int, seed: int) -> list[float]:
    """Return the microseconds that a policy takes for each of some actions."""
    rows = np.random.default_rng(seed).normal(size=(repeats + 10, len(policy.centre))).astype(np.float32)
    microseconds = []
    for row in rows:
        began = time.perf_counter()
        policy.predict(row)
        microseconds.append(1e6 * (time.perf_counter() - began))
    return microseconds[10:]


def training_rate(steps: int, seed: int) -> float:
    """Return the steps per second of `landing-train landing`, from its first step to its last update."""
    from inclined_landing.models.base import storage

    with tempfile.TemporaryDirectory() as folder:
        options = ["landing", "--steps", str(steps), "--seed", str(seed), "--out", f"{folder}/run"]
        quiet = ["--no-report", "--evaluate-every", "0"]
        done = subprocess.run(
            [sys.executable, "-P", "-m", "inclined_landing.train", *options, *quiet],
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise UserError(f"landing-train failed: {(done.stderr.strip() or 'no message').splitlines()[-1]}")
        return float(storage.read_json(Path(folder, "run", "metrics.json"), "metrics")["steps_per_second"])


def _remarks(results: Results) -> list[str]:
    machine, first = runs.versions(), next(iter(_PLANTS))
    loads = [f"{row['value']:.1f} {row['name']}" for row in results.study.facts]
    rate, action, training = map(results.one, (RATE, ACTION, TRAINING))
    return [
        f"{machine['cpu']}, {machine['cores']} cores, load {' and '.join(loads)}.",
        f"This machine simulates {rate['value']:,.0f} control steps per second ({first}), takes "
        f"{action['value']:.0f} us for an action, and trains at {training['value']:,.0f} steps per second.",
    ]
