"""What a training run is made of: one line per field, written to the run folder as it was resolved."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import math
import numbers
import types
import typing
from pathlib import Path
from typing import Annotated, Any

import tyro

from inclined_landing.envs.policy import SHIPPED, action_map, history_length, observes_vehicle, trained_task
from inclined_landing.envs.randomise import locate
from inclined_landing.envs.tasks import TASKS, import_task, is_path, task_class
from inclined_landing.envs.tasks.base import LONGEST_HISTORY, Training
from inclined_landing.eval.base.options import Range, Seed, check_ranges
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle, locate_vehicle
from inclined_landing.models.plants import PLANTS
from inclined_landing.models.scene import INTEGRATORS
from inclined_landing.train import descent
from inclined_landing.train.curriculum import RISING

# A field of `envs.tasks.base.Training` that is left at None becomes what the task says there.
_OF_THE_TASK = tuple(field.name for field in dataclasses.fields(Training))
# Files of which a run keeps a copy, and its name there.
COPIED = {"vehicle": "vehicle.toml", "randomise": "randomise.toml"}
# Those that say when a run ends: the first alone, or the others.
ENDING = ("steps", "success", "min_steps", "max_steps")
UPDATES = ("fast", "stock")

# Options of one kind of algorithm, and what they are where they are not given; None: what the task says.
_ON_POLICY = {
    **dict.fromkeys(("start_from", "epochs", "log_std_init")),
    **{"gae_lambda": 0.95, "entropy": 0.0, "update": "fast", "checkpoint_every": 20},
}
_OFF_POLICY = {"buffer_size": 300_000, "learning_starts": 5_000, "gradient_steps": 2}
# By algorithm: the options that others refuse.
ALGORITHMS: dict[str, dict] = {
    "ppo": _ON_POLICY,
    "sac": _OFF_POLICY,
    "td3": _OFF_POLICY | {"action_noise": 0.2},
}
_REPLAYED = {"learning_rate": 1e-3, "batch_size": 256}  # of those with a replay buffer, not the task's
# Rewards are multiplied by this. SAC's are small beside its price of entropy otherwise.
REWARD_SCALE = {"ppo": 0.1, "sac": 1.0, "td3": 0.1}

CARRIED_ON = 100_000  # min_steps of a run that goes on from a policy of its own task

_MANY = Range(1, 10**9)
_INTERVAL = Range(0, 10**9)


def _by_task(text: str, name: str, **more: str):
    """Help of an option that is the task's to fill in: a text, and what the tasks say."""
    said = [(task.name, getattr(task.training, name)) for task in TASKS.values()]
    defaults = ", ".join(f"{task} {value}" for task, value in said if value is not None)
    return tyro.conf.arg(help=f"{text}.", help_behavior_hint=f"(default: {defaults})", **more)


def _by_algorithm(text: str, name: str):
    """The same of an option that some algorithms do not have."""
    having = [algorithm for algorithm, own in ALGORITHMS.items() if name in own]
    default = ALGORITHMS[having[0]][name]
    return tyro.conf.arg(
        help=f"{text}.", help_behavior_hint=f"(default: {default}; of {' and '.join(having)} only)"
    )


def _by_success(text: str, name: str):
    """The same of an option for the tasks whose runs end by success."""
    said = [(task.name, getattr(task.training, name)) for task in TASKS.values() if task.training.success]
    return tyro.conf.arg(
        help=f"{text}.", help_behavior_hint=f"(default: {', '.join(f'{task} {n}' for task, n in said)})"
    )


_TASK = tyro.conf.arg(
    metavar="[TASK]", help=f"{', '.join(TASKS)}, or one of your own: module:Class or file.py:Class."
)
_CURRICULA = "; ".join(f"{name}: {', '.join(task.curricula)}" for name, task in TASKS.items())


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3; everything lands in one run folder.

    Where the task names a share of successes, the run ends when the curriculum is complete and two
    evaluations in a row reach it, each from 256 starts of its own. One that ends without exits with code 3;
    wrong input with 2.

    `landing-train sweep RECIPE` trains and judges what a recipe says, for every seed.
    """

    task: Annotated[tyro.conf.Positional[str], _TASK] = "landing"
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder (default: runs/TASK-seed)."""
    seed: Seed = 0
    """Of the policy, the starts and the minibatches; periodic evaluation uses starts of its own."""
    steps: Annotated[int | None, _MANY, _by_task("Environment steps, fixed beforehand", "steps")] = None
    success: Annotated[
        float | None,
        Range(0, 1),
        _by_task("Share of successes, in two evaluations in a row, that ends the run", "success"),
    ] = None
    min_steps: Annotated[
        int | None, _INTERVAL, _by_success("Environment steps that such a run has at least", "min_steps")
    ] = None
    max_steps: Annotated[
        int | None, _MANY, _by_success("Environment steps that such a run has at most", "max_steps")
    ] = None
    start_from: Annotated[
        str | None,
        tyro.conf.arg(name="from", metavar="POLICY"),
        _by_task(
            f"The policy to go on from, a file or one of {', '.join(SHIPPED)}; {descent.NAME}: the law that "
            "touchdown on moving decks begins with",
            "start_from",
        ),
    ] = None
    inclination: Annotated[float | None, Range(-90, 90), tyro.conf.arg(metavar="DEG")] = None
    """Of the platform in degrees, where it differs from the vehicle file's."""
    steepest: Annotated[float | None, Range(0, 90, open=True), tyro.conf.arg(metavar="DEG")] = None
    """Every episode has a slope of its own, which the policy observes: up to this inclination in degrees, to
    both sides; in three dimensions to all sides."""
    dimensions: Annotated[int | None, Range(2, 3), tyro.conf.arg(metavar="{2,3}")] = None
    """3: fly in space, with roll, and not in a plane (default: as the task is)."""
    random_yaw: bool = False
    """With three dimensions: every episode begins with a heading of its own."""
    fastest: Annotated[float | None, Range(0, 10), tyro.conf.arg(metavar="M/S")] = None
    """With three dimensions: decks that travel steadily, any way, at up to this speed, which is observed."""
    swell: Annotated[float | None, Range(0, 2)] = None
    """With --fastest: decks that heave, roll and pitch too; 1: by up to 0.24 m and 16 deg (default: 0)."""
    angle_limit: Annotated[float | None, Range(1, 80), tyro.conf.arg(metavar="DEG")] = None
    """Of roll and pitch commands in degrees, where it differs from the vehicle file's."""
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML), or a shipped vehicle by name, where it is not the Crazyflie 2.1; the run keeps a
    copy."""
    randomise: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Ranges (TOML) of effects and of entries of the vehicle file, like [effects.thrust_scale] with
    scale = [0.8, 1.1] or [body] with mass = [0.027, 0.032]; each training episode has a vehicle from them. Or
    `robust`, which is shipped. Half of the evaluated flights have such vehicles too. The run keeps a copy."""
    max_seconds: Annotated[float | None, Range(0, 10**9, open=True)] = None
    """Stop at this wall time; the checkpoint allows to resume."""
    max_cpu_seconds: Annotated[float | None, Range(0, 10**9, open=True)] = None
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
    integrator: Annotated[
        str | None, _by_task("Of the engine in training, 4 ms steps; evaluation uses RK4", "integrator")
    ] = None
    keep_out: Annotated[
        float | None,
        Range(0, 1),
        _by_task("Sensor-only zone around the platform that is an obstacle in training, m", "keep_out"),
    ] = None
    threads: Annotated[int, Range(0, 1024)] = 0
    """Physics threads (0: all cores)."""

    curriculum: Annotated[
        str | None, _by_task(f"What eases the task at first; {_CURRICULA}", "curriculum")
    ] = None
    without: Annotated[str | None, tyro.conf.arg(metavar="PART[,PART...]")] = None
    """Parts of the landing's curriculum to leave out: start, tilt, motion, goal and platform are the task's
    from the first step on; without departure, a vehicle that leaves is cut and pays nothing."""
    pwm_centre: Annotated[
        float | str | None,
        tyro.conf.arg(
            metavar="NUMBER|hover|own|paper", help_behavior_hint="(default: hover; with --from the policy's)"
        ),
    ] = None
    """PWM at action 0: a number, hover (of the vehicle with its effects), own (of each vehicle that
    is drawn, or flown later) or paper (42 000). A policy to go on from is rewritten where it has another."""
    pwm_span: Annotated[
        float | None,
        Range(1, 65_535),
        tyro.conf.arg(
            metavar="NUMBER",
            help_behavior_hint="(default: the vehicle file's, 16500; with --from the policy's)",
        ),
    ] = None
    """PWM from action 0 to action 1: wider, for a vehicle whose motors have lost thrust."""
    history: Annotated[int | None, Range(0, LONGEST_HISTORY)] = None
    """Past steps, observation and action each, that the policy is given besides the observation (default: as
    many as the policy in --from, else 0)."""

    observe_vehicle: bool = False
    """Tell the policy six numbers of each vehicle: thrust to weight, lags, gain, drag, reach. One that goes
    on from a policy that is told them is too."""

    environments: Annotated[int, Range(1, 16_384)] = 64
    """Vehicles stepped together."""
    rollout: Annotated[
        int | None,
        Range(1, 65_536),
        _by_task("Steps of each vehicle in an iteration; ppo updates after it", "rollout"),
    ] = None
    batch_size: Annotated[
        int | None,
        Range(2, 10**9),
        _by_task("Samples in a minibatch, of ppo at most a whole rollout; sac and td3 256", "batch_size"),
    ] = None
    epochs: Annotated[int | None, Range(1, 1000), _by_task("Passes of ppo over each rollout", "epochs")] = (
        None
    )
    learning_rate: Annotated[
        float | None,
        Range(0, 1, open=True),
        _by_task("Initial, the curriculum says when it falls; sac and td3 0.001", "learning_rate"),
    ] = None
    gamma: Annotated[
        float | str | None,
        _by_task(
            "Discount; paper: from 0.97 to 0.99 over 800 000 steps, as in the curriculum paper anyway",
            "gamma",
            metavar="NUMBER|paper",
        ),
    ] = None
    gae_lambda: Annotated[
        float | None, Range(0, 1), _by_algorithm("Of the advantage estimate", "gae_lambda")
    ] = None
    log_std_init: Annotated[
        float | None,
        Range(-10, 2),
        _by_task("Logarithm of the initial exploration noise of ppo", "log_std_init"),
    ] = None
    entropy: Annotated[
        float | None,
        Range(0, 1),
        _by_algorithm("Entropy bonus; sac finds its own", "entropy"),
    ] = None
    update: Annotated[
        str | None,
        tyro.conf.arg(metavar="{fast,stock}", help_behavior_hint="(default: fast; of ppo only)"),
    ] = None
    """fast (PPO compiled for these networks) or stock (Stable-Baselines3's own): the same loss and files."""
    buffer_size: Annotated[
        int | None, _MANY, _by_algorithm("Samples in the replay buffer, the latest ones", "buffer_size")
    ] = None
    learning_starts: Annotated[
        int | None,
        _INTERVAL,
        _by_algorithm("Environment steps with random actions before the first update", "learning_starts"),
    ] = None
    gradient_steps: Annotated[
        int | None,
        Range(1, 16_384),
        _by_algorithm("Updates after each step of all vehicles", "gradient_steps"),
    ] = None
    action_noise: Annotated[
        float | None,
        Range(0, 1),
        _by_algorithm("Standard deviation of the noise on actions", "action_noise"),
    ] = None
    reward_scale: Annotated[
        float | None,
        Range(0, 1000, open=True),
        tyro.conf.arg(help_behavior_hint="(default: 0.1; sac 1)"),
    ] = None
    """Rewards are multiplied by this before the algorithm sees them."""

    evaluate_every: Annotated[int, _INTERVAL] = 16
    """Iterations between evaluations in the hybrid plant, without training aids (0: never)."""
    checkpoint_every: Annotated[
        int | None, _MANY, _by_algorithm("Iterations between checkpoints", "checkpoint_every")
    ] = None
    video_every: Annotated[int, _INTERVAL] = 0
    """Iterations between videos of one flight (0: never); each takes as long as some 100 000 steps."""

    def resolved(self) -> TrainConfig:
        """A copy with every default filled in and every value checked; raises UserError."""
        self._check_types()
        kind = import_task(self.task) if is_path(self.task) else task_class(self.task)
        training = kind.training
        if self.plant not in PLANTS:
            raise UserError(f"unknown plant {shown(self.plant, 40)!r}; known are {', '.join(PLANTS)}")
        if self.integrator not in (None, *INTEGRATORS):
            known = ", ".join(INTEGRATORS)
            raise UserError(f"unknown integrator {shown(self.integrator, 40)!r}; known are {known}")
        if self.update not in (None, *UPDATES):
            raise UserError(f"unknown update {shown(self.update, 40)!r}; known are {' and '.join(UPDATES)}")
        own = self._of_the_algorithm(kind)
        if self.inclination is not None and not kind.has_platform:
            raise UserError(f"--inclination: the task {kind.name} has no inclined platform")
        own["reward_scale"] = REWARD_SCALE[self.algorithm]
        given = {name: getattr(self, name) for name in _OF_THE_TASK if name not in ENDING}
        defaults = {name: getattr(training, name) for name in given} | own
        filled = {k: value if getattr(self, k) is None else getattr(self, k) for k, value in defaults.items()}
        check_ranges(self)
        known = inspect.signature(kind).parameters
        for name in self.slopes():
            if name not in known:
                raise UserError(f"{option(name)} is no option of the task {kind.name}")
        _check_gamma(self.gamma)
        if self.start_from is None and self.fastest is not None and training.start_from is not None:
            filled["start_from"] = descent.NAME
        start = None if filled["start_from"] == descent.NAME else filled["start_from"]
        same = start is not None and trained_task(start) == kind.name
        filled |= self._ending(training, CARRIED_ON if same else training.min_steps)
        out = Path(self.out or f"runs/{kind.name}-{self.seed}")
        vehicle = None if self.vehicle is None else Path(self.vehicle)
        randomise = None if self.randomise is None else Path(self.randomise)
        if self.history is None:
            filled["history"] = history_length(start) if same else 0
        filled["observe_vehicle"] = self.observe_vehicle or (same and observes_vehicle(start))
        filled |= self._action_map(start)
        config = dataclasses.replace(self, out=out, vehicle=vehicle, randomise=randomise, **filled)
        if is_path(self.task):  # which says defaults of its own
            try:
                check_ranges(config)
            except UserError as error:
                raise UserError(f"task {shown(self.task, 60)}, its training: {error}") from error
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

    @property
    def resumable(self) -> bool:
        """Are there checkpoints to go on from: a replay buffer is not kept."""
        return self.algorithm == "ppo"

    def _of_the_algorithm(self, kind: type) -> dict:
        """Defaults that are the algorithm's and not the task's; raises UserError for options of another."""
        if self.algorithm not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise UserError(f"unknown algorithm {shown(self.algorithm, 40)!r}; known are {known}")
        own = ALGORITHMS[self.algorithm]
        for name in sorted({*itertools.chain(*ALGORITHMS.values())} - set(own)):
            if getattr(self, name) is not None:
                others = " and ".join(algorithm for algorithm, has in ALGORITHMS.items() if name in has)
                raise UserError(
                    f"{option(name)} is an option of {others}, which {self.algorithm} does not have"
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
        if self.learning_starts >= self.most_steps():
            raise UserError(
                f"--learning-starts {self.learning_starts} leaves nothing of {self.most_steps()} steps "
                "to learn in"
            )

    def _action_map(self, start_from: str | None) -> dict:
        """What actions command, filled in: as in the policy to go on from, so that it flies as before."""
        centre, span = self.pwm_centre, self.pwm_span
        if start_from is not None and (centre is None or span is None):
            own = action_map(start_from)
            centre, span = (mine if given is None else given for mine, given in zip(own, (centre, span)))
        if span is None:
            span = load_vehicle(self.vehicle).command_pwm_span
        return {"pwm_centre": "hover" if centre is None else centre, "pwm_span": span}

    def _ending(self, training: Training, least: int) -> dict:
        """When the run ends: the fields in ENDING, filled in; `least`: the usual min_steps."""
        given = [option(name) for name in ENDING[1:] if getattr(self, name) is not None]
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

    def slopes(self) -> dict[str, Any]:
        """Options of the task that are given in degrees, or as what they are, of slopes and attitudes."""
        given = {
            "steepest": None if self.steepest is None else math.radians(self.steepest),
            "dimensions": self.dimensions,
            "random_yaw": self.random_yaw or None,
            "fastest": self.fastest,
            "swell": self.swell,
            "angle_limit": None if self.angle_limit is None else math.radians(self.angle_limit),
        }
        return {name: value for name, value in given.items() if value is not None}

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

    def _check_types(self) -> None:
        for name, kind in typing.get_type_hints(TrainConfig).items():
            kinds = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
            value = getattr(self, name)
            if (isinstance(value, bool) and bool not in kinds) or not isinstance(value, _kinds(kinds)):
                words = " or ".join(_KINDS[kind][1] for kind in kinds if kind in _KINDS)
                raise UserError(f"{option(name)} must be {words}, not {shown(repr(value), 40)}")

    def as_json(self) -> dict:
        """The configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", *COPIED) if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths


def _check_gamma(gamma: float | str | None) -> None:
    if gamma is None or gamma == RISING:
        return
    limits = Range(0, 1, open=True)
    if isinstance(gamma, str) or gamma not in limits:
        raise UserError(f"--gamma must lie {limits}, or be {RISING}, not {shown(gamma, 40)}")


# What an annotation takes, and what sentences call it.
_KINDS = {
    bool: (bool, "true or false"),
    int: (numbers.Integral, "a whole number"),
    float: (numbers.Real, "a number"),
    str: (str, "text"),
    Path: ((str, Path), "a path"),
}


def _kinds(kinds: tuple) -> tuple:
    return tuple(_KINDS[kind][0] if kind in _KINDS else kind for kind in kinds)


def option(name: str) -> str:
    """How a field is written on the command line."""
    return "--from" if name == "start_from" else f"--{name.replace('_', '-')}"
