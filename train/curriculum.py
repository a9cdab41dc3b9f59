"""Curricula: the conditions under which episodes start, and the rules by which these change.

A curriculum is an object with a rule. It receives every finished episode, its method `advance` is called once
per rollout, and it is logged and checkpointed through `state` and `restore`. The environment reads its
`conditions` and never changes them. The docstring of each method says who calls it when.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from inclined_landing.envs.tasks import setpoint, task_class, touchdown
from inclined_landing.envs.tasks.landing import (
    AIDED,
    CONTACT_LIMIT,
    EASIEST_GOAL_SIZE,
    GOAL_SIZE,
    LEAVE_LIMIT,
    LandingConditions,
)
from inclined_landing.models.base.errors import UserError, shown

SETTLED = 0.1  # share of the learning rate at which a run that is ended by success settles


class Rules(NamedTuple):
    """The rules of a curriculum that adapts to success, and of the end of its run."""

    settling: int  # environment steps over which the learning rate falls to SETTLED
    restarts: int  # of the learning rate, after which a run ends without landing all varied vehicles
    gate: float  # success above which the level rises
    floor: float  # success below which the level falls


USUAL = Rules(settling=400_000, restarts=0, gate=0.7, floor=0.4)
# For drawn vehicles in the plane: no policy lands all of them. In space a restart costs a million steps and
# gains little.
DRAWN = Rules(settling=350_000, restarts=2, gate=0.5, floor=0.3)
# The rest is of `BalancedCurriculum`.
ALONE = 0.5  # share of the drawn vehicles that have one effect
EITHER_SIDE = 0.75  # share of gate and floor that success from either side of the goal must exceed
# Kullback-Leibler divergence between the policies before and after an update to which the learning rate is
# adapted, and the factor by which it then changes.
DIVERGENCE, PACE = 0.015, 1.5
# Steps after the first success from which on policies are evaluated, and from which on it is enough that
# their success has stopped rising.
READY, PATIENT = 100_000, 1_000_000
AVERAGING = 0.8  # weight of the past in the average of the weights
# Least standard deviation of the exploration noise; its value after success has stopped rising, and the steps
# over which it may then fall to the least one again.
LEAST_NOISE, BOLD, FADING = 0.22, 0.4, 100_000
# Parts of a landing's curriculum that `--without` leaves out, and their fields of `LandingConditions`.
PARTS = {
    "start": ("start_reach", "start_reach_z", "lowest_start"),
    "tilt": ("tilt",),
    "motion": ("motion",),
    "goal": ("goal_size",),
    "platform": ("platform",),
    "departure": ("out_of_bounds_penalty",),
}
RISING = "paper"  # the name of the paper's discount


def discount(gamma: float | str, steps: int) -> float:
    """Return gamma after `steps` environment steps; that of RISING is 0.97 to 0.99 over 800 000."""
    return 0.97 + 0.02 * min(1.0, steps / 800_000) if gamma == RISING else float(gamma)


class Curriculum:
    """No curriculum: the task itself with constant discount and a learning rate that falls linearly to zero.

    In a run that is ended by success, the learning rate falls linearly during `settling` steps after the task
    is complete, because policies that learn at the full rate until the end are brittle, and then stays at
    SETTLED, because the end is not known in advance.

    Other curricula override this; `stage` returns the present conditions.
    """

    name = "none"
    level = 1.0  # 0 easiest, 1 the task itself
    pace = 1.0  # factor on the learning rate that depends on the updates, see `follow`
    averaging = 0.0  # weight of the average of past weights in the policy that is evaluated and saved
    least_noise = 0.0  # standard deviation below which PPO's exploration noise does not fall
    explored_at = 0  # environment steps after which that was last raised; 0: never

    def __init__(self, gamma: float | str, conditions: Any = None):
        """gamma: a number, or RISING; conditions: those of training without a curriculum."""
        self._gamma, self._conditions = gamma, conditions
        self.settling = USUAL.settling
        self.restarts, self.most_restarts = 0, USUAL.restarts  # of the learning rate, to its initial value
        self._without: list[str] = []  # fields of the conditions that are the task's from the first step on

    def stage(self) -> Any:
        """Return the present conditions before parts are omitted; None if the task has no conditions."""
        return self._conditions

    def conditions(self) -> Any:
        """Return the conditions of the next episodes; None if the task has none.

        Parts that the curriculum omits have the values of the task. `CurriculumCallback` asks after every
        rollout, and before the first.
        """
        stage = self.stage()
        if not self._without:
            return stage
        task = type(stage)()
        return dataclasses.replace(stage, **{name: getattr(task, name) for name in self._without})

    def leave_out(self, parts: list[str]) -> None:
        """Set these PARTS to the task's values; without departure, leaving the arena truncates an episode.

        `make_curriculum` calls it for the option `--without`.
        """
        stage = self.stage()
        fields = {field.name for field in dataclasses.fields(stage)} if stage is not None else set()
        known = [part for part, names in PARTS.items() if fields.issuperset(names)]
        for part in parts:
            if part not in known:
                has = f"it has {', '.join(known)}" if known else "it has no parts"
                raise UserError(
                    f"--without: the curriculum {self.name} has no part {shown(part, 40)!r}; {has}"
                )
        self._without = [name for part in parts for name in PARTS[part]]

    def episode(self, success: bool, length: int, start_x: float = 0.0) -> None:
        """Record the end of a training episode that started at `start_x` [m].

        `CurriculumCallback` calls it for every one.
        """

    def follow(self, divergence: float) -> None:
        """Record the Kullback-Leibler divergence between the policies before and after an update.

        `CurriculumCallback` calls it before the next rollout, so that a checkpoint, which is written then,
        contains it.
        """

    def advance(self, steps: int) -> None:
        """Record the end of a rollout, after `steps` environment steps in total.

        `CurriculumCallback` calls it after every one.
        """

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        """Return the share of the initial learning rate at `steps` of `total`; None: until success.

        `CurriculumCallback` asks after every rollout, for the next update.
        """
        if total is None:
            return max(SETTLED, 1.0 - steps / self.settling)
        return max(0.0, 1.0 - steps / total)

    def may_plateau(self, steps: int) -> bool:
        """Return whether evaluations of a run ended by success may stop rising from now on: at SETTLED.

        `Ending` asks for the steps of every evaluation, and counts only those for which it is true.
        """
        return self.learning_rate_share(steps, None) <= SETTLED

    def is_ready(self, steps: int) -> bool:
        """Return whether evaluations on varied vehicles may end a run: before, their success still rises.

        `Run` asks before every evaluation of a run with drawn vehicles that is ended by success.
        """
        return self.may_plateau(steps)

    def skip(self) -> None:
        """Go to the end of a curriculum that adapts to success, because the policy has learned the task.

        `Learner` calls it for a new run that continues from a policy of its task.
        """

    def learn_again(self) -> None:
        """Reset the learning rate, if it adapts to success, because the policy has stopped improving.

        `Run` calls it after an evaluation if `Ending.has_stalled`.
        """
        self.restarts += 1

    def explore_again(self, steps: int) -> None:
        """Raise the exploration noise, if it adapts to success, because success has stopped rising.

        `Run` calls it after an evaluation if `Ending.should_explore`, and `learn_again` was not due.
        """

    def gamma(self, steps: int) -> float:
        """Return the discount factor of the next rollout, after `steps` environment steps.

        `CurriculumCallback` asks after every rollout, and before the first.
        """
        return discount(self._gamma, steps)

    def log(self) -> dict[str, float]:
        """Return numbers for the learning curves and TensorBoard, after every rollout."""
        return {"level": self.level}

    def state(self) -> dict:
        """Return all attributes except the conditions of the task, in JSON types, for every checkpoint."""
        found = {name: value for name, value in vars(self).items() if name != "_conditions"}
        return {name: list(value) if isinstance(value, deque) else value for name, value in found.items()}

    def restore(self, state: dict) -> None:
        """Continue from a `state`, that of the checkpoint of a run that is resumed."""
        for name in self.state():
            before, value = getattr(self, name), state[name]
            setattr(self, name, deque(value, before.maxlen) if isinstance(before, deque) else value)


def _shown(c: LandingConditions) -> dict[str, float]:
    """Return the columns of the learning curves for landing conditions."""
    return {name: getattr(c, name) for name in ("start_reach", "tilt", "goal_size", "platform")}


class AdaptiveCurriculum(Curriculum):
    """One difficulty variable, raised when the measured success of training episodes allows it.

    With level l from 0 to 1: the range of the starts grows from 0.5 m to 3.3 m until l = 0.8, as does the
    motion of moving platforms, the goal reaches its full tilt at l = 0.6, the platform appears in a growing
    share of the episodes from l = 0.25 to 0.45, and the goal box shrinks from 0.25 to 0.10 from l = 0.4 on.

    Rule, once per rollout: if the success rate of the last `window` episodes exceeds `gate`, l rises by
    `step` and the window is emptied; above `floor`, l creeps up by `creep`; if it is at or below that in a
    full window, l decreases by `back`, repeatedly if necessary, because a policy that has learned to avoid
    the platform has to learn the goal without one again. Episodes solved within two steps are not counted.
    The learning rate stays constant until the success rate at l = 1 exceeds the gate. It then falls linearly
    to zero at the end of the run, or to SETTLED, and is reset if the run stops improving before it succeeds.
    """

    name = "adaptive"

    def __init__(
        self,
        gamma: float | str = 0.98,
        rules: Rules = USUAL,
        *,
        window: int = 60,
        step: float = 0.08,
        creep: float = 0.003,
        back: float = 0.01,
    ):
        super().__init__(gamma)
        self.settling, self.most_restarts, self.gate, self.floor = rules
        self.step, self.creep, self.back = step, creep, back
        self.level = 0.0
        self.recent: deque[bool] = deque(maxlen=window)
        self.full_at: int | None = None

    def stage(self) -> LandingConditions:
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

    @property
    def success(self) -> float:
        """Return the success rate of the window, 0 while it is empty."""
        return float(np.mean(self.recent)) if self.recent else 0.0

    def episode(self, success: bool, length: int, start_x: float = 0.0) -> None:
        if not (success and length <= 2):
            self.recent.append(bool(success))

    def advance(self, steps: int) -> None:
        full = len(self.recent) == self.recent.maxlen
        passed = full and self.success > self.gate
        if self.level >= 1.0 and passed:
            self.full_at = steps if self.full_at is None else self.full_at
        elif passed:
            self.level = min(1.0, self.level + self.step)
            self.recent.clear()
        elif self.success > self.floor:
            self.level = min(1.0, self.level + self.creep)
        elif full:
            self.level, self.full_at = max(0.0, self.level - self.back), None

    def skip(self) -> None:
        # At the full learning rate, until success on this vehicle passes the gate. Few of its variants may be
        # able to land.
        self.level, self.most_restarts = 1.0, USUAL.restarts

    def learn_again(self) -> None:
        super().learn_again()
        self.full_at = None  # until success passes the gate, which it does at the next rollout

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        if self.full_at is None:
            return 1.0
        if total is None:
            return super().learning_rate_share(steps - self.full_at, None)
        if total <= self.full_at:
            return 1.0
        return max(0.0, (total - steps) / (total - self.full_at))

    def log(self) -> dict[str, float]:
        return super().log() | {"success": self.success} | _shown(self.conditions())


class BalancedCurriculum(AdaptiveCurriculum):
    """The same levels for drawn vehicles, with success from both sides and a rate that follows the updates.

    A policy may learn to land from one side of the goal only, and to hover on the other for the rest of the
    run. The level therefore rises only if the success rate from either side exceeds EITHER_SIDE of the gate
    too, and creeps up only if it exceeds that share of the floor.

    An update at learning rate a moves a policy with exploration noise s by a Kullback-Leibler divergence of
    about (a / s)^2. At a constant rate updates grow as the noise falls, until success no longer rises. The
    rate is therefore reduced after an update with more than twice DIVERGENCE and raised again, up to that of
    the adaptive curriculum, after one with less than half of it. In a run that ends by success it does not
    fall otherwise: policies that do not land all vehicles yet need it to learn the remaining ones. The noise
    does not fall below LEAST_NOISE, as otherwise such small updates change little. If success stops rising
    short of the end, the noise is raised to BOLD, and may fall again over FADING steps: a policy that
    swings around the goal of some vehicles, which with noise reaches it by chance, has to find another way.
    The policy that is evaluated and saved has averaged weights, which fluctuate less.

    Vehicles whose episodes fail are drawn more often, and a share ALONE of them has one effect: otherwise
    those that pitch less than commanded are landed last.
    """

    name = "balanced"
    averaging = AVERAGING

    def __init__(self, gamma: float | str):
        # READY and PATIENT instead of restarts
        super().__init__(gamma, DRAWN._replace(restarts=USUAL.restarts))
        window = self.recent.maxlen or 0
        self.left: deque[bool] = deque(maxlen=window // 2)
        self.right: deque[bool] = deque(maxlen=window // 2)
        self.pace = 1.0
        self.steps = self.explored_at = 0

    @property
    def least_noise(self) -> float:  # type: ignore[override]
        if not self.explored_at:
            return LEAST_NOISE
        left = max(0.0, 1.0 - (self.steps - self.explored_at) / FADING)
        return LEAST_NOISE + (BOLD - LEAST_NOISE) * left

    def explore_again(self, steps: int) -> None:
        self.explored_at = steps

    @property
    def worse(self) -> float:
        """Return the success rate from the worse side of the goal, 0 while there are no episodes from it."""
        return min(float(np.mean(side)) if side else 0.0 for side in (self.left, self.right))

    def episode(self, success: bool, length: int, start_x: float = 0.0) -> None:
        super().episode(success, length)
        if not (success and length <= 2):
            (self.left if start_x < 0 else self.right).append(bool(success))

    def advance(self, steps: int) -> None:
        self.steps = steps
        full = all(len(side) == side.maxlen for side in (self.left, self.right))
        if self.success <= self.floor or (full and self.worse > EITHER_SIDE * self.gate):
            super().advance(steps)
        elif self.worse > EITHER_SIDE * self.floor:
            self.level = min(1.0, self.level + self.creep)
        if not self.recent:  # the level has risen, which empties the window
            self.left.clear()
            self.right.clear()

    def follow(self, divergence: float) -> None:
        if divergence > 2.0 * DIVERGENCE:
            self.pace /= PACE
        elif divergence < 0.5 * DIVERGENCE:
            self.pace = min(1.0, self.pace * PACE)

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return 1.0 if total is None else super().learning_rate_share(steps, total)

    def may_plateau(self, steps: int) -> bool:
        return self.full_at is not None and steps >= self.full_at + PATIENT

    def is_ready(self, steps: int) -> bool:
        return self.full_at is not None and steps >= self.full_at + READY


class FixedCurriculum(AdaptiveCurriculum):
    """The same levels as a function of steps: level 1 at RAMP, when the adaptive one usually reaches it."""

    name = "fixed"
    RAMP = 175_000  # environment steps

    def advance(self, steps: int) -> None:
        self.level = min(1.0, steps / self.RAMP)
        full = len(self.recent) == self.recent.maxlen
        if self.level >= 1.0 and full and self.success > self.gate and self.full_at is None:
            self.full_at = steps


class PaperCurriculum(Curriculum):
    """The paper's schedule by episodes and steps, with the numbers of its authors' public training code.

    Starts are initially within 0.2 m of the goal, a range that grows by 1/6000 m per episode (in height by
    three quarters of that, up to 1.2 m); the goal box shrinks from 0.25 to 0.10 over episodes 2500 to 7500;
    the goal tilts by 1/6000 of the inclination per episode from 400 000 steps on; the platform appears at 800
    000 steps. Gamma rises from 0.97 to 0.99 over the same 800 000 steps. The learning rate is constant and
    there are no training aids.
    """

    name = "paper"

    def __init__(self):
        super().__init__(RISING)
        self.episodes = self.tilting_episodes = self.steps = 0

    @property
    def level(self) -> float:  # type: ignore[override]
        c = self.stage()
        shrink = (EASIEST_GOAL_SIZE - c.goal_size) / (EASIEST_GOAL_SIZE - GOAL_SIZE)
        return float(np.mean([min(1.0, c.start_reach / 3.3), c.tilt, shrink, c.platform]))

    def stage(self) -> LandingConditions:
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

    def episode(self, success: bool, length: int, start_x: float = 0.0) -> None:
        self.episodes += 1
        self.tilting_episodes += self.steps >= 400_000

    def advance(self, steps: int) -> None:
        self.steps = steps

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return 1.0

    def may_plateau(self, steps: int) -> bool:
        return True

    def log(self) -> dict[str, float]:
        return super().log() | _shown(self.conditions())


class EffortCurriculum(Curriculum):
    """Curriculum of the set-point task: no stages, but two training aids.

    The task divides the effort by the distance to the goal, down to 1 mm: a policy that still explores is
    penalised a hundred times more at the goal and would learn to avoid it. In training the divisor is
    therefore at least 0.5 m. Episodes end after 150 steps, so that a larger part of the data is from the
    approach. The learning rate is constant for 60 % of the run and then falls linearly to zero.
    """

    name = "effort"

    def stage(self) -> setpoint.SetpointConditions:
        return setpoint.SetpointConditions(effort_floor=0.5, episode_limit=150)

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return min(1.0, super().learning_rate_share(steps, total) / 0.4)


class TouchdownCurriculum(Curriculum):
    """Curriculum of the touchdown task: a schedule by steps, because the policy lands from the first step on.

    The penalty of a hard touchdown grows to that of the task over the first half of a run of RAMP steps, so
    that coming to rest is learned before a soft touchdown. A share of the episodes begins just above the
    slope, falling from 0.2 to 0 at RAMP. Three tenths begin around the raised edge, where most failures occur
    because the edge has to be passed immediately, and which uniform starts rarely cover. If slopes are drawn,
    three tenths are among the steepest, on which it is most difficult to rest. Friction and restitution are
    drawn for every episode, mostly low friction and high restitution. Leaving the arena, falling to the floor
    or lying on the slab in another attitude terminates the episode with a penalty: a truncation would
    bootstrap from states whose value the critic has never learned. The learning rate is constant for 40 % of
    the run and then falls linearly to zero; only the critic learns at first (`warm_start.CRITIC_FIRST`).
    """

    name = "touchdown"
    RAMP = 400_000  # environment steps

    def __init__(self, gamma: float | str):
        super().__init__(gamma)
        self.level = 0.0

    def stage(self) -> touchdown.TouchdownConditions:
        return touchdown.TouchdownConditions(
            contact_limit=CONTACT_LIMIT,
            leave_limit=LEAVE_LIMIT,
            out_of_bounds_penalty=150.0,
            steep=0.3,
            around_edge=0.3,
            close=0.2 * (1.0 - self.level),
            impact_share=min(1.0, 2.0 * self.level),
            friction=touchdown.FRICTION,
            restitution=touchdown.RESTITUTION,
        )

    def advance(self, steps: int) -> None:
        self.level = min(1.0, steps / self.RAMP)

    def learning_rate_share(self, steps: int, total: int | None) -> float:
        return min(1.0, super().learning_rate_share(steps, total) / 0.6)


# Curricula by name, made from gamma and rules; "none" is known besides. Tasks list those that suit them.
_CURRICULA: dict[str, Callable[[float | str, Rules], Curriculum]] = {
    "adaptive": AdaptiveCurriculum,
    "balanced": lambda gamma, rules: BalancedCurriculum(gamma),
    "fixed": FixedCurriculum,
    "paper": lambda gamma, rules: PaperCurriculum(),
    "effort": lambda gamma, rules: EffortCurriculum(gamma),
    "touchdown": lambda gamma, rules: TouchdownCurriculum(gamma),
}


def make_curriculum(
    name: str, task: str, gamma: float | str, without: str | None = None, *, drawn: bool = False
) -> Curriculum:
    """Return a curriculum by name, one of those that the task lists.

    gamma: the discount, or "paper" for one that rises as in the paper. without: parts to omit, such as
    "tilt,goal". drawn: whether it is for drawn vehicles in the plane.
    """
    kind = task_class(task)
    if name not in kind.curricula:
        known = " or ".join([", ".join(kind.curricula[:-1]), kind.curricula[-1]][-len(kind.curricula) :])
        raise UserError(f"unknown curriculum {name!r} for task {task}: it must be {known}")
    if name == "none":
        curriculum = Curriculum(gamma, kind.training_conditions)
    else:
        curriculum = _CURRICULA[name](gamma, DRAWN if drawn else USUAL)
    if without:
        curriculum.leave_out([part.strip() for part in without.split(",")])
    return curriculum
