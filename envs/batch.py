"""`BatchEnv`: n episodes of one task in one plant, stepped together.

The Gymnasium and Stable-Baselines3 environments are thin wrappers around this class.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from inclined_landing.envs.history import History
from inclined_landing.envs.tasks import Task
from inclined_landing.envs.tasks.base import FARTHEST, Evaluation, StepContext
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.envs.tasks.start import Start
from inclined_landing.envs.vehicle_parameters import vehicle_parameters
from inclined_landing.models.attitude import LAG, X
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.forces import settled_hover
from inclined_landing.models.plants import Plant

_TRIES = 1000
_START = ("state", "inclination", "present", "goal_size")  # the fields of a start that are recorded
_EPISODE = ("length", "total", "contact_steps", "touched", "held_steps")  # 0 at its start
# Where vehicles are drawn by their failures, the weight of each is its share of recent failures plus EASY, so
# that one that always fails is drawn six times as often as one that never does. In the share, an average, an
# episode counts LATEST and those before it the rest.
EASY, LATEST = 0.2, 0.15


def as_floats(value, what: str) -> np.ndarray:
    """Return `value` as an array of floats; raise UserError, naming it as `what`, when it is not numeric.

    Complex numbers, strings and dates are rejected, although NumPy would convert them to floats.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind in "biufO":
            return array.astype(float, copy=False)
    except Exception:  # whatever the conversion of another library's array raises
        pass
    remedy = "; convert a tensor with tensor.detach().cpu().float()" if hasattr(value, "detach") else ""
    raise UserError(f"{what} must be an array of real numbers{remedy}")


def reset_state(options):
    """Return the start state in the options of `reset`, or None; raise UserError for other options."""
    options = {} if options is None else options
    if not isinstance(options, dict):
        raise UserError(f"the options of reset must be a dictionary, not {shown(repr(options), 40)}")
    for key in options:
        if key != "state":
            raise UserError(f"unknown option {shown(repr(key), 40)} of reset; choose from state")
    return options.get("state")


def check_seed(seed) -> None:
    """Raise UserError unless `seed` is a non-negative integer or None."""
    if seed is not None and not (is_whole(seed) and seed >= 0):
        raise UserError(f"a seed must be a non-negative integer, not {shown(repr(seed), 40)}")


def is_whole(value) -> bool:
    """Return whether `value` is an integer (True and False are not)."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


@dataclasses.dataclass
class Step:
    """The result of one control step of every vehicle; arrays are fresh."""

    observation: np.ndarray  # (n, o) float32, the task's history included
    reward: np.ndarray  # (n,)
    terminated: np.ndarray  # (n,) bool
    truncated: np.ndarray  # (n,) bool
    success: np.ndarray  # (n,) bool
    terms: dict[str, np.ndarray]  # reward terms, (n,) each; they sum to the reward


class BatchEnv:
    """n vehicles of a plant on a task. Nothing is reset automatically: call `reset(ids)`.

    Per-vehicle records of the running episodes: `length`, `total` (sum of rewards), `contact_steps`
    (steps in contact with the platform or within the plant's keep-out zone), `touched`
    (whether any part has touched the platform so far), `held_steps` (consecutive steps up to now that the
    task counts as held).

    nominal: share of the random episodes with the plant's own vehicle; the others have one of its pool, drawn
    for every episode and hovering initially. None: the vehicles remain those that the plant assigned.

    by_failure: draw a vehicle the more often the more of its episodes have failed (`failures`, the share of
    each), instead of all equally often.

    informed: tasks that observe the vehicle, or whose actions are relative to hover, use each vehicle of the
    pool; otherwise the task's.
    """

    def __init__(
        self,
        task: Task,
        plant: Plant,
        seed: int | None = None,
        nominal: float | None = None,
        informed: bool = True,
        by_failure: bool = False,
    ):
        if not (isinstance(task, Task) and all(hasattr(plant, name) for name in ("n", "state", "step"))):
            objects = shown(f"{task!r} and {plant!r}", 80)
            raise UserError(
                f"BatchEnv takes a Task and a Plant, as make_task and make_plant return, not {objects}"
            )
        self.task, self.n = task, plant.n
        self.plant: Any = plant  # a Plant of one of the kinds in PLANTS, or what stands for one
        self.nominal = nominal
        self.by_failure = by_failure and nominal is not None and len(plant.pool) > 0
        self.seed(seed)
        n = self.n
        self.length = np.zeros(n, int)
        self.total = np.zeros(n)
        self.contact_steps = np.zeros(n, int)
        self.touched = np.zeros(n, bool)
        self.held_steps = np.zeros(n, int)
        self.commands = np.zeros((n, 4))
        self.actions = np.zeros((n, len(task.action_names)))
        self.past = History(task, n)
        self._start = Start(
            np.zeros((n, plant.state.shape[1])), np.zeros(n), np.zeros(n, bool), np.full(n, np.nan)
        )
        self._action_size = len(task.action_names)
        # Row 0 is the task's vehicle, even where the plant's own differs: no policy observes the difference.
        vehicles = (task.vehicle, *(plant.pool if informed else [task.vehicle] * len(plant.pool)))
        self._privileged = (
            np.array([vehicle_parameters(v) for v in vehicles]) if task.observe_vehicle else None
        )
        self._hover_pwm = None
        if task.per_vehicle_hover and plant.pool and informed:
            self._hover_pwm = np.array([task.pwm_centre, *map(settled_hover, plant.pool)])
        task.prepare(plant)

    def seed(self, seed: int | None) -> None:
        """Restart the random starts from `seed`."""
        check_seed(seed)
        self.draw_from(np.random.default_rng(seed))

    def draw_from(self, rng: np.random.Generator) -> None:
        """Use `rng` for random starts, and for the disturbance if the plant has one; forget failures."""
        self.rng = rng
        self.failures = np.full(len(self.plant.pool), 0.5)
        if self.plant.disturbance:
            self.plant.disturbance.seed(rng)

    @property
    def start_x(self) -> np.ndarray:
        """x (n,) of the starts of the running episodes [m]."""
        return self._start.state[:, X]

    def episode_state(self) -> dict[str, np.ndarray]:
        """Return copies of the per-vehicle records, for `restore_episodes`."""
        return {name: array.copy() for name, array in self._records().items()}

    def restore_episodes(self, records: dict[str, np.ndarray]) -> None:
        """Continue the episodes recorded by `episode_state`; the plant is restored separately."""
        for name, array in self._records().items():
            array[:] = records[name]

    def _records(self) -> dict[str, np.ndarray]:
        start = {name: getattr(self._start, name) for name in _START}
        past = {"past": self.past.steps} if self.task.history else {}
        failures = {"failures": self.failures} if self.by_failure else {}
        return {name: getattr(self, name) for name in _EPISODE} | start | past | failures

    def observe(self, ids=slice(None)) -> np.ndarray:
        """Return observations (k, o) of the vehicles `ids` as measured now, with their history."""
        ids = ids if isinstance(ids, slice) else self._numbers(ids)
        return self._with_past(self._observation(self.plant.measurement, ids), ids)

    def _with_past(self, observation: np.ndarray, ids) -> np.ndarray:
        parameters = None if self._privileged is None else self._privileged[self.plant.choice[ids]]
        return self.past.stack(observation, ids, parameters)

    def _observation(self, measurement: np.ndarray, ids=slice(None)) -> np.ndarray:
        contacts, platform = self.plant.contacts, self.plant.platform
        return self.task.observe(StepContext(measurement[ids], contacts[ids], platform=platform[ids]))

    def reset(self, ids=None, state: np.ndarray | None = None, start: Start | None = None) -> np.ndarray:
        """Begin new episodes for the vehicles `ids` (all by default); return their observations.

        state (k, 13): states to start from instead of random ones, with the platforms of `Task.start`; or
        start: complete starts of k episodes.
        """
        ids = np.arange(self.n) if ids is None else self._numbers(ids)
        if not (start is None or isinstance(start, Start)):
            raise UserError(f"start must be a Start, not {shown(repr(start), 40)}; pass states as state=")
        if state is not None:
            state = as_floats(state, "the start state")
            if state.shape != (len(ids), self.plant.state.shape[1]):
                raise UserError(
                    f"reset of {len(ids)} vehicles needs states of shape "
                    f"({len(ids)}, {self.plant.state.shape[1]}), not {state.shape}"
                )
            if not (np.abs(state) <= FARTHEST).all():
                raise UserError(f"a start state contains NaN or a number beyond {FARTHEST:g}")
        if state is not None:
            start = self.task.start(state)
        if start is None:
            self._draw_vehicles(ids)
            start = self._draw_starts(ids)
            start.state[:, LAG] *= self.plant.hover_share[ids]
        else:
            self._place(ids, start)
        if start.contact is not None:
            self.plant.set_contact(ids, **start.contact)
        self.plant.reset(ids, start.state)
        return self._begin(ids, start)

    def begin_in_place(self, ids) -> np.ndarray:
        """Begin episodes of the vehicles `ids` at their present states, over the task's platforms.

        Returns their observations.
        """
        ids = self._numbers(ids)
        start = self.task.start(self.plant.state[ids].copy())
        self._place(ids, start)
        return self._begin(ids, start)

    def _begin(self, ids: np.ndarray, start: Start) -> np.ndarray:
        for name in _START:
            getattr(self._start, name)[ids] = getattr(start, name)
        for name in _EPISODE:
            getattr(self, name)[ids] = 0
        observation = self._observation(self.plant.measurement, ids)
        self.past.reset(ids, observation)
        return self._with_past(observation, ids)

    def _place(self, ids: np.ndarray, start: Start) -> None:
        """Set the platforms of the vehicles `ids` for their starts."""
        inclination = start.inclination + self.plant.tilt[ids]
        azimuth = 0.0 if start.azimuth is None else start.azimuth
        self.plant.set_platform(ids, inclination, start.present, azimuth)
        if start.motion is not None:
            self.plant.set_motion(ids, start.motion)

    def _numbers(self, ids) -> np.ndarray:
        """Return the indices (k,) of vehicles given as indices or as a mask (n,); else raise UserError."""
        array = np.asarray(ids)
        if array.dtype == bool and array.shape == (self.n,):
            return np.flatnonzero(array)
        if array.shape == (0,):
            return array.astype(int)
        if array.dtype.kind in "iu" and array.ndim == 1 and -self.n <= array.min() <= array.max() < self.n:
            return array
        raise UserError(
            f"ids must be vehicle numbers from 0 to {self.n - 1}, or a boolean mask of shape ({self.n},), "
            f"not {shown(repr(ids), 40)}"
        )

    def _draw_starts(self, ids: np.ndarray) -> Start:
        """Return random starts of the vehicles `ids`, clear of their platforms, which are set."""
        start = self.task.sample(self.rng, len(ids))
        for _ in range(_TRIES):
            self._place(ids, start)
            if self.plant.shapes.are_equal:  # whose clearance the task's starts respect
                return start
            todo = np.flatnonzero(self.plant.clearance(ids, start.state) <= self.plant.keep_out)
            if not len(todo):
                return start
            start.put(todo, self.task.sample(self.rng, len(todo)))
        raise UserError("none of the task's starts has room for the largest vehicle of the plant")

    def _draw_vehicles(self, ids: np.ndarray) -> None:
        if self.nominal is None or not self.plant.pool:
            return
        if self.by_failure:
            weights = EASY + self.failures
            share = np.cumsum(weights / weights.sum())
            drawn = 1 + np.searchsorted(share / share[-1], self.rng.random(len(ids)), side="right")
        else:
            drawn = self.rng.integers(1, len(self.plant.pool) + 1, len(ids))
        drawn[self.rng.random(len(ids)) < self.nominal] = 0
        self.plant.assign(ids, drawn)

    def _count_failures(self, ended: np.ndarray, success: np.ndarray) -> None:
        """Update the share of failures of the pool's vehicles whose episodes have ended; masks (n,)."""
        # If e of a vehicle's episodes end at once, and the share q of them fails:
        #   f <- f + (1 - (1 - LATEST)^e) (q - f)
        vehicle, length = self.plant.choice, 1 + len(self.plant.pool)
        count = np.bincount(vehicle[ended], minlength=length)[1:]
        failed = np.bincount(vehicle[ended & ~success], minlength=length)[1:]
        weight = 1.0 - (1.0 - LATEST) ** count
        self.failures += weight * (failed / np.maximum(count, 1) - self.failures)

    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> Step:
        """Apply actions (n, a), clipped to [-1, 1], for one control period.

        active: (n,) bool, vehicles whose result is used; the plant may skip the others.
        Raises UserError when an action has the wrong shape or is not finite.
        """
        if active is not None:
            active = np.asarray(active)
            if active.shape != (self.n,) or active.dtype.kind not in "biu":
                raise UserError(f"active must be {self.n} booleans")
        self.act(actions)
        self.plant.step(self.commands, active)
        return self.outcome()

    def act(self, actions: np.ndarray) -> None:
        """Set `commands` from the actions (n, a), the first half of `step`."""
        actions = as_floats(actions, "the action")
        if actions.shape != (self.n, self._action_size):
            raise UserError(f"actions must have shape ({self.n}, {self._action_size}), not {actions.shape}")
        if not np.isfinite(actions).all():
            raise UserError("an action is NaN or infinite")
        self.actions = np.clip(actions, -1.0, 1.0)
        measurement = self.plant.measurement
        if self._hover_pwm is None:  # a custom task's `commands` may take the actions alone
            self.commands = self.task.commands(self.actions)
        else:
            self.commands = self.task.commands(self.actions, self._hover_pwm[self.plant.choice])
        self.commands = self.task.body_commands(self.commands, measurement, self.plant.platform)
        if self.task.history:
            self.past.record(self._observation(measurement), self.actions)

    def outcome(self) -> Step:
        """Return rewards and episode ends after the plant's step, the second half of `step`."""
        contacts = self.plant.contacts
        self.length += 1
        self.contact_steps += contacts.platform_near
        self.touched |= contacts.platform
        state, platform, start = self.plant.state, self.plant.platform, self._start
        counts = {"length": self.length, "in_contact": self.contact_steps, "held_steps": self.held_steps}
        context = StepContext(state, contacts, self.actions, start, **counts, platform=platform)
        verdict: Evaluation = self.task.evaluate(context)
        if verdict.holding is not None:
            self.held_steps = np.where(verdict.holding, self.held_steps + 1, 0)
        reward = verdict.reward
        if not np.isfinite(reward).all():
            raise TaskError(f"task {self.task.name}: the reward of a step is NaN or infinite")
        self.total += reward
        terminated = verdict.terminated
        truncated = ((self.length >= self.task.max_steps) | verdict.truncated) & ~terminated
        if self.by_failure and (ended := terminated | truncated).any():
            self._count_failures(ended, verdict.success)
        return Step(self.observe(), reward, terminated, truncated, verdict.success, verdict.terms)
