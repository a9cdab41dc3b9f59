"""What a training run is made of: one line per field, written to the run folder as it was resolved."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.tasks import TASKS, task_class
from inclined_landing.envs.tasks.base import Training
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import PLANTS
from inclined_landing.models.scene import INTEGRATORS

# A field of `envs.tasks.base.Training` that is left at None becomes what the task says there.
_OF_THE_TASK = tuple(field.name for field in dataclasses.fields(Training))


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3 PPO; everything lands in one run folder."""

    task: tyro.conf.Positional[str] = "landing"
    """landing, setpoint or touchdown."""
    out: Path | None = None
    """Run folder (default: runs/TASK-seed)."""
    seed: int = 0
    """Of the policy, the starts and the minibatches; periodic evaluation uses starts of its own."""
    steps: int | None = None
    """Environment steps, fixed beforehand (default: 1 200 000 landing, 1 000 000 setpoint,
    1 500 000 touchdown)."""
    start_from: Annotated[str | None, tyro.conf.arg(name="from", metavar="POLICY")] = None
    """touchdown: the landing policy to go on from, a file or a shipped one (default: landing)."""
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML), where it differs from the shipped one; the run keeps a copy."""
    max_seconds: float | None = None
    """Stop at this wall time; the checkpoint allows to resume."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; task and all else are those of the run."""
    report: bool = True
    """After training: success table, learning curves, figures and the landing video."""

    plant: str = "mujoco"
    """mujoco or analytic."""
    integrator: str | None = None
    """Of the MuJoCo plant while training, 4 ms steps (default: implicitfast, touchdown RK4, in which
    springy contact comes to rest); evaluation always uses RK4."""
    keep_out: float | None = None
    """Sensor-only zone around the platform that counts as obstacle while training [m] (default: 0.04,
    touchdown 0)."""
    threads: int = 0
    """Physics threads (0: all cores)."""

    curriculum: str | None = None
    """landing: adaptive (default), paper or none; setpoint: effort (default) or none; touchdown:
    touchdown."""
    pwm_centre: str = "hover"
    """PWM at action 0: hover (of the equations) or paper (42 000)."""

    environments: int = 64
    """Vehicles stepped together."""
    rollout: int = 128
    """Steps of each vehicle between updates."""
    batch_size: int = 512
    """Samples in a minibatch."""
    epochs: int | None = None
    """Passes over each rollout (default: 5, setpoint 8)."""
    learning_rate: float | None = None
    """Initial; the curriculum says when it falls (default: 1e-3, touchdown 4e-4)."""
    gamma: float | None = None
    """Discount (default: 0.99, setpoint 0.97); the paper's curriculum sets its own."""
    gae_lambda: float = 0.95
    """Of the advantage estimate."""
    log_std_init: float | None = None
    """Logarithm of the initial exploration noise (default: -0.4, touchdown -1.2)."""
    entropy: float = 0.0
    """Entropy bonus."""
    reward_scale: float = 0.1
    """Rewards are multiplied by this before PPO sees them."""

    evaluate_every: int = 20
    """Iterations between evaluations in the plain plant (0: never)."""
    checkpoint_every: int = 20
    """Iterations between checkpoints."""
    video_every: int = 50
    """Iterations between videos of one flight, as in the paper (0: never)."""

    def resolved(self) -> TrainConfig:
        """A copy with every default filled in and every value checked; raises UserError."""
        training = task_class(self.task).training
        if self.plant not in PLANTS:
            raise UserError(f"unknown plant {self.plant!r}; known are {' and '.join(PLANTS)}")
        if self.integrator not in (None, *INTEGRATORS):
            known = ", ".join(INTEGRATORS)
            raise UserError(f"unknown integrator {self.integrator!r}; known are {known}")
        if self.start_from is not None and training.start_from is None:
            known = " and ".join(task.name for task in TASKS.values() if task.training.start_from)
            raise UserError(f"--from is for the {known} task; {self.task} is learned from nothing")
        given = {name: getattr(self, name) for name in _OF_THE_TASK}
        filled = {k: getattr(training, k) if value is None else value for k, value in given.items()}
        out = self.out or Path("runs") / f"{self.task}-{self.seed}"
        config = dataclasses.replace(self, out=out, **filled)
        for field in dataclasses.fields(config):
            value = getattr(config, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise UserError(f"--{field.name.replace('_', '-')} must be a finite number, not {value}")
        positive = ("steps", "environments", "rollout", "batch_size", "epochs", "checkpoint_every")
        for name in positive:
            if getattr(config, name) < 1:
                raise UserError(f"--{name.replace('_', '-')} must be at least 1")
        for name in ("evaluate_every", "video_every", "threads", "seed"):
            if getattr(config, name) < 0:
                raise UserError(f"--{name.replace('_', '-')} must not be negative")
        if not 0 < config.gamma < 1 or not 0 <= config.gae_lambda <= 1:
            raise UserError("--gamma must lie between 0 and 1, --gae-lambda from 0 to 1")
        if config.learning_rate <= 0 or (config.max_seconds is not None and config.max_seconds <= 0):
            raise UserError("--learning-rate and --max-seconds must be positive")
        if config.environments * config.rollout % config.batch_size == 1:
            raise UserError("--batch-size leaves a last minibatch of one sample; choose another")
        return config

    def as_json(self) -> dict:
        """The configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", "vehicle") if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths
