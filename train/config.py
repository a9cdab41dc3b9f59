"""What a training run is made of: one line per field, written to the run folder as it was resolved."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from msgspec import Meta

from inclined_landing.envs.policy import (
    action_map,
    dimensions_of,
    history_length,
    observes_vehicle,
    trained_task,
)
from inclined_landing.envs.randomise import locate
from inclined_landing.envs.shared.options import Seed, flag_of
from inclined_landing.envs.tasks import TASKS, Task, import_task, is_path, task_class
from inclined_landing.envs.tasks.options import Many, Record, Share, TaskOptions, Training, fields_of, option
from inclined_landing.models import schema
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle, locate_vehicle
from inclined_landing.models.plants import PLANTS
from inclined_landing.models.scene import INTEGRATORS
from inclined_landing.train import descent
from inclined_landing.train.curriculum import RISING

# A field of `envs.tasks.options.Training` that is left at None becomes what the task says there.
_OF_THE_TASK = tuple(field.name for field in dataclasses.fields(Training))
_TASK_OPTIONS = tuple(task.options_type for task in TASKS.values())
# Files of which a run keeps a copy, and its name there.
COPIED = {"vehicle": "vehicle.toml", "randomise": "randomise.toml"}
# Those that say when a run ends: the first alone, or the others.
ENDING = ("steps", "success", "min_steps", "max_steps")
UPDATES = ("fast", "stock")


@dataclasses.dataclass(frozen=True)
class OnPolicy(Record):
    """Options that only ppo has."""

    gae_lambda: Share = option(0.95, "Of the advantage estimate")
    entropy: Share = option(0.0, "Entropy bonus; sac finds its own")
    update: str = option(
        "fast",
        "fast (PPO compiled for these networks) or stock (Stable-Baselines3's own): the same loss and files",
        more={"metavar": "{fast,stock}"},
    )
    checkpoint_every: Many = option(20, "Iterations between checkpoints")


@dataclasses.dataclass(frozen=True)
class ReplayBuffer(Record):
    """Options of algorithms with a replay buffer."""

    buffer_size: Many = option(300_000, "Samples in the replay buffer, the latest ones")
    learning_starts: Annotated[int, Meta(ge=0, le=10**9)] = option(
        5_000, "Environment steps with random actions before the first update"
    )
    gradient_steps: Annotated[int, Meta(ge=1, le=16_384)] = option(
        2, "Updates after each step of all vehicles"
    )


@dataclasses.dataclass(frozen=True)
class TD3(ReplayBuffer):
    """Options of td3."""

    action_noise: Share = option(0.2, "Standard deviation of the noise on actions")


# Options of one kind of algorithm, and what they are where they are not given; None: what the task says.
_ON_POLICY = dict.fromkeys(("start_from", "epochs", "log_std_init")) | dataclasses.asdict(OnPolicy())
# By algorithm: the options that others refuse.
ALGORITHMS: dict[str, dict] = {
    "ppo": _ON_POLICY,
    "sac": dataclasses.asdict(ReplayBuffer()),
    "td3": dataclasses.asdict(TD3()),
}
_REPLAYED = {"learning_rate": 1e-3, "batch_size": 256}  # of those with a replay buffer, not the task's
# Rewards are multiplied by this. SAC's are small beside its price of entropy otherwise.
REWARD_SCALE = {"ppo": 0.1, "sac": 1.0, "td3": 0.1}

ROBUST, DRAWN_HISTORY = "robust", 3  # ranges, and past steps to tell a vehicle by, of tasks on drawn vehicles
DRAWN_STEPS = 700_000  # min_steps more on drawn vehicles
# In space, where drawn vehicles differ in more: with the rates of the plane one of three seeds learned it.
DRAWN_IN_SPACE = {"rollout": 128, "learning_rate": 1e-3}
# Touchdown in the plane begins with a landing policy, and explores more.
IN_THE_PLANE: dict[str, Any] = {
    **{"start_from": "landing-nominal", "learning_rate": 4e-4, "log_std_init": -1.2, "gamma": 0.99},
    **{"steps": 1_500_000, "environments": 64, "batch_size": 512},
}
EVALUATE_EVERY = (16, 32)  # iterations, on one vehicle and on drawn ones
CARRIED_ON = 100_000  # min_steps of a run that goes on from a policy of its own task


_TASK = tyro.conf.arg(
    metavar="[TASK]", help=f"{', '.join(TASKS)}, or one of your own: module:Class or file.py:Class."
)
_WORDS = {
    "curricula": "; ".join(f"{name}: {', '.join(task.curricula)}" for name, task in TASKS.items()),
    "start": f"{descent.NAME}: the law that touchdown in space begins with",
}


def _as_options(*records: type[Record]) -> dict[str, tuple[Any, Any]]:
    """Return annotation and default of an option for each field of records that has a help text.

    The default is None, but for flags: what is not given is left to the task or the algorithm.
    """
    found = {}
    for field, known, kind in fields_of(*records):
        more: dict[str, Any] = {"help": known.help.format(**_WORDS)} | known.more
        if not issubclass(records[0], TaskOptions):
            more |= {"help": f"{more['help']}.", "help_behavior_hint": f"(default: {_defaults(field.name)})"}
        flag = kind is bool
        if known.help:
            kind = kind if flag else (known.kind or kind) | None
            found[field.name] = Annotated[kind, tyro.conf.arg(**more)], False if flag else None
    return found


def _defaults(name: str) -> str:
    """Return what the algorithms, or the tasks that it is for, say of an option."""
    having = [algorithm for algorithm, own in ALGORITHMS.items() if name in own]
    if name not in _OF_THE_TASK:
        return f"{ALGORITHMS[having[0]][name]}; of {' and '.join(having)} only"
    by_success = name in ("min_steps", "max_steps")
    tasks = [task for task in TASKS.values() if task.training.success or not by_success]
    said = [(task.name, getattr(task.training, name)) for task in tasks]
    return ", ".join(f"{task} {default}" for task, default in said if default is not None)


_GIVEN = _as_options(Training)
_OF_TASKS = _as_options(*_TASK_OPTIONS)
_OF_EVERY_TASK = {field.name: _OF_TASKS.pop(field.name) for field in dataclasses.fields(TaskOptions)}
# Options that records make, each group after a field of the configuration.
_GROUPS = {
    "seed": {name: _GIVEN.pop(name) for name in (*ENDING, "start_from")} | _OF_TASKS | _OF_EVERY_TASK,
    "without": _GIVEN | _as_options(OnPolicy, TD3),
}


def _with_groups(config: type) -> type:
    """Return the class with the fields of `_GROUPS` in their places."""
    own, config.__annotations__ = config.__annotations__, {}
    for name, hint in own.items():
        config.__annotations__[name] = hint
        for field, (kind, default) in _GROUPS.get(name, {}).items():
            config.__annotations__[field] = kind
            setattr(config, field, default)
    return config


@dataclasses.dataclass
@_with_groups
class TrainConfig:
    """Train a policy with Stable-Baselines3; everything lands in one run folder.

    Where the task names a share of successes, the run ends when the curriculum is complete and two
    evaluations in a row reach it, each from 256 starts of its own. One that ends without exits with code 3;
    wrong input with 2.

    `landing-train sweep RECIPE` runs the command lines of a recipe for every seed.
    """

    task: Annotated[tyro.conf.Positional[str], _TASK] = "landing"
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder (default: runs/TASK-seed)."""
    seed: Seed = 0
    """Of the policy, the starts and the minibatches, not of periodic evaluation."""
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML), or a shipped vehicle by name, where it is not the Crazyflie 2.1; the run keeps a
    copy."""
    randomise: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges (TOML, or a shipped name) that each episode's vehicle is drawn from (default: landing and
    touchdown, robust)."""
    nominal: bool = False
    """As in the paper: one vehicle in the plane, no history, actions around hover."""
    max_seconds: Annotated[float, Meta(gt=0, lt=10**9)] | None = None
    """Stop at this wall time; the checkpoint allows to resume."""
    max_cpu_seconds: Annotated[float, Meta(gt=0, lt=10**9)] | None = None
    """Stop after so much computing for the training, on all cores together and without evaluations: unlike
    wall time, other work on the machine does not use it up."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; task and all else are those of the run."""
    report: bool = True
    """After training: success table, learning curves, figures, a picture and a video of one flight."""

    algorithm: Annotated[str, tyro.conf.arg(metavar="{ppo,sac,td3}")] = "ppo"
    """ppo; sac or td3 with a replay buffer: one step of all vehicles, then the updates. Runs with a replay
    buffer cannot be resumed."""
    plant: Annotated[str, tyro.conf.arg(metavar="{mujoco,hybrid,analytic}")] = "hybrid"
    """mujoco; hybrid: the same with the equations in free flight; or analytic."""
    threads: Annotated[int, Meta(ge=0, le=1024)] = 0
    """Physics threads (0: all cores)."""

    without: Annotated[str | None, tyro.conf.arg(metavar="PART[,PART...]")] = None
    """Parts of the landing's curriculum to leave out: start, tilt, motion, goal and platform are the task's
    from the first step on; without departure, a vehicle that leaves is cut and pays nothing."""
    reward_scale: Annotated[
        Annotated[float, Meta(gt=0, lt=1000)] | None,
        tyro.conf.arg(help_behavior_hint="(default: 0.1; sac 1)"),
    ] = None
    """Rewards are multiplied by this before the algorithm sees them."""

    evaluate_every: Annotated[
        Annotated[int, Meta(ge=0, le=10**9)] | None,
        tyro.conf.arg(help_behavior_hint="(default: 16; on drawn vehicles 32)"),
    ] = None
    """Iterations between evaluations in the hybrid plant, without training aids (0: never)."""
    video_every: Annotated[int, Meta(ge=0, le=10**9)] = 0
    """Iterations between videos of one flight (0: never); each takes as long as some 100 000 steps."""

    if TYPE_CHECKING:  # the fields that `_GROUPS` adds

        def __getattr__(self, name: str) -> Any: ...
        def __setattr__(self, name: str, value: Any) -> None: ...

    def resolved(self) -> TrainConfig:
        """A copy with every default filled in and every value checked; raises UserError."""
        schema.check(self, None, flag_of)
        kind = import_task(self.task) if is_path(self.task) else task_class(self.task)
        if self._is_in_space_by_default(kind):
            self = dataclasses.replace(self)
            self.dimensions = 3
        training = kind.training
        try:
            schema.check(training)
        except UserError as error:  # of a task of one's own
            raise UserError(f"task {shown(self.task, 60)}, its training: {error}") from error
        if self.plant not in PLANTS:
            raise UserError(f"unknown plant {shown(self.plant, 40)!r}; known are {', '.join(PLANTS)}")
        if self.integrator not in (None, *INTEGRATORS):
            known = ", ".join(INTEGRATORS)
            raise UserError(f"unknown integrator {shown(self.integrator, 40)!r}; known are {known}")
        if self.update not in (None, *UPDATES):
            raise UserError(f"unknown update {shown(self.update, 40)!r}; known are {' and '.join(UPDATES)}")
        own = self._of_the_algorithm(kind)
        own["reward_scale"] = REWARD_SCALE[self.algorithm]
        given = {name: getattr(self, name) for name in _OF_THE_TASK if name not in ENDING}
        is_drawn = (self.dimensions or 2) in kind.drawn_vehicles
        drawn = is_drawn and self.fastest is None and not self.nominal  # over moving platforms one vehicle
        by_descent = training.start_from == descent.NAME and self.dimensions == 3
        if training.start_from == descent.NAME and not by_descent:
            training = dataclasses.replace(training, **IN_THE_PLANE)
        # What tells a vehicle, or a platform's motion: past steps, and actions for more and less thrust.
        tells = drawn or (by_descent and not self.nominal)
        defaults = {name: getattr(training, name) for name in given} | own
        if drawn and self.dimensions == 3 and self.algorithm == "ppo" and not by_descent:
            defaults |= DRAWN_IN_SPACE
        filled = {k: value if getattr(self, k) is None else getattr(self, k) for k, value in defaults.items()}
        for name in self.task_options():
            if name not in kind.option_names():
                raise UserError(f"{flag_of(name)} is no option of the task {kind.name}")
        _check_gamma(self.gamma)
        start = None if filled["start_from"] == descent.NAME else filled["start_from"]
        same = start if start is not None and trained_task(start) == kind.name else None
        least = training.min_steps if same is None else CARRIED_ON
        out = Path(self.out or f"runs/{kind.name}-{self.seed}")
        vehicle = None if self.vehicle is None else Path(self.vehicle)
        if self.nominal and self.randomise is not None:
            raise UserError("--nominal trains on one vehicle, and --randomise draws many: leave one out")
        ranges = ROBUST if drawn and self.randomise is None else self.randomise
        randomise = None if ranges is None else Path(ranges)
        if self.evaluate_every is None:
            filled["evaluate_every"] = EVALUATE_EVERY[randomise is not None]
        filled |= self._ending(training, least + (DRAWN_STEPS if randomise is not None else 0))
        if self.history is None:
            filled["history"] = history_length(same) if same is not None else DRAWN_HISTORY if tells else 0
        filled["observe_vehicle"] = self.observe_vehicle or (same is not None and observes_vehicle(same))
        filled |= self._action_map(start, tells)
        config = dataclasses.replace(self, out=out, vehicle=vehicle, randomise=randomise, **filled)
        if config.algorithm != "ppo":
            config._check_buffer()
            return config
        samples = config.environments * config.rollout
        if samples == 1:
            raise UserError("--environments and --rollout must give more than one sample")
        config.batch_size = min(config.batch_size, samples)
        if samples % config.batch_size == 1:
            raise UserError("--batch-size leaves a last minibatch of one sample; choose another")
        return config

    def _is_in_space_by_default(self, kind: type[Task]) -> bool:
        """Return whether three dimensions are meant: of a task that draws vehicles nowhere else."""
        if self.dimensions is not None or self.nominal or kind.drawn_vehicles != (3,):
            return False
        return self.start_from in (None, descent.NAME) or dimensions_of(self.start_from) == 3

    @property
    def folder(self) -> Path:
        """The run folder; of a resolved configuration."""
        assert self.out is not None
        return self.out

    @property
    def resumable(self) -> bool:
        """Are there checkpoints to go on from: a replay buffer is not kept."""
        return self.algorithm == "ppo"

    def _of_the_algorithm(self, kind: type[Task]) -> dict:
        """Defaults that are the algorithm's and not the task's; raises UserError for options of another."""
        if self.algorithm not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise UserError(f"unknown algorithm {shown(self.algorithm, 40)!r}; known are {known}")
        own = ALGORITHMS[self.algorithm]
        for name in sorted({*itertools.chain(*ALGORITHMS.values())} - set(own)):
            if getattr(self, name) is not None:
                others = " and ".join(algorithm for algorithm, has in ALGORITHMS.items() if name in has)
                raise UserError(
                    f"{flag_of(name)} is an option of {others}, which {self.algorithm} does not have"
                )
        if self.algorithm == "ppo":
            return {name: default for name, default in own.items() if default is not None}
        if kind.training.start_from is not None:
            raise UserError(
                f"--algorithm {self.algorithm}: training of the task {kind.name} goes on from a policy, "
                "which only ppo does"
            )
        return dict.fromkeys(_ON_POLICY) | own | _REPLAYED

    def _check_buffer(self) -> None:
        """Raise UserError where the replay buffer cannot hold what it has to; of a resolved configuration."""
        least = max(self.environments, self.batch_size)
        if self.buffer_size < least:
            raise UserError(
                f"--buffer-size must be {least} or more, for a step of each vehicle and for a minibatch"
            )
        if (self.learning_starts or 0) >= self.most_steps():
            raise UserError(
                f"--learning-starts {self.learning_starts} leaves nothing of {self.most_steps()} steps "
                "to learn in"
            )

    def _action_map(self, start_from: str | None, drawn: bool) -> dict:
        """What actions command, filled in: as in the policy to go on from, so that it flies as before.

        On drawn vehicles it is the whole range of commands, as some need much more thrust than others.
        """
        centre, span = self.pwm_centre, self.pwm_span
        if start_from is not None and (centre is None or span is None):
            own = action_map(start_from)
            centre, span = (mine if given is None else given for mine, given in zip(own, (centre, span)))
        if drawn and centre is None and span is None:
            low, high = load_vehicle(self.vehicle).command_pwm_range
            centre, span = 0.5 * (low + high), 0.5 * (high - low)
        if span is None:
            span = load_vehicle(self.vehicle).command_pwm_span
        return {"pwm_centre": "hover" if centre is None else centre, "pwm_span": span}

    def _ending(self, training: Training, least: int) -> dict:
        """When the run ends: the fields in ENDING, filled in; `least`: the usual min_steps."""
        given = [flag_of(name) for name in ENDING[1:] if getattr(self, name) is not None]
        if self.steps is not None:
            if given:
                raise UserError(f"--steps fixes how long the run is; {given[0]} goes without it")
            return {}
        if training.success is None:
            if given:
                known = " and ".join(task.name for task in TASKS.values() if task.training.success)
                raise UserError(
                    f"{given[0]} is for the {known} task; a run of {self.task} is fixed by --steps"
                )
            return {"steps": training.steps}
        if self.evaluate_every == 0:
            raise UserError("--evaluate-every 0 goes with --steps: without evaluations nothing ends the run")
        low, high = self.min_steps, self.max_steps
        if low is not None and high is not None and low > high:
            raise UserError(f"--min-steps {low} is more than --max-steps {high}")
        return {
            "success": training.success if self.success is None else self.success,
            "min_steps": min(least, high or least) if low is None else low,
            "max_steps": max(training.max_steps, low or 0) if high is None else high,
        }

    def task_options(self) -> dict[str, Any]:
        """Return the options of the task that are given, angles in rad."""
        given = {}
        for field, known, _ in fields_of(*_TASK_OPTIONS):
            value = getattr(self, field.name) if known.help else None
            if value is not None and value is not False:
                given[field.name] = math.radians(value) if known.degrees else value
        return given

    def copied(self) -> dict[str, Path]:
        """Of what the run keeps a copy, by the copy's name."""
        given = {
            "vehicle": self.vehicle and locate_vehicle(self.vehicle),
            "randomise": self.randomise and locate(self.randomise),
        }
        return {COPIED[name]: path for name, path in given.items() if path is not None}

    def most_steps(self) -> int:
        """Environment steps after which the run ends in any case; of a resolved configuration."""
        return self.max_steps if self.steps is None else self.steps

    def as_json(self) -> dict:
        """The configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", *COPIED) if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths


def _check_gamma(gamma: float | str | None) -> None:
    if gamma is None or gamma == RISING:
        return
    if isinstance(gamma, str):
        raise UserError(f"--gamma must be a number above 0 and below 1, or {RISING}, not {shown(gamma, 40)}")


# Pages of --help, by title: what people change, which --help shows alone, and the rest.
HELP = {
    "options": (
        *("task", "out", "seed", "steps", "start_from", "algorithm", "plant", "vehicle", "randomise"),
        *("nominal", "inclination", "steepest", "dimensions", "resume", "report"),
    ),
    "task: slopes, moving platforms, curriculum": (
        *("random_yaw", "fastest", "swell", "angle_limit", "pwm_centre", "pwm_span", "observe_vehicle"),
        *("keep_out", "curriculum", "without"),
    ),
    "run: how long, how often, on what": (
        *("success", "min_steps", "max_steps", "max_seconds", "max_cpu_seconds", "evaluate_every"),
        *("checkpoint_every", "video_every", "environments", "threads", "integrator"),
    ),
    "learning": (
        *("rollout", "batch_size", "epochs", "learning_rate", "gamma", "gae_lambda", "log_std_init"),
        *("entropy", "update", "buffer_size", "learning_starts", "gradient_steps", "action_noise"),
        *("reward_scale", "history"),
    ),
}
