"""Curricula: which conditions episodes start under, and when that changes.

A curriculum is an object with a rule. It is told of every finished episode, asked once per rollout to
`advance`, logged, and checkpointed through `state` / `restore`. The environment reads its `conditions`
and never changes them.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from inclined_landing.envs.tasks import setpoint, task_class, touchdown
from inclined_landing.envs.tasks.landing import AIDED, EASIEST_GOAL_SIZE, GOAL_SIZE, LandingConditions
from inclined_landing.models.errors import UserError, shown

SETTLING = 400_000  # environment steps
# Success at which the adaptive curriculum goes on, and below which it goes back: usually, and on drawn
# vehicles in the plane, of which nobody lands all.
GATE, FLOOR = (0.7, 0.5), (0.4, 0.3)
# Parts of a landing's curriculum that `--without` leaves out, and their fields of `LandingConditions`.
PARTS = {
    "start": ("start_reach", "start_reach_z", "lowest_start"),
    "tilt": ("tilt",),
    "motion": ("motion",),
    "goal": ("goal_size",),
    "platform": ("platform",),
    "departure": ("out_of_bounds_penalty",),
}
RISING = "paper"  # how the paper's discount is called


class Curriculum(Protocol):
    """What the training callback needs."""

    name: str

    @property
    def level(self) -> float:
        """0 easiest, 1 the task itself."""

    def conditions(self) -> Any:
        """Return the conditions of the next episodes; None where the task has none."""

    def stages(self) -> list[tuple[str, Any]]:
        """Return titles and conditions of some moments, for a figure; none without stages."""

    def episode(self, success: bool, length: int) -> None:
        """Take note of the end of a training episode."""

    def advance(self, steps: int) -> None:
        """Take note of the end of a rollout, after `steps` environment steps in all."""

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        """Return the share of the initial learning rate at `steps` of `total`; None: until success."""

    def skip(self) -> None:
        """Begin at the end of a curriculum that follows success, as the policy has learned the task."""

    def gamma(self, steps: int) -> float:
        """Return the discount factor of the next rollout, after `steps` environment steps."""

    def log(self) -> dict[str, float]:
        """Return numbers for the learning curves."""

    def state(self) -> dict:
        """Return everything `restore` needs, JSON types only."""

    def restore(self, state: dict) -> None:
        """Continue from a `state`."""


def settling(steps: int) -> float:
    """Return the share of the learning rate `steps` after the task was complete, in a run ended by success.

    Falls linearly, as policies that learn at full rate to their end are brittle, and stays at a tenth, as
    nobody knows when that end comes.
    """
    return max(0.1, 1.0 - steps / SETTLING)


def rising_gamma(steps: int) -> float:
    """Return the paper's discount after `steps` environment steps: from 0.97 to 0.99 over 800 000."""
    return 0.97 + 0.02 * min(1.0, steps / 800_000)


class NoCurriculum:
    """The task as it is, gamma as given, learning rate falling linearly to zero (or `settling`)."""

    name = "none"
    level = 1.0

    def __init__(self, gamma: float, conditions: Any = None):
        self._gamma, self._conditions = gamma, conditions

    def conditions(self) -> Any:
        return self._conditions

    def stages(self) -> list[tuple[str, Any]]:
        return [] if self._conditions is None else [("the task", self._conditions)]

    def episode(self, success: bool, length: int) -> None:
        return

    def advance(self, steps: int) -> None:
        return

    def skip(self) -> None:
        return

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return settling(steps) if total is None else max(0.0, 1.0 - steps / total)

    def gamma(self, steps: int) -> float:
        return self._gamma

    def log(self) -> dict[str, float]:
        return {"level": self.level}

    def state(self) -> dict:
        return {}

    def restore(self, state: dict) -> None:
        return


def _stage(c: LandingConditions) -> dict[str, float]:
    """Return what the learning curves show of landing conditions."""
    return {name: getattr(c, name) for name in ("start_reach", "tilt", "goal_size", "platform")}


class AdaptiveCurriculum:
    """One difficulty variable, raised when the measured success of training episodes allows it.

    With level l from 0 to 1: starts spread from 0.5 m to 3.3 m and platforms move, where they do, by l =
    0.8, the goal tilts by l = 0.6,
    the platform appears in more and more episodes from l = 0.25 to 0.45, the goal box shrinks from
    0.25 to 0.10 from l = 0.4 on.

    Rule, once per rollout: if the success rate of the last `window` episodes exceeds `gate`, l rises by
    `step` and the window is emptied; above `floor`, l creeps up by `creep`; in a full window at or below
    it, l goes back by `back`, as far as it takes: a policy that has learned to keep away from the platform
    has to meet the goal without one again. Episodes solved within two steps do not count. The learning rate
    stays constant until success at l = 1 exceeds the gate and then falls linearly to zero at the end of the
    run (or is `settling`).
    """

    name = "adaptive"

    def __init__(
        self,
        gamma: float = 0.98,
        *,
        window: int = 60,
        gate: float = GATE[0],
        floor: float = FLOOR[0],
        step: float = 0.08,
        creep: float = 0.003,
        back: float = 0.01,
    ):
        self._gamma, self.gate, self.floor = gamma, gate, floor
        self.step, self.creep, self.back = step, creep, back
        self.level = 0.0
        self._recent: deque[bool] = deque(maxlen=window)
        self._full_at: int | None = None

    def conditions(self) -> LandingConditions:
        l = self.level  # noqa: E741
        shrink = np.clip((l - 0.4) / 0.6, 0.0, 1.0)
        return dataclasses.replace(
            AIDED,
            start_reach=0.5 + 2.8 * min(1.0, l / 0.8),
            tilt=min(1.0, l / 0.6),
            motion=min(1.0, l / 0.8),
            goal_size=float(EASIEST_GOAL_SIZE + (GOAL_SIZE - EASIEST_GOAL_SIZE) * shrink),
            platform=float(np.clip((l - 0.25) / 0.2, 0.0, 1.0)),
        )

    def stages(self) -> list[tuple[str, LandingConditions]]:
        """Return four levels of a curriculum of this kind."""
        other, moments = AdaptiveCurriculum(), []
        for level in (0.0, 0.25, 0.6, 1.0):
            other.level = level
            moments.append((f"level {level:g}", other.conditions()))
        return moments

    @property
    def success(self) -> float:
        """Return the success rate of the window, 0 while it is empty."""
        return float(np.mean(self._recent)) if self._recent else 0.0

    def episode(self, success: bool, length: int) -> None:
        if not (success and length <= 2):
            self._recent.append(bool(success))

    def advance(self, steps: int) -> None:
        full = len(self._recent) == self._recent.maxlen
        passed = full and self.success > self.gate
        if self.level >= 1.0 and passed:
            self._full_at = steps if self._full_at is None else self._full_at
        elif passed:
            self.level = min(1.0, self.level + self.step)
            self._recent.clear()
        elif self.success > self.floor:
            self.level = min(1.0, self.level + self.creep)
        elif full:
            self.level, self._full_at = max(0.0, self.level - self.back), None

    def skip(self) -> None:
        self.level = 1.0  # at the full learning rate, until success on this vehicle passes the gate

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        if self._full_at is None:
            return 1.0
        if total is None:
            return settling(steps - self._full_at)
        if total <= self._full_at:
            return 1.0
        return max(0.0, (total - steps) / (total - self._full_at))

    def gamma(self, steps: int) -> float:
        return self._gamma

    def log(self) -> dict[str, float]:
        return {"level": self.level, "success": self.success} | _stage(self.conditions())

    def state(self) -> dict:
        return {
            "level": self.level,
            "recent": [bool(x) for x in self._recent],
            "full_at": self._full_at,
        }

    def restore(self, state: dict) -> None:
        self.level, self._full_at = state["level"], state["full_at"]
        self._recent.clear()
        self._recent.extend(state["recent"])


class FixedCurriculum(AdaptiveCurriculum):
    """The same levels, by steps, whatever the success: level 1 at RAMP, where the adaptive one usually is."""

    name = "fixed"
    RAMP = 175_000  # environment steps

    def advance(self, steps: int) -> None:
        self.level = min(1.0, steps / self.RAMP)
        full = len(self._recent) == self._recent.maxlen
        if self.level >= 1.0 and full and self.success > self.gate and self._full_at is None:
            self._full_at = steps


class PaperCurriculum:
    """The paper's schedule, by episodes and steps, whatever the success, with the numbers of its
    authors' public training code.

    Starts within 0.2 m of the goal at first, growing by 1/6000 m per episode (in height by three
    quarters of that, to 1.2 m at most); the goal box shrinks from 0.25 to 0.10 over episodes 2500 to
    7500; the goal tilts by 1/6000 of the inclination per episode from 400 000 steps on; the platform
    appears at 800 000 steps. Gamma rises from 0.97 to 0.99 over the same 800 000 steps. The learning
    rate is constant and there are no training aids.
    """

    name = "paper"

    def __init__(self):
        self.episodes = self.tilting_episodes = self.steps = 0

    @property
    def level(self) -> float:
        c = self.conditions()
        shrink = (EASIEST_GOAL_SIZE - c.goal_size) / (EASIEST_GOAL_SIZE - GOAL_SIZE)
        return float(np.mean([min(1.0, c.start_reach / 3.3), c.tilt, shrink, c.platform]))

    def conditions(self) -> LandingConditions:
        shrink = np.clip((self.episodes - 2500) / 5000, 0.0, 1.0)
        reach = 0.2 + self.episodes / 6000
        return LandingConditions(
            start_reach=min(3.3, reach),
            start_reach_z=min(1.2, 0.2 + 0.75 * self.episodes / 6000),
            tilt=min(1.0, self.tilting_episodes / 6000),
            goal_size=float(EASIEST_GOAL_SIZE + (GOAL_SIZE - EASIEST_GOAL_SIZE) * shrink),
            platform=float(self.steps >= 800_000),
            lowest_start=1.0,
        )

    def stages(self) -> list[tuple[str, LandingConditions]]:
        """Return four moments of the schedule at the usual length of episodes."""
        other, moments = PaperCurriculum(), []
        for episodes, tilting, steps, title in (
            (0, 0, 0, "0 k steps"),
            (5000, 0, 390_000, "390 k steps"),
            (9000, 3000, 700_000, "700 k steps"),
            (19_000, 6000, 3_000_000, "3 M steps"),
        ):
            other.episodes, other.tilting_episodes, other.steps = episodes, tilting, steps
            moments.append((title, other.conditions()))
        return moments

    def episode(self, success: bool, length: int) -> None:
        self.episodes += 1
        self.tilting_episodes += self.steps >= 400_000

    def advance(self, steps: int) -> None:
        self.steps = steps

    def skip(self) -> None:
        return

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return 1.0

    def gamma(self, steps: int) -> float:
        return rising_gamma(steps)

    def log(self) -> dict[str, float]:
        return {"level": self.level} | _stage(self.conditions())

    def state(self) -> dict:
        return {
            "episodes": self.episodes,
            "tilting_episodes": self.tilting_episodes,
            "steps": self.steps,
        }

    def restore(self, state: dict) -> None:
        self.episodes, self.steps = state["episodes"], state["steps"]
        self.tilting_episodes = state["tilting_episodes"]


class EffortCurriculum(NoCurriculum):
    """Set-point: no stages, but two training aids.

    The task divides the effort by the distance to the goal, down to 1 mm: a policy that still
    explores is punished hundredfold for being where it should be, and learns to stay away. In training
    the divisor is at least 0.5 m. Episodes end after 150 steps, so that more of the data is approach.
    The learning rate is constant for 60 % of the run and then falls linearly to zero.
    """

    name = "effort"

    def conditions(self) -> setpoint.SetpointConditions:
        return setpoint.SetpointConditions(effort_floor=0.5, episode_limit=150)

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return min(1.0, super().learning_rate_share(steps, total) / 0.4)


class TouchdownCurriculum(NoCurriculum):
    """Touchdown: by steps, whatever the success, as the policy lands from the first step on.

    The price of a hard touchdown grows to the task's over the first half of a run of RAMP steps, so that
    coming to rest is learned before gentleness. A share of the episodes begins just over the slope, from
    0.2 down to none at RAMP. Three tenths begin around the raised edge: most of the starts that failed lie
    there, as the edge has to be passed at once, and few uniform starts show it. Where slopes are drawn, three
    tenths are among the steepest, as nothing else is as hard to rest on. Friction and restitution are drawn
    for every episode, mostly slippery and springy. Leaving the arena, falling to the floor or lying on the
    slab the wrong way terminates the episode with a penalty: a truncation would bootstrap from states whose
    value the critic never learned. The learning rate is constant for 40 % of the run and then falls linearly
    to zero; only the critic learns at first (`warm_start.CRITIC_FIRST`).
    """

    name = "touchdown"
    RAMP = 400_000  # environment steps

    def __init__(self, gamma: float):
        super().__init__(gamma)
        self.level = 0.0

    def conditions(self) -> touchdown.TouchdownConditions:
        return touchdown.TouchdownConditions(
            contact_limit=8,
            leave_limit=0.3,
            out_of_bounds_penalty=150.0,
            steep=0.3,
            beside=0.3,
            close=0.2 * (1.0 - self.level),
            impact_share=min(1.0, 2.0 * self.level),
            friction=touchdown.FRICTION,
            restitution=touchdown.RESTITUTION,
        )

    def advance(self, steps: int) -> None:
        self.level = min(1.0, steps / self.RAMP)

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return min(1.0, super().learning_rate_share(steps, total) / 0.6)

    def state(self) -> dict:
        return {"level": self.level}

    def restore(self, state: dict) -> None:
        self.level = state["level"]


class Changed:
    """A curriculum but for parts that are left out: in those, every episode is the task itself.

    parts: of PARTS; without an out-of-bounds penalty, leaving truncates. rising: the paper's discount instead
    of its own.
    """

    def __init__(self, whole: Curriculum, parts: Sequence[str], rising: bool):
        self._whole, self._rising = whole, rising
        conditions = whole.conditions()
        fields = {field.name for field in dataclasses.fields(conditions)} if conditions is not None else set()
        known = [part for part, names in PARTS.items() if fields.issuperset(names)]
        for part in parts:
            if part not in known:
                has = f"it has {', '.join(known)}" if known else "it has none"
                raise UserError(
                    f"--without: the curriculum {whole.name} has no part {shown(part, 40)!r}; {has}"
                )
        self._left_out = [name for part in parts for name in PARTS[part]]

    def __getattr__(self, name: str):
        return getattr(self._whole, name)

    def conditions(self) -> Any:
        return self._but(self._whole.conditions())

    def stages(self) -> list[tuple[str, Any]]:
        """Return the curriculum's, changed."""
        return [(title, self._but(conditions)) for title, conditions in self._whole.stages()]

    def gamma(self, steps: int) -> float:
        return rising_gamma(steps) if self._rising else self._whole.gamma(steps)

    def log(self) -> dict[str, float]:
        """Return the curriculum's, changed."""
        shown_as, conditions = self._whole.log(), self.conditions()
        return shown_as | {name: getattr(conditions, name) for name in self._left_out if name in shown_as}

    def _but(self, conditions: Any) -> Any:
        if not self._left_out:
            return conditions
        task = type(conditions)()
        return dataclasses.replace(conditions, **{name: getattr(task, name) for name in self._left_out})


# Curricula by name, made from gamma; "none" is known besides. Tasks say which of them know them.
_CURRICULA: dict[str, Callable[[float], Curriculum]] = {
    "adaptive": AdaptiveCurriculum,
    "fixed": FixedCurriculum,
    "paper": lambda gamma: PaperCurriculum(),
    "effort": EffortCurriculum,
    "touchdown": TouchdownCurriculum,
}


def make_curriculum(
    name: str, task: str, gamma: float | str, without: str = "", *, drawn: bool = False
) -> Curriculum:
    """Return a curriculum by name, one of those that the task names.

    gamma: the discount, or "paper" for one that rises as the paper's. without: parts to leave out, as
    "tilt,goal". drawn: is it for drawn vehicles in the plane.
    """
    kind = task_class(task)
    if name not in kind.curricula:
        known = " or ".join([", ".join(kind.curricula[:-1]), kind.curricula[-1]][-len(kind.curricula) :])
        raise UserError(f"unknown curriculum {name!r} for task {task}: it must be {known}")
    rising = gamma == RISING
    first = rising_gamma(0) if rising else float(gamma)
    if name == "none":
        curriculum: Curriculum = NoCurriculum(first, kind.training_conditions)
    else:
        curriculum = _CURRICULA[name](first)
    if isinstance(curriculum, AdaptiveCurriculum) and drawn:
        curriculum.gate, curriculum.floor = GATE[1], FLOOR[1]
    parts = [part.strip() for part in without.split(",")] if without else []
    return Changed(curriculum, parts, rising) if parts or rising else curriculum
