"""The configuration of a training run: a field for each option of `landing-train`.

Defaults that depend on the task, its dimensions and its vehicles are one table, in `envs.tasks.training`.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from msgspec import Meta

from inclined_landing.envs.ids import DESCENT
from inclined_landing.envs.shared.options import Seed, flag_of
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.base.schema import Many, Real, Share
from inclined_landing.models.parameters import load_vehicle, locate_vehicle

if TYPE_CHECKING:
    from inclined_landing.envs.tasks.base import Task
    from inclined_landing.envs.tasks.training import Training

# Files of which a run keeps a copy, and its name there.
COPIED = {"vehicle": "vehicle.toml", "randomise": "randomise.toml", "start_from": "from.zip"}
# Options that say when a run ends: the first alone, or the others.
ENDING = ("steps", "success", "max_steps")
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
MIN_STEPS_CONTINUED = 100_000  # least steps of a run that continues from a policy of its task
SELDOM = 32  # iterations between the longer evaluations of runs of a fixed length with drawn vehicles
NET_ARCH = (64, 64)


# --- options ----------------------------------------------------------------------------------------

Iterations = Annotated[int, Meta(ge=0, le=10**9)]
Seconds = Annotated[float, Meta(gt=0, lt=10**9)]
Discount = Annotated[float, Meta(gt=0, lt=1)]
Width = Annotated[int, Meta(ge=1, le=8192)]  # the limits of policy files
Widths = Annotated[tuple[Width, ...], Meta(min_length=1, max_length=15)]


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3's PPO and write everything into one run folder.

    If the task sets a success rate, the run ends when the curriculum is complete and two evaluations in a row
    reach that rate, on the nominal vehicle and on vehicles with one effect each. The exit code is 3 if the
    run ends without reaching it, and 2 for wrong input. Options without a default take the value of the task
    or of its vehicles; run.json in the run folder records all values.

    `landing-train sweep RECIPE` runs the command lines of a recipe for every seed.
    """

    task: Annotated[
        tyro.conf.Positional[str], tyro.conf.arg(metavar="[TASK]", help_behavior_hint="(default: landing)")
    ] = ""
    """landing (default), setpoint, touchdown, or a custom task as module:Class or file.py:Class."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder (default: runs/TASK-seed)."""
    seed: Seed = 0
    """Seed for the policy, the starts and the minibatches; periodic evaluation has its own."""

    # --- when it ends
    steps: int | None = None
    """Fixed number of environment steps; with --resume, the new total."""
    success: float | None = None
    """Success rate, from 0 to 1, that ends the run when two evaluations in a row reach it."""
    max_steps: int | None = None
    """Maximum number of environment steps of a run that ends by success."""
    max_seconds: Seconds | None = None
    """Stop after this wall time [s]; the run can be resumed from its checkpoint."""

    # --- what it goes on from
    start_from: Annotated[str | None, tyro.conf.arg(name="from", metavar="POLICY")] = None
    """Policy to start from: a file, a shipped name or, for touchdowns in 3D, descent."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint, with the task and options of that run."""

    # --- the task
    inclination: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Platform inclination in degrees (default: that of the vehicle file); negative rises towards +x."""
    steepest: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Draw a slope for every episode, up to this inclination in degrees, in both directions or, in 3D, in any
    direction. The policy observes it."""
    dimensions: Literal[2, 3] | None = None
    """3 flies in space, with roll; 2 flies in a plane (default: 2, touchdown 3)."""
    random_yaw: bool = False
    """In 3D, draw the initial heading of every episode."""
    fastest: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """In 3D, let platforms travel in any direction at a constant speed of up to this value. The policy
    observes it."""
    swell: float | None = None
    """With --fastest, let platforms also heave, roll and pitch; 1 is up to 0.24 m and 16 deg (default: 0)."""
    angle_limit: Annotated[Real | None, tyro.conf.arg(metavar="DEG")] = None
    """Limit of roll and pitch commands in degrees (default: that of the vehicle file)."""
    pwm_centre: Annotated[
        float | Literal["hover", "own", "paper"] | None, tyro.conf.arg(metavar="NUMBER|hover|own|paper")
    ] = None
    """PWM at action 0: a number, hover (that of the vehicle with its effects), own (that of each drawn or
    flown vehicle) or paper, 42000 (default: hover; for landing with randomised vehicles the middle of the
    command range, 35000; with --from that of the policy, which is rewritten if another is given)."""
    pwm_span: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """PWM from action 0 to action 1 (default: that of the vehicle file, 16500; for landing with randomised
    vehicles the whole command range, 25000; with --from that of the policy)."""
    history: int | None = None
    """Number of past steps, each an observation and an action, in the policy's input (default: that of the
    policy in --from; otherwise 3 for landing with randomised vehicles, else 0)."""
    observe_vehicle: bool = False
    """Let the policy observe six parameters of its vehicle: thrust to weight, lags, gain, drag, reach.
    Implied by a policy in --from that observes them."""

    # --- the vehicle and the plant
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1); the run keeps a copy."""
    randomise: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File of ranges (TOML), or name of a shipped one, to draw each episode's vehicle from (default: robust
    for landing and touchdown, otherwise none)."""
    nominal: bool = False
    """Train as in the paper: one vehicle, no history, actions around hover."""
    plant: Literal["mujoco", "hybrid", "analytic"] = "hybrid"
    """Simulated physics: mujoco, analytic (the equations), or hybrid (the engine only near surfaces)."""
    environments: int | None = None
    """Number of vehicles simulated in parallel."""
    threads: Annotated[int, Meta(ge=0, le=1024)] = 0
    """Number of physics threads (0: all cores, or one where few vehicles are near a surface)."""

    # --- learning
    net_arch: Annotated[Widths | None, tyro.conf.arg(metavar="N [N ...]")] = None
    """Widths of the hidden layers of actor and critic (default: 64 64; with --from those of the policy)."""
    curriculum: str | None = None
    """Curriculum: adaptive, balanced, fixed, paper or none for landing (default: adaptive, or balanced if
    vehicles are drawn in the plane without --steepest, --randomise and --from); effort or none for setpoint;
    touchdown for touchdown."""
    without: Annotated[str | None, tyro.conf.arg(metavar="PART[,PART...]")] = None
    """Parts of the landing curriculum to omit. start, tilt, motion, goal and platform then have the task's
    values from the first step. Without departure, leaving the arena truncates the episode."""
    rollout: int | None = None
    """Steps of each vehicle between two updates of PPO."""
    batch_size: int | None = None
    """Samples in a minibatch, at most one whole rollout."""
    epochs: int | None = None
    """Passes over each rollout."""
    learning_rate: float | None = None
    """Initial learning rate; the curriculum determines its decay."""
    gamma: Annotated[Discount | Literal["paper"] | None, tyro.conf.arg(metavar="NUMBER|paper")] = None
    """Discount factor; paper raises it from 0.97 to 0.99 over 800 000 steps, as the curriculum paper does."""
    gae_lambda: Share | None = None
    """Lambda of the generalised advantage estimate."""
    log_std_init: float | None = None
    """Logarithm of the initial exploration noise."""
    reward_scale: Annotated[float, Meta(gt=0, lt=1000)] = 0.1
    """Rewards are multiplied by this before PPO sees them."""
    update: Literal["fast", "stock"] = "fast"
    """PPO implementation: fast (compiled, for tanh networks) or stock (Stable-Baselines3's)."""

    # --- what it writes on its way
    evaluate_every: Iterations | None = None
    """Iterations between evaluations, 0 for none (default: 16; with randomised vehicles and --steps 32)."""
    checkpoint_every: Many = 20
    """Iterations between checkpoints."""
    report: bool = True
    """After training, write a success table, curves, figures, a picture and a video of one flight."""

    def resolved(self) -> TrainConfig:
        """Return a copy with every default filled in and every value checked; raises UserError."""
        from inclined_landing.envs.policy import trained_options
        from inclined_landing.envs.tasks import import_task, is_path, task_class

        schema.check(self, None, flag_of)
        config = dataclasses.replace(self, task=self.task or "landing")
        kind = import_task(config.task) if is_path(config.task) else task_class(config.task)
        try:
            kind.training.check()
        except UserError as error:  # of a task of one's own
            raise UserError(f"task {shown(config.task, 60)}, its training: {error}") from error
        for name in config.task_options():
            if name not in kind.option_names():
                raise UserError(f"{flag_of(name)} does not apply to the task {kind.name}")

        # In the plane, unless the task draws vehicles in space alone and nothing asks for the plane.
        dimensions, start = config.dimensions, config.start_from
        if dimensions is None and not config.nominal and kind.draws_vehicles_in == (3,):
            in_space = start in (None, DESCENT) or trained_options(start).get("dimensions") == 3
            dimensions = 3 if in_space else None

        if config.nominal and config.randomise is not None:
            raise UserError("--nominal and --randomise cannot be combined")
        usual = _usual(config, kind, dimensions or 2)
        randomise = config.randomise or usual.randomise

        values = _with_defaults(config, usual)

        # Training that continues from a policy keeps its actions and network; in the same task, its history.
        policy = None if values["start_from"] == DESCENT else values["start_from"]
        same_task = _is_of(policy, kind)
        before = trained_options(policy) if policy is not None and same_task else {}
        values |= _ending(config, usual)
        if same_task and config.history is None:
            values["history"] = before.get("history", 0)
        values["observe_vehicle"] = config.observe_vehicle or bool(before.get("observe_vehicle"))
        values |= _action_map(config, policy, usual.all_commands)
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

    @property
    def is_planar(self) -> bool:
        """Whether vehicles fly in a plane, or in a task without a choice of dimensions."""
        return self.dimensions != 3

    @property
    def folder(self) -> Path:
        """The run folder of a resolved configuration."""
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
        """Return the files that the run copies, by the name of the copy."""
        from inclined_landing.envs.policy import locate as locate_policy
        from inclined_landing.envs.randomise import locate

        files = {}
        if self.vehicle is not None:
            files[COPIED["vehicle"]] = locate_vehicle(self.vehicle)
        if self.randomise is not None:
            files[COPIED["randomise"]] = locate(self.randomise)
        if self.start_from not in (None, DESCENT):
            files[COPIED["start_from"]] = locate_policy(self.start_from)
        return files

    @property
    def per_iteration(self) -> int:
        """Number of environment steps in an iteration of a resolved configuration."""
        assert self.environments is not None and self.rollout is not None
        return self.environments * self.rollout

    def most_steps(self) -> int:
        """Number of environment steps after which a run of a resolved configuration ends in any case."""
        most = self.max_steps if self.steps is None else self.steps
        assert most is not None
        return most

    def least_steps(self, task: type[Task] | Task) -> int:
        """Number of environment steps before which a resolved run of a task does not end by success."""
        usual = MIN_STEPS_CONTINUED if _is_of(self.start_from, task) else task.training.min_steps
        return min(usual, self.most_steps())

    def as_json(self) -> dict:
        """Return the configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", *COPIED) if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths | {"net_arch": list(self.net_arch or ())}


# --- resolving --------------------------------------------------------------------------------------


def _is_of(policy: str | None, task: type[Task] | Task) -> bool:
    """Return whether there is a policy to start from, and it is one of this task."""
    from inclined_landing.envs.policy import trained_task

    return policy not in (None, DESCENT) and trained_task(policy) == task.name


def _with_defaults(config: TrainConfig, usual: Training) -> dict[str, Any]:
    """Return the options that have a default in `usual`, as given or by default; ENDING and ranges apart."""
    names = {field.name for field in dataclasses.fields(config)} - {"randomise"}
    given = {name: getattr(config, name) for name in names & set(vars(usual))}
    merged = dataclasses.replace(usual, **{name: x for name, x in given.items() if x is not None})
    schema.check(merged, None, flag_of)
    return {name: getattr(merged, name) for name in given if name not in ENDING}


def _usual(config: TrainConfig, kind: type[Task], dimensions: int) -> Training:
    """Return the defaults of a task in the case that the options select."""
    from inclined_landing.envs.tasks.training import in_case

    is_drawn = dimensions in kind.draws_vehicles_in and config.fastest is None and not config.nominal
    case = kind.training_case
    if case == "touchdown":
        case = "touchdown" if dimensions == 3 else "touchdown-2d"
    elif is_drawn and dimensions == 3:
        case = "drawn-space"
    elif is_drawn and (config.randomise is not None or config.steepest is not None):
        case = "drawn-slopes"
    elif is_drawn:
        case = "drawn" if config.start_from is None else "drawn-from"
    training = in_case(kind.training, kind.training_case, case)
    if config.nominal:
        training = dataclasses.replace(training, randomise=None, history=0, all_commands=False)
    elif config.fastest is not None:
        training = dataclasses.replace(training, randomise=None)
    if (config.randomise or training.randomise) and (config.steps is not None or training.success is None):
        # No evaluation ends a run of a fixed length, so that fewer are enough.
        training = dataclasses.replace(training, evaluate_every=SELDOM)
    return training


def _ending(config: TrainConfig, training: Training) -> dict[str, Any]:
    """Return the fields in ENDING that define the end of the run."""
    chosen = [flag_of(name) for name in ENDING[1:] if getattr(config, name) is not None]
    if config.steps is not None:
        if chosen:
            raise UserError(f"--steps fixes the length of the run and cannot be combined with {chosen[0]}")
        return {}
    if training.success is None:
        if chosen:
            from inclined_landing.envs.tasks import TASKS

            by_success = " and ".join(task.name for task in TASKS.values() if task.training.success)
            raise UserError(
                f"{chosen[0]} is only for the task {by_success}; a run of {config.task} takes --steps"
            )
        return {"steps": training.steps}
    if config.evaluate_every == 0:
        raise UserError("--evaluate-every 0 needs --steps, because without evaluations nothing ends the run")
    return {
        "success": training.success if config.success is None else config.success,
        "max_steps": training.max_steps if config.max_steps is None else config.max_steps,
    }


def _action_map(config: TrainConfig, policy: str | None, all_commands: bool) -> dict[str, Any]:
    """Return `pwm_centre` and `pwm_span`, which are those of the policy to start from, if there is one."""
    from inclined_landing.envs.policy import action_map, trained_options

    centre: float | str | None = config.pwm_centre
    span = config.pwm_span
    if policy is not None and (centre is None or span is None):
        before = action_map(trained_options(policy))
        centre = before[0] if centre is None else centre
        span = before[1] if span is None else span
    if all_commands and centre is None and span is None:
        low, high = load_vehicle(config.vehicle).command_pwm_range
        centre, span = 0.5 * (low + high), 0.5 * (high - low)
    if span is None:
        span = load_vehicle(config.vehicle).command_pwm_span
    return {"pwm_centre": "hover" if centre is None else centre, "pwm_span": span}


def _net_arch(policy: str | None) -> list[int]:
    """Return the widths of the hidden layers of a policy's actor; none without a policy."""
    from inclined_landing.envs.policy import read_policy

    return [] if policy is None else [len(bias) for bias in read_policy(policy)[1]["biases"][:-1]]
