"""The learning part of a run: vehicles, network and curriculum, and the policy that they have led to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.save import actor_of, write_policy
from inclined_landing.envs.tasks import Task, is_path
from inclined_landing.models.base import storage
from inclined_landing.train import ppo, warm_start
from inclined_landing.train.callbacks import TimeSpent
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import make_curriculum
from inclined_landing.train.record import changed_entries, ranges_of


class Learner:
    """The vehicles, the model and the curriculum of a resolved configuration, in their initial state.

    record: the content of run.json, which policy files repeat. fresh: whether the run begins here, and takes
    over the policy or law to start from, which is the `teacher`. `history` has a row for each iteration;
    `averages` is the policy with moving averages of its weights, None without averaging.
    """

    def __init__(self, config: TrainConfig, record: dict, fresh: bool):
        self.config, self.record = config, record
        env = ppo.training_environment(config)
        self.batch, self.task = env.env, env.env.task
        drawn = config.randomise is not None and config.is_planar
        assert config.curriculum is not None and config.gamma is not None
        self.curriculum = make_curriculum(
            config.curriculum, config.task, config.gamma, config.without, drawn=drawn
        )
        self.history: list[dict] = []
        self.clock = TimeSpent()
        self.teacher = None
        if config.start_from and fresh:
            self.teacher = warm_start.teacher(config.start_from, self.task, config.vehicle)
        self.model = ppo.build_model(config, env)
        if isinstance(self.teacher, Policy):
            warm_start.take_over(self.model, self.teacher)
            if self.teacher.task.name == self.task.name:
                self.curriculum.skip()
        self.averages: AveragedModel | None = None
        if weight := self.curriculum.averaging:
            averaged = get_ema_multi_avg_fn(weight)
            self.averages = AveragedModel(self.model.policy, multi_avg_fn=averaged)
            self.averages.module.optimizer = self.model.policy.optimizer  # which policy files contain

    @property
    def steps(self) -> int:
        """Number of environment steps so far."""
        return int(self.model.num_timesteps)

    def teach(self) -> None:
        """Teach a new model what the teacher's weights do not contain."""
        if self.teacher is not None:
            warm_start.teach(self.model, self.batch, self.teacher, self.config.seed)

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """Let the model have the averaged policy, if there is one, in a `with` statement."""
        own = self.model.policy
        try:
            if self.averages is not None:
                self.model.policy = self.averages.module
            yield
        finally:
            self.model.policy = own

    def policy(self, task: Task) -> Policy:
        """Return the present policy for flights of a task."""
        path = self.config.folder / "final.zip"
        return Policy(task=task, metadata={}, path=path, **actor_of(self.model))

    def policy_file(self) -> bytes:
        """Return the present policy with its metadata, as a file."""
        config = self.config
        metadata = {
            "task": self.task.name,
            **({"task_from": config.task} if is_path(config.task) else {}),
            "task_options": self.task.options,
            "plant": config.plant,
            "algorithm": "PPO",
            "curriculum": self.curriculum.name,
            "seed": config.seed,
            "steps": self.steps,
            **({"vehicle": changed_entries(self.task.vehicle)} if config.vehicle is not None else {}),
            **({"ranges": ranges_of(config)} if config.randomise is not None else {}),
            **{name: value for name, value in self.record.items() if name != "config"},
        }
        with storage.scratch(config.folder / "policy.zip") as path, self.averaged():
            write_policy(self.model, path, metadata, actor_of(self.model))
            return path.read_bytes()
