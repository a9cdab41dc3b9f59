"""What a training run is made of: one line per field, written to the run folder as it was resolved."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import tyro

from inclined_landing.envs.tasks import TASKS
from inclined_landing.models.errors import UserError
from inclined_landing.models.plant import PLANTS
from inclined_landing.models.scene import INTEGRATORS


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3 PPO; everything lands in one run folder."""

    task: tyro.conf.Positional[str] = "landing"
    """landing or setpoint."""
    out: Path | None = None
    """Run folder (default: runs/TASK-seed)."""
    seed: int = 0
    """Of the policy, the starts and the minibatches; periodic evaluation uses starts of its own."""
    steps: int | None = None
    """Environment steps, fixed beforehand (default: 1 200 000 landing, 1 000 000 setpoint)."""
    max_seconds: float | None = None
    """Stop at this wall time; the checkpoint allows to resume."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; task and all else are those of the run."""
    report: bool = True
    """After training: success table, learning curves, figures and the landing video."""

    plant: str = "mujoco"
    """mujoco or analytic."""
    integrator: str = "implicitfast"
    """Of the MuJoCo plant while training, 4 ms steps; evaluation always uses RK4."""
    keep_out: float = 0.04
    """Sensor-only zone around the platform that counts as obstacle while training [m]."""
    threads: int = 0
    """Physics threads (0: all cores)."""

    curriculum: str | None = None
    """landing: adaptive (default), paper or none; setpoint: effort (default) or none."""
    pwm_centre: str = "hover"
    """PWM at action 0: hover (of the equations) or paper (42 000)."""

    environments: int = 64
    """Vehicles stepped together."""
    rollout: int = 128
    """Steps of each vehicle between updates."""
    batch_size: int = 512
    """Samples in a minibatch."""
    epochs: int | None = None
    """Passes over each rollout (default: 5 landing, 8 setpoint)."""
    learning_rate: float = 1e-3
    """Initial; the curriculum says when it falls."""
    gamma: float | None = None
    """Discount (default: 0.99 landing, 0.97 setpoint); the paper's curriculum sets its own."""
    gae_lambda: float = 0.95
    """Of the advantage estimate."""
    log_std_init: float = -0.4
    """Logarithm of the initial exploration noise."""
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
        if self.task not in TASKS:
            raise UserError(f"unknown task {self.task!r}; known are {' and '.join(TASKS)}")
        if self.plant not in PLANTS:
            raise UserError(f"unknown plant {self.plant!r}; known are {' and '.join(PLANTS)}")
        if self.integrator not in INTEGRATORS:
            known = ", ".join(INTEGRATORS)
            raise UserError(f"unknown integrator {self.integrator!r}; known are {known}")
        landing = self.task == "landing"
        config = dataclasses.replace(
            self,
            out=self.out or Path("runs") / f"{self.task}-{self.seed}",
            steps=self.steps if self.steps is not None else (1_200_000 if landing else 1_000_000),
            curriculum=self.curriculum or ("adaptive" if landing else "effort"),
            epochs=self.epochs if self.epochs is not None else (5 if landing else 8),
            gamma=self.gamma if self.gamma is not None else (0.99 if landing else 0.97),
        )
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
        return dataclasses.asdict(self) | {"out": str(self.out)}
