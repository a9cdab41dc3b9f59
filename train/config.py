"""The configuration of a training run: a field for each option of `landing-train`, and its defaults."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from msgspec import Meta

from inclined_landing.envs.policy import (
    action_map,
    dimensions_of,
    history_length,
    observes_vehicle,
    tensors,
    trained_task,
)
from inclined_landing.envs.randomise import locate
from inclined_landing.envs.shared.options import Seed, flag_of
from inclined_landing.envs.tasks import TASKS, import_task, is_path, task_class
from inclined_landing.envs.tasks.options import Many, Share, Training
from inclined_landing.models import schema
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle, locate_vehicle
from inclined_landing.models.schema import Real
from inclined_landing.train import descent

# Files of which a run keeps a copy, and its name there.
COPIED = {"vehicle": "vehicle.toml", "randomise": "randomise.toml"}
# Options that say when a run ends: the first alone, or the others.
ENDING = ("steps", "success", "min_steps", "max_steps")
# Options of the task, and those of them that the command line has in degrees.
TASK_OPTIONS = (
    *("inclination", "steepest", "dimensions", "random_yaw", "fastest", "swell", "angle_limit"),
    *("pwm_centre", "pwm_span", "history", "observe_vehicle"),
)
ANGLES = ("inclination", "steepest", "angle_limit")
# What --help shows; --help-all shows every option.
COMMON = (
    *("task", "out", "seed", "steps", "start_from", "inclination", "steepest", "dimensions", "vehicle"),
    *("randomise", "nominal", "plant", "net_arch", "resume", "report"),
)
CARRIED_ON = 100_000  # min_steps of a run that goes on from a policy of its task
NET_ARCH = (64, 64)


# --- presets: values of options that are not set -----------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Preset:
    """Values of options that depend on which vehicles are flown."""

    randomise: str | None  # ranges that each episode's vehicle is drawn from; None: one vehicle
    history: int  # past steps that the policy is given, to tell a vehicle or a platform's motion by
    all_commands: bool  # do actions reach every PWM, as some vehicles need; or what is around hover
    evaluate_every: int  # iterations
    more_steps: int  # added to min_steps


NOMINAL = Preset(randomise=None, history=0, all_commands=False, evaluate_every=16, more_steps=0)
DRAWN = Preset(randomise="robust", history=3, all_commands=True, evaluate_every=32, more_steps=700_000)
# Touchdown over moving platforms: one vehicle, and a motion to be told.
MOVING = Preset(randomise=None, history=3, all_commands=True, evaluate_every=16, more_steps=0)
# Values in place of the task's training defaults. Landing drawn vehicles in space, where they differ in more:
# with the rates of the plane one of three seeds learned it.
SPACE: dict[str, Any] = {"rollout": 128, "learning_rate": 1e-3}
# Touchdown in the plane begins with a landing policy, and explores more.
PLANE: dict[str, Any] = {
    "start_from": "landing-nominal",
    "learning_rate": 4e-4,
    "log_std_init": -1.2,
    "gamma": 0.99,
    "steps": 1_500_000,
    "environments": 64,
    "batch_size": 512,
}


# --- options ----------------------------------------------------------------------------------------

Iterations = Annotated[int, Meta(ge=0, le=10**9)]
Seconds = Annotated[float, Meta(gt=0, lt=10**9)]
Discount = Annotated[float, Meta(gt=0, lt=1)]
Width = Annotated[int, Meta(ge=1, le=8192)]  # as policy files may have
Widths = Annotated[tuple[Width, ...], Meta(min_length=1, max_length=15)]


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3's PPO; everything lands in one run folder.

    Where the task names a share of successes, the run ends when the curriculum is complete and two
    evaluations in a row reach it, each from 256 starts of its own. One that ends without exits with code 3;
    wrong input with 2. Options without a default here have the task's, or that of its vehicles; run.json in
    the run folder has all values.

    `landing-train sweep RECIPE` runs the command lines of a recipe for every seed.
    """

    task: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[TASK]")] = "landing"
    """landing, setpoint, touchdown, or one of your own: module:Class or file.py:Class."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder (default: runs/TASK-seed)."""
    seed: Seed = 0
    """Of the policy, the starts and the minibatches, not of periodic evaluation."""

    # --- when it ends
    steps: int | None = None
    """Environment steps, fixed beforehand; with --resume, to train a run for more."""
    success: float | None = None
    """Share of successes, from 0 to 1, in two evaluations in a row, that ends the run."""
    min_steps: int | None = None
    """Environment steps that such a run has at least."""
    max_steps: int | None = None
    """Environment steps that such a run has at most."""
    max_seconds: Seconds | None = None
    """Stop at this wall time [s]; the checkpoint allows to resume."""
    max_cpu_seconds: Seconds | None = None
    """Stop after so much computing for the training [s], on all cores together and without evaluations:
    unlike wall time, other work on the machine does not use it up."""

    # --- what it goes on from
    start_from: Annotated[str | None, tyro.conf.arg(name="from", metavar="POLICY")] = None
    """The policy to go on from, a file or a shipped one; descent: the law that touchdown in space begins
    with."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; task and all else are those of the run."""

    # --- the task
    inclination: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Of the platform in degrees, where it differs from the vehicle file's."""
    steepest: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Every episode has a slope of its own, which the policy observes: up to this inclination in degrees, to
    both sides; in three dimensions to all sides."""
    dimensions: Literal[2, 3] | None = None
    """With 3 it flies in space, with roll, and not in a plane (default: 2, touchdown 3)."""
    random_yaw: bool = False
    """With three dimensions: every episode begins with a heading of its own."""
    fastest: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """With three dimensions: platforms that travel steadily, any way, at up to this speed (observed)."""
    swell: float | None = None
    """With --fastest: platforms heave, roll and pitch too; 1: by up to 0.24 m and 16 deg (default: 0)."""
    angle_limit: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Of roll and pitch commands in degrees, where it differs from the vehicle file's."""
    pwm_centre: Annotated[
        float | Literal["hover", "own", "paper"] | None, tyro.conf.arg(metavar="NUMBER|hover|own|paper")
    ] = None
    """PWM at action 0: a number, hover (of the vehicle with its effects), own (of each vehicle that is drawn,
    or flown later) or paper, 42000 (default: hover; landing on drawn vehicles the middle of all commands,
    35000; with --from the policy's, which is rewritten for another)."""
    pwm_span: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """PWM from action 0 to action 1 (default: the vehicle file's, 16500; landing on drawn vehicles up to the
    ends of all commands, 25000; with --from the policy's)."""
    history: int | None = None
    """Past steps, observation and action each, that the policy is given besides the observation (default: as
    many as the policy in --from; else landing on drawn vehicles 3, others 0)."""
    observe_vehicle: bool = False
    """Tell the policy six numbers of each vehicle: thrust to weight, lags, gain, drag, reach. One that goes
    on from a policy that is told them is too."""

    # --- the vehicle and the plant
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML), or a shipped vehicle by name, where it is not the Crazyflie 2.1; the run keeps a
    copy."""
    randomise: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges (TOML, or a shipped name) that each episode's vehicle is drawn from (default: landing and
    touchdown, robust)."""
    nominal: bool = False
    """As in the paper: one vehicle in the plane, no history, actions around hover."""
    plant: Literal["mujoco", "hybrid", "analytic"] = "hybrid"
    """The engine; the same with the equations in free flight; or the equations alone."""
    integrator: Literal["RK4", "implicitfast", "Euler"] | None = None
    """Of the engine in training, 4 ms steps; evaluation uses RK4."""
    keep_out: float | None = None
    """Sensor-only zone around the platform that is an obstacle in training [m]."""
    environments: int | None = None
    """Vehicles stepped together."""
    threads: Annotated[int, Meta(ge=0, le=1024)] = 0
    """Physics threads (0: all cores)."""

    # --- learning
    net_arch: Annotated[Widths | None, tyro.conf.arg(metavar="N [N ...]")] = None
    """Widths of the hidden layers, of actor and critic each (default: 64 64; with --from the policy's)."""
    curriculum: str | None = None
    """What eases the task at first; landing: adaptive, fixed, paper, none; setpoint: effort, none; touchdown:
    touchdown."""
    without: Annotated[str | None, tyro.conf.arg(metavar="PART[,PART...]")] = None
    """Parts of the landing's curriculum to leave out: start, tilt, motion, goal and platform are the task's
    from the first step on; without departure, a vehicle that leaves is cut and pays nothing."""
    rollout: int | None = None
    """Steps of each vehicle in an iteration, after which PPO updates."""
    batch_size: int | None = None
    """Samples in a minibatch, at most a whole rollout."""
    epochs: int | None = None
    """Passes over each rollout."""
    learning_rate: float | None = None
    """Initial; the curriculum says when it falls."""
    gamma: Annotated[Discount | Literal["paper"] | None, tyro.conf.arg(metavar="NUMBER|paper")] = None
    """Discount; paper: from 0.97 to 0.99 over 800 000 steps, as in the curriculum paper anyway."""
    gae_lambda: Share = 0.95
    """Of the advantage estimate."""
    entropy: Share = 0.0
    """Weight of the entropy bonus."""
    log_std_init: float | None = None
    """Logarithm of the initial exploration noise."""
    reward_scale: Annotated[float, Meta(gt=0, lt=1000)] = 0.1
    """Rewards are multiplied by this before PPO sees them."""
    update: Literal["fast", "stock"] = "fast"
    """PPO compiled for tanh networks, or Stable-Baselines3's own: the same loss and files."""

    # --- what it writes on its way
    evaluate_every: Iterations | None = None
    """Iterations between evaluations in the hybrid plant, without training aids; 0: never (default: 16; on
    drawn vehicles 32)."""
    checkpoint_every: Many = 20
    """Iterations between checkpoints."""
    report: bool = True
    """After training: success table, learning curves, figures, a picture and a video of one flight."""

    def resolved(self) -> TrainConfig:
        """Return a copy with every default filled in and every value checked; raises UserError."""
        return resolve(self)

    @property
    def folder(self) -> Path:
        """The run folder; of a resolved configuration."""
        assert self.out is not None
        return self.out

    def task_options(self) -> dict[str, Any]:
        """Return the options of the task that are given, angles in rad."""
        options = {name: getattr(self, name) for name in TASK_OPTIONS}
        return {
            name: math.radians(value) if name in ANGLES else value
            for name, value in options.items()
            if value is not None and value is not False
        }

    def copied(self) -> dict[str, Path]:
        """Of what the run keeps a copy, by the copy's name."""
        files = {}
        if self.vehicle is not None:
            files[COPIED["vehicle"]] = locate_vehicle(self.vehicle)
        if self.randomise is not None:
            files[COPIED["randomise"]] = locate(self.randomise)
        return files

    @property
    def per_iteration(self) -> int:
        """Environment steps of an iteration; of a resolved configuration."""
        assert self.environments is not None and self.rollout is not None
        return self.environments * self.rollout

    def most_steps(self) -> int:
        """Environment steps after which the run ends in any case; of a resolved configuration."""
        most = self.max_steps if self.steps is None else self.steps
        assert most is not None
        return most

    def as_json(self) -> dict:
        """The configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", *COPIED) if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths | {"net_arch": list(self.net_arch or ())}


# --- defaults ---------------------------------------------------------------------------------------


def resolve(config: TrainConfig) -> TrainConfig:
    """Return a copy with every default filled in, whose values are checked; raises UserError."""
    schema.check(config, None, flag_of)
    kind = import_task(config.task) if is_path(config.task) else task_class(config.task)
    training = kind.training
    try:
        training.check()
    except UserError as error:  # of a task of one's own
        raise UserError(f"task {shown(config.task, 60)}, its training: {error}") from error
    for name in config.task_options():
        if name not in kind.option_names():
            raise UserError(f"{flag_of(name)} is no option of the task {kind.name}")

    # In the plane, unless the task draws vehicles in space alone and nothing asks for the plane.
    dimensions, start = config.dimensions, config.start_from
    if dimensions is None and not config.nominal and kind.drawn_vehicles == (3,):
        in_space = start in (None, descent.NAME) or dimensions_of(start) == 3
        dimensions = 3 if in_space else None

    # Which vehicles, and how learning begins.
    by_law = training.start_from == descent.NAME and dimensions == 3
    is_drawn = (dimensions or 2) in kind.drawn_vehicles and config.fastest is None and not config.nominal
    preset = DRAWN if is_drawn else MOVING if by_law and not config.nominal else NOMINAL
    if training.start_from == descent.NAME and not by_law:
        training = dataclasses.replace(training, **PLANE)
    if is_drawn and dimensions == 3 and not by_law:
        training = dataclasses.replace(training, **SPACE)
    if config.nominal and config.randomise is not None:
        raise UserError("--nominal trains on one vehicle, and --randomise draws many: leave one out")
    randomise = config.randomise or preset.randomise
    pace = NOMINAL if randomise is None else DRAWN

    # The task's training defaults, but for what is given.
    named = [field.name for field in dataclasses.fields(Training)]
    chosen = {name: getattr(config, name) for name in named if getattr(config, name) is not None}
    learning = dataclasses.replace(training, **chosen)
    schema.check(learning, None, flag_of)
    values: dict[str, Any] = {name: getattr(learning, name) for name in named if name not in ENDING}
    values["evaluate_every"] = pace.evaluate_every if config.evaluate_every is None else config.evaluate_every

    # A policy to go on from flies as before: of the same task with its history, and with its actions and net.
    policy = None if learning.start_from == descent.NAME else learning.start_from
    same = policy if policy is not None and trained_task(policy) == kind.name else None
    least = (training.min_steps if same is None else CARRIED_ON) + pace.more_steps
    values |= _ending(config, training, least)
    values["history"] = config.history
    if config.history is None:
        values["history"] = preset.history if same is None else history_length(same)
    values["observe_vehicle"] = config.observe_vehicle or (same is not None and observes_vehicle(same))
    values |= _action_map(config, policy, preset)
    values["net_arch"] = tuple(config.net_arch or _net_arch(policy) or NET_ARCH)

    samples = values["environments"] * values["rollout"]
    if samples == 1:
        raise UserError("--environments and --rollout must give more than one sample")
    values["batch_size"] = min(values["batch_size"], samples)
    if samples % values["batch_size"] == 1:
        raise UserError("--batch-size leaves a last minibatch of one sample; choose another")
    values |= {
        "dimensions": dimensions,
        "out": Path(config.out or f"runs/{kind.name}-{config.seed}"),
        "vehicle": None if config.vehicle is None else Path(config.vehicle),
        "randomise": None if randomise is None else Path(randomise),
    }
    return dataclasses.replace(config, **values)


def _ending(config: TrainConfig, training: Training, least: int) -> dict[str, Any]:
    """Return the fields in ENDING that say when the run ends; least: its usual min_steps."""
    chosen = [flag_of(name) for name in ENDING[1:] if getattr(config, name) is not None]
    if config.steps is not None:
        if chosen:
            raise UserError(f"--steps fixes how long the run is; {chosen[0]} goes without it")
        return {}
    if training.success is None:
        if chosen:
            by_success = " and ".join(task.name for task in TASKS.values() if task.training.success)
            raise UserError(
                f"{chosen[0]} is for the {by_success} task; a run of {config.task} is fixed by --steps"
            )
        return {"steps": training.steps}
    if config.evaluate_every == 0:
        raise UserError("--evaluate-every 0 goes with --steps: without evaluations nothing ends the run")
    low, high = config.min_steps, config.max_steps
    if low is not None and high is not None and low > high:
        raise UserError(f"--min-steps {low} is more than --max-steps {high}")
    return {
        "success": training.success if config.success is None else config.success,
        "min_steps": min(least, high or least) if low is None else low,
        "max_steps": max(training.max_steps, low or 0) if high is None else high,
    }


def _action_map(config: TrainConfig, policy: str | None, preset: Preset) -> dict[str, Any]:
    """Return what actions command, `pwm_centre` and `pwm_span`: as in the policy to go on from."""
    centre: float | str | None = config.pwm_centre
    span = config.pwm_span
    if policy is not None and (centre is None or span is None):
        before = action_map(policy)
        centre = before[0] if centre is None else centre
        span = before[1] if span is None else span
    if preset.all_commands and centre is None and span is None:
        low, high = load_vehicle(config.vehicle).command_pwm_range
        centre, span = 0.5 * (low + high), 0.5 * (high - low)
    if span is None:
        span = load_vehicle(config.vehicle).command_pwm_span
    return {"pwm_centre": "hover" if centre is None else centre, "pwm_span": span}


def _net_arch(policy: str | None) -> list[int]:
    """Return the widths of the hidden layers of a policy's actor; none without a policy."""
    names = tensors(policy) if policy is not None else {}
    return [len(bias) for name, bias in names.items() if "policy_net" in name and name.endswith("bias")]
