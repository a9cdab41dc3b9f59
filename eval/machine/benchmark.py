"""`landing-eval benchmark`: the speed of steps, actions, training and first use on this machine."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.measures import Measure
from inclined_landing.envs.shared.statistics import median
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
# Options of the landing task and of its hybrid plant, with which platforms can move.
_PLATFORMS: dict[str, dict[str, Any]] = {
    "at rest": {"fastest": 0.0},
    "moving": {"fastest": 1.0, "swell": 1.0},
}
# What a new user runs first; the plant is the program's argument.
_FIRST_USE = """
import sys, gymnasium, inclined_landing
environment = gymnasium.make("InclinedLanding-v0", plant=sys.argv[1])
environment.reset(seed=0)
environment.step(environment.action_space.sample())
"""
_BLOCK, _REPEATS = 15, 10  # control steps that are timed together, and how often
_ACTIONS = 2000  # number of actions that are timed one by one
_TRAINING_STEPS = 100_000


def middle(values: np.ndarray) -> dict[str, Any]:
    """Return the median with the range."""
    found = median(values)
    return found | {"low": found["min"], "high": found["max"]}


RATE, CPU, ACTION, TRAINING, FIRST = (
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
        ("step_cpu_us", "CPU microseconds per step", "us", 1),
        ("action_us", "microseconds for an action", "us", 1),
        ("training_steps_per_second", "steps per second of training", "1/s", 0),
        ("first_use_cpu_s", "CPU seconds of the first use", "s", 1),
    )
)


def command(*, seed: Seed = 0, json: Flag = False, out: NewFolder = None) -> None:
    """Measure the speed of steps, actions, training and first use on this machine (one to two minutes).

    The first use makes an environment and does one step; numba compiles what it needs. Compiled functions
    are kept, so that later uses take a second or two.

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
    platforms = {name: _environment("hybrid", seed, dimensions=3, **x) for name, x in _PLATFORMS.items()}
    plants = {name: _environment(kind, seed, x) for name, (kind, x) in _PLANTS.items()}
    measured = [
        *({"plant": name} | times for name, times in step_times(plants, _REPEATS, seed)),
        *({"platforms": name} | times for name, times in step_times(platforms, _REPEATS, seed)),
        *({ACTION.name: x} for x in action_times(load_policy("landing"), _ACTIONS, seed)),
        {TRAINING.name: training_rate(_TRAINING_STEPS, seed)},
        *({"first use": kind, FIRST.name: first_use(kind)} for kind in ("mujoco", "hybrid")),
    ]
    loads = {"before": before, "after": os.getloadavg()[0]}
    study = engine.Study(
        name="benchmark",
        title=f"Speed on this machine, {VEHICLES} vehicles",
        cases=(),
        views=[
            engine.View(("plant",), (RATE, CPU), "control steps, by plant", across=True),
            engine.View(("platforms",), (CPU,), "hybrid plant in space, by its platforms", across=True),
            engine.View(("first use",), (FIRST,), "first use, by plant", across=True),
            engine.View((), (ACTION, TRAINING), "actions and training", across=True),
        ],
        remarks=_remarks,
        series="plant",
        facts=[engine.fact("load of this machine", name, load) for name, load in loads.items()],
    )
    hand_over("benchmark", [engine.evaluate(study, pd.DataFrame(measured))], json=json, out=out)


def _environment(kind: str, seed: int, plant_options: Mapping = MappingProxyType({}), **options: Any):
    """Return a landing environment with VEHICLES in a plant of this kind, in the middle of its episodes."""
    from inclined_landing.envs.batch import BatchEnv
    from inclined_landing.envs.sb3 import BatchVecEnv
    from inclined_landing.envs.tasks import make_task
    from inclined_landing.models.plants import make_plant

    task = make_task("landing", pwm_centre="hover", **options)
    plant = make_plant(kind, VEHICLES, task.vehicle, **plant_options, **task.plant_options)
    environment = BatchVecEnv(BatchEnv(task, plant, seed))
    environment.reset()
    # Resets are spread evenly.
    environment.env.length[:] = np.random.default_rng(seed).integers(0, task.max_steps, VEHICLES)
    return environment


def step_times(
    environments: Mapping[str, BatchVecEnv], repeats: int, seed: int
) -> list[tuple[str, dict[str, float]]]:
    """Return RATE and CPU of blocks of control steps under random actions, each with its environment's name.

    A step is one of `BatchVecEnv`, including task, reward, resets and episode statistics. The environments
    are measured alternately, so that other load on the machine affects all of them.
    """
    found = []
    for repeat in range(repeats + 2):
        for name, environment in environments.items():
            rng = np.random.default_rng((seed, repeat))  # the same actions in all
            actions = rng.uniform(-1, 1, (_BLOCK, VEHICLES, *environment.action_space.shape))
            began, used = time.perf_counter(), time.process_time()
            for action in actions:
                environment.step(action)
            steps, seconds = _BLOCK * VEHICLES, time.perf_counter() - began
            times = {RATE.name: steps / seconds, CPU.name: 1e6 * (time.process_time() - used) / steps}
            if repeat >= 2:  # the first blocks compile and warm up
                found.append((name, times))
    return found


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


def first_use(kind: str) -> float:
    """Return the CPU seconds in which a new process without compiled functions does a first step."""
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        program = [sys.executable, "-P", "-c", _FIRST_USE, kind]
        subprocess.run(program, env=os.environ | {"NUMBA_CACHE_DIR": folder}, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _remarks(results: Results) -> list[str]:
    machine, plant = runs.versions(), next(iter(_PLANTS))
    loads = [f"{row['value']:.1f} {row['name']}" for row in results.study.facts]
    rate, action, training, first = map(results.one, (RATE, ACTION, TRAINING, FIRST))
    resting, moving = (results.one(CPU, platforms=name)["value"] for name in _PLATFORMS)
    return [
        f"{machine['cpu']}, {machine['cores']} cores, load {' and '.join(loads)}.",
        f"This machine simulates {rate['value']:,.0f} control steps per second ({plant}), takes "
        f"{action['value']:.0f} us for an action, and trains at {training['value']:,.0f} steps per second.",
        f"Platforms that move cost {100 * (moving / resting - 1):+.0f} % of CPU over platforms at rest.",
        f"The first use after an installation takes {first['value']:.1f} s of CPU.",
    ]
