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

from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.models.base.errors import UserError

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.envs.sb3 import BatchVecEnv

VEHICLES = 256
_PLANTS = {
    "mujoco RK4": ("mujoco", {}),
    "mujoco implicitfast": ("mujoco", {"integrator": "implicitfast"}),
    "hybrid RK4": ("hybrid", {}),
    "hybrid implicitfast": ("hybrid", {"integrator": "implicitfast"}),
    "analytic": ("analytic", {}),
}
_BLOCK, _REPEATS = 15, 10  # control steps that are timed together, and how often
_ACTIONS = 2000  # that are timed one by one
_TRAINING_STEPS = 100_000


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
        out: new folder for benchmark.json.
    """
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.shared.runs import hand_over, versions

    report: dict[str, Any] = {"command": "benchmark", "seed": seed, "versions": versions()}
    report["load_before"] = os.getloadavg()
    report["environments"] = step_rates(_REPEATS, seed)
    report["action_us"] = action_times(load_policy("landing"), _ACTIONS, seed)
    report["training_steps_per_second"] = training_rate(_TRAINING_STEPS, seed)
    report["load_after"] = os.getloadavg()
    hand_over(report, _show, json, out)


def step_rates(repeats: int, seed: int) -> list[dict[str, Any]]:
    """Return control steps per second of 256 vehicles under random actions, for each plant.

    A step is one of `BatchVecEnv`, including task, reward, resets and episode statistics. The plants are
    measured alternately, so that other load on the machine affects all of them.
    """
    from inclined_landing.envs.batch import BatchEnv
    from inclined_landing.envs.sb3 import BatchVecEnv
    from inclined_landing.envs.shared.statistics import spread
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
    return [
        {"plant": label, "vehicles": VEHICLES, "steps_per_second": spread(rate)}
        for label, rate in rates.items()
    ]


def action_times(policy: Policy, repeats: int, seed: int) -> dict[str, Any]:
    """Return the microseconds that a policy takes for one action."""
    from inclined_landing.envs.shared.statistics import spread

    rows = np.random.default_rng(seed).normal(size=(repeats + 10, len(policy.centre))).astype(np.float32)
    microseconds = []
    for row in rows:
        began = time.perf_counter()
        policy.predict(row)
        microseconds.append(1e6 * (time.perf_counter() - began))
    return spread(microseconds[10:])


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


def _show(report: dict[str, Any]) -> None:
    from inclined_landing.envs.shared.tables import new_table, say, show_table

    rows, machine = report["environments"], report["versions"]
    loads = report["load_before"][0], report["load_after"][0]
    say(
        f"{machine['cpu']}, {machine['cores']} cores, load {loads[0]:.1f} before and {loads[1]:.1f} after; "
        f"Python {machine['python']}, MuJoCo {machine['mujoco']}, torch {machine['torch']}; "
        f"seed {report['seed']}. Median (smallest to largest)."
    )
    table = new_table(f"Control steps per second, {VEHICLES} vehicles", "plant", "steps per second")
    for row in rows:
        rate = "{median:,.0f} ({min:,.0f} to {max:,.0f})".format(**row["steps_per_second"])
        table.add_row(row["plant"], rate)
    show_table(table)
    say(
        f"This machine simulates {rows[0]['steps_per_second']['median']:,.0f} control steps per second "
        f"({rows[0]['plant']}), takes {report['action_us']['median']:.0f} us for an action, "
        f"and trains at {report['training_steps_per_second']:,.0f} steps per second."
    )
