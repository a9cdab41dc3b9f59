"""`landing-eval benchmark`: what a step, an action, a picture and a training cost on this machine.

Whatever is compared is measured in turns within one run, so that other load meets both sides; every
number is a median over repeats with its smallest and largest value.
"""

from __future__ import annotations

import json as json_format
import os
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from gymnasium.spaces import Box

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.shared.runs import check_new_run, hand_over, versions
from inclined_landing.envs.shared.statistics import spread
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval.base.options import Flag, NewFolder, Seed, VehicleFile
from inclined_landing.eval.machine import benchmark_table, exported
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle

VEHICLES = 256
_BLOCK = 25  # control steps in one timed block
_FAST = {"integrator": "implicitfast"}
# Plant and its options, options of the landing task.
_ENVIRONMENTS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "mujoco RK4": ("mujoco", {}, {}),
    "mujoco implicitfast": ("mujoco", _FAST, {}),
    "hybrid": ("hybrid", {}, {}),
    "hybrid implicitfast": ("hybrid", _FAST, {}),
    "  any slope": ("hybrid", _FAST, {"steepest": 0.45}),
    "  any slope, in space": ("hybrid", _FAST, {"steepest": 0.45, "dimensions": 3}),
    "  platforms that travel and heave": ("hybrid", _FAST, {"dimensions": 3, "fastest": 0.5, "swell": 1.0}),
    "  observes its vehicle": ("hybrid", _FAST, {"observe_vehicle": True}),
    "analytic": ("analytic", {}, {}),
}
_PLAIN = "hybrid implicitfast"  # beside which those with options of the task are
_PICTURE: dict[str, Any] = {"width": 640, "height": 480, "camera": "hero"}


def command(
    *,
    policy: Annotated[str | None, tyro.conf.arg(metavar="POLICY")] = None,
    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DIR [DIR ...]")] = (),
    quick: Flag = False,
    training: bool = True,
    vehicle: VehicleFile = None,
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """What a step, an action, a picture and a training cost here (a few minutes).

    Args:
        policy: landing policy for the latency (default: an untrained one of the usual size).
        runs: finished landing-train folders, for the time to 99 % success.
        quick: fewer repeats, under a minute.
        training: measure training speed against SB3's own update and its defaults on one plain environment.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        seed: of actions and trainings.
        json: print JSON, and nothing else, on standard output.
        out: new folder for benchmark.json.
    """
    if out is not None:
        check_new_run(out)
    to_99 = time_to_99(runs) if runs else None
    flown = load_vehicle(vehicle)
    loaded = load_policy(policy, "landing") if policy is not None else None
    report = {
        "command": "benchmark",
        "quick": quick,
        "seed": seed,
        "versions": versions(),
        "load_before": os.getloadavg(),
    }
    from rich.console import Console

    with Console(stderr=True).status("environments") as status:
        report["environments"] = environments(5 if quick else 25, seed, flown)
        status.update("policy")
        report["policy"] = policy_latency(loaded, 500 if quick else 5000, seed)
        status.update("video")
        report["video"] = video(10 if quick else 60, flown)
        if training:
            status.update("training")
            repeats, steps, plain_steps = (1, 100_000, 4096) if quick else (3, 300_000, 16_384)
            report["training"] = training_speed(repeats, steps, plain_steps, seed, status.update, vehicle)
    report["time_to_99_percent"] = to_99
    report["load_after"] = os.getloadavg()
    hand_over(report, benchmark_table.show, json, out)


def environments(repeats: int, seed: int, vehicle: Vehicle | None = None) -> list[dict]:
    """Control steps per second of 256 vehicles: the training environment and the bare physics.

    The environment is `BatchVecEnv` (task, reward, resets, episode statistics) under random actions.
    Each of its blocks is replayed at once, from the same states with the same commands, by the bare
    plant: for MuJoCo `mujoco.batch.Batch.step` and nothing else. The blocks of all environments take turns.
    `in_engine` is the share of vehicle steps that MuJoCo made, `over_plain` what options of the task add to
    the time of the environment without them.
    """
    rows = {label: _Environment(*how, seed, vehicle) for label, how in _ENVIRONMENTS.items()}
    for repeat in range(repeats + 2):
        for row in rows.values():
            row.block(kept=repeat >= 2)  # the first blocks compile and warm up
    plain = np.array(rows[_PLAIN].whole)
    return [{"plant": label} | row.result(plain if row.optional else None) for label, row in rows.items()]


class _Environment:
    """An environment and a bare plant of its kind; `whole` and `physics`: seconds of their blocks."""

    def __init__(self, kind: str, options: dict, task_options: dict, seed: int, vehicle: Vehicle | None):
        self._rng = np.random.default_rng(seed)
        self.optional = bool(task_options)
        task = make_task("landing", vehicle, pwm_centre="hover", **task_options)
        options = task.plant_options | options
        self._plant, self._bare = (make_plant(kind, VEHICLES, task.vehicle, **options) for _ in range(2))
        self._env = BatchEnv(task, self._plant, seed)
        self._face = BatchVecEnv(self._env)
        self._face.reset()
        self._env.length[:] = self._rng.integers(0, task.max_steps, VEHICLES)  # so that resets spread evenly
        self.whole: list[float] = []
        self.physics: list[float] = []
        self._contact: list[float] = []
        self._in_engine: list[float] = []

    def block(self, kept: bool) -> None:
        """Step the environment, then replay it by the bare plant."""
        plant, env = self._plant, self._env
        actions = self._rng.uniform(-1, 1, (_BLOCK, VEHICLES, len(env.task.action_names)))
        commands = []
        before = plant.save()
        flown_by_engine = np.zeros(_BLOCK)
        began = time.perf_counter()
        for k, a in enumerate(actions):
            self._face.step(a)
            commands.append(env.commands)
            flown_by_engine[k] = _in_engine(plant)
        between = time.perf_counter()
        self._bare.restore(before)
        advance = _bare(self._bare)
        middle = time.perf_counter()
        for u in commands:
            advance(u)
        ended = time.perf_counter()
        if kept:
            self.whole.append(between - began)
            self.physics.append(ended - middle)
            self._contact.append(float(plant.contacts.touch.any(axis=(1, 2)).mean()))
            self._in_engine.append(float(flown_by_engine.mean()))

    def result(self, plain: np.ndarray | None) -> dict:
        """Return the row of the report; plain: seconds of the blocks of the task without options."""
        whole, physics = np.array(self.whole), np.array(self.physics)
        return {
            "vehicles": VEHICLES,
            "steps_per_second": spread(_BLOCK * VEHICLES / whole),
            "bare_steps_per_second": spread(_BLOCK * VEHICLES / physics),
            "overhead": spread(whole / physics - 1.0),
            "over_plain": None if plain is None else spread(whole / plain - 1.0),
            "in_contact": float(np.mean(self._contact)),
            "in_engine": float(np.mean(self._in_engine)),
        }


def _in_engine(plant) -> float:
    """The share of the vehicles that MuJoCo flew in the last control step."""
    if plant.kind == "hybrid":
        return plant.in_engine.mean()
    return float(plant.kind == "mujoco")


def _bare(plant) -> Callable[[np.ndarray], None]:
    """The cheapest way to advance this plant by one control step under commands (n, 4)."""
    if plant.kind != "mujoco":
        return plant.step
    batch, substeps = plant.batch, plant.substeps
    ctrl = batch.bind("ctrl")

    def advance(commands: np.ndarray) -> None:
        ctrl[:] = commands
        batch.step(nstep=substeps)

    return advance


def policy_latency(policy: Policy | None, repeats: int, seed: int) -> dict:
    """Microseconds for one action of one observation: this package's loop, SB3's `predict`, exports."""
    with tempfile.TemporaryDirectory() as folder:
        policy = policy or load_policy(_untrained(Path(folder)), "landing")
        abroad = exported.latency(policy, repeats, seed)
    model = _stock(policy)
    rows = np.random.default_rng(seed).normal(size=(repeats, len(policy.centre))).astype(np.float32)
    own, stock = np.empty(repeats), np.empty(repeats)
    for row in rows[:10]:
        policy.predict(row), model.predict(row, deterministic=True)
    for k, row in enumerate(rows):
        began = time.perf_counter()
        policy.predict(row)
        between = time.perf_counter()
        model.predict(row, deterministic=True)
        own[k], stock[k] = between - began, time.perf_counter() - between
    batch = np.random.default_rng(seed).normal(size=(VEHICLES, len(policy.centre)))
    many = timeit.repeat(lambda: policy.predict(batch), number=1, repeat=min(repeats, 200))
    return {
        "policy": policy.name,
        "predict_us": spread(1e6 * own),
        "sb3_predict_us": spread(1e6 * stock),
        "predict_batch_us_per_row": spread(1e6 * np.array(many) / VEHICLES),
        "exported_us": abroad,
    }


def _stock(policy: Policy):
    """Stable-Baselines3's actor of the same size, with random weights.

    Its own reader is not asked for the file: it executes what the file holds.
    """
    from stable_baselines3.common.policies import ActorCriticPolicy

    from inclined_landing.envs.features import ScaledObservation

    return ActorCriticPolicy(
        Box(-np.inf, np.inf, policy.centre.shape, np.float32),
        Box(-1.0, 1.0, policy.biases[-1].shape, np.float32),
        lambda _: 0.0,
        net_arch=[bias.size for bias in policy.biases[:-1]],
        features_extractor_class=ScaledObservation,
        features_extractor_kwargs={"centre": policy.centre.tolist(), "scale": policy.scale.tolist()},
    )


def _untrained(folder: Path) -> Path:
    """A policy of the usual size with random weights."""
    from stable_baselines3 import PPO

    from inclined_landing.eval.machine.plain_env import PlainLandingEnv

    PPO("MlpPolicy", PlainLandingEnv(), seed=0, device="cpu").save(folder / "untrained.zip")
    return folder / "untrained.zip"


def video(frames: int, vehicle: Vehicle | None = None) -> list[dict]:
    """Milliseconds per 640x480 frame of a moving vehicle and a fixed camera, per backend."""
    from inclined_landing.envs.rendering.gl import probe

    found = probe()
    rows = [_frames("ray", frames, vehicle)]
    if found.kind:
        rows.append(_frames("gl", frames, vehicle) | {"hardware": found.hardware})
    else:
        rows.append({"backend": "gl", "skipped": f"{found.missing} is missing"})
    return rows


def _frames(backend: str, frames: int, vehicle: Vehicle | None) -> dict:
    from inclined_landing.envs.rendering import make_renderer
    from inclined_landing.envs.tasks.base import hover_states

    along = np.linspace(0.0, 1.0, frames + 2)
    positions = np.column_stack([1.5 - 1.5 * along, 0 * along, 1.8 - 0.5 * along])
    states = hover_states(positions, vehicle or load_vehicle())
    try:
        renderer = make_renderer(**_PICTURE, backend=backend, vehicle=vehicle)
    except UserError as error:
        return {"backend": backend, "skipped": str(error)}
    wall, cpu = [], []
    for k, state in enumerate(states):
        began, spent = time.perf_counter(), time.process_time()
        renderer.render(state)
        if k >= 2:  # the first frames draw the background
            wall.append(1e3 * (time.perf_counter() - began))
            cpu.append(1e3 * (time.process_time() - spent))
    renderer.close()
    return {"backend": backend, "wall_ms": spread(wall), "cpu_ms": spread(cpu)} | _PICTURE


def training_speed(
    repeats: int,
    steps: int,
    plain_steps: int,
    seed: int,
    notice: Callable[[str], None],
    vehicle: Path | None = None,
) -> dict:
    """Training steps per second, in turns: as by default, with `--update stock`, and the plain baseline.

    Each runs in a process of its own and counts from the first environment step to the last update, without
    start-up, evaluation and reports. ratio: to the plain baseline, SB3's PPO with its defaults on one plain
    environment; ratio_to_stock: to this package's vehicles and settings with SB3's own rollout and update.
    """
    given = ("--vehicle", str(vehicle)) if vehicle is not None else ()
    sides = {  # by the beginning of its keys
        "": ("landing-train", _landing_train, steps, given),
        "stock_": ("landing-train --update stock", _landing_train, steps, (*given, "--update", "stock")),
        "plain_": ("plain baseline", _plain, plain_steps, given),
    }
    measured: dict[str, list[float]] = {side: [] for side in sides}
    for k in range(repeats):
        for side, (words, measure, count, options) in sides.items():
            notice(f"training, {words}, {k + 1} of {repeats}")
            measured[side].append(measure("--steps", str(count), "--seed", str(seed + k), *options))
    rates = {side: np.array(values) for side, values in measured.items()}
    return {
        "steps": steps,
        "plain_steps": plain_steps,
        "seeds": [seed + k for k in range(repeats)],
        **{f"{side}steps_per_second": spread(rate) for side, rate in rates.items()},
        "ratio": spread(rates[""] / rates["plain_"]),
        "ratio_to_stock": spread(rates[""] / rates["stock_"]),
    }


def _landing_train(*options: str) -> float:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        quiet = ("--out", str(out), "--no-report", "--evaluate-every", "0", "--video-every", "0")
        _python("inclined_landing.train", "landing", *options, *quiet)
        metrics = json_format.loads((out / "metrics.json").read_text("utf-8"))
    return float(metrics["steps_per_second"])


def _plain(*options: str) -> float:
    text = _python("inclined_landing.eval.machine.plain_env", *options[1::2])  # their values
    return float(text.splitlines()[-1])


def _python(module: str, *arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", module, *arguments], capture_output=True, text=True)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise UserError(f"the benchmark's `python -m {module}` failed: {reason}")
    return done.stdout


def time_to_99(folders: Sequence[Path]) -> dict:
    """When finished runs of landing-train first evaluated at 99 % or more.

    Raises UserError when a folder holds no finished run.
    """
    rows = []
    for folder in folders:
        path = folder / "metrics.json"
        if not path.is_file():
            raise UserError(f"{folder} is not a finished training run: no metrics.json")
        try:
            metrics = storage.read_json(path, "metrics")
            first = metrics["evaluations"]["first_at_99_percent"]
            row = {"run": str(folder), "seed": int(metrics["seed"]), "cpu": str(metrics["versions"]["cpu"])}
            if first is not None:
                row |= {"steps": float(first["steps"]), "seconds": float(first["training_seconds"])}
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            if isinstance(error, UserError):
                raise
            raise UserError(f"{path} is not the metrics of a training run") from error
        rows.append(row)
    reached = [row for row in rows if "steps" in row]
    return {
        "runs": rows,
        "reached": len(reached),
        "steps": spread([row["steps"] for row in reached]),
        "seconds": spread([row["seconds"] for row in reached]),
    }
