"""`InclinedTouchdown`: come to rest on the slope, on the feet, motors at idle, by the policy's own command.

There is no goal box in which the motors are cut; the policy itself has to stop them. The contact is
simulated, so that this task needs the MuJoCo plant.

Observation, float32, unbounded: that of `InclinedLanding`; index 5 only with `observe_contact=True`:

| index | quantity | unit |
|---|---|---|
| 0, 1 | x, z | m |
| 2, 3 | vx, vz | m/s |
| 4 | pitch, positive accelerates +x | rad |
| 5 | do the feet touch the slab, 0 or 1 | |

Action, float32, from -1 to 1; roll and yaw-rate commands are zero:

| index | command | at action a | MuJoCo actuator |
|---|---|---|---|
| 0 | thrust | as in `InclinedLanding`, but a <= -0.9 is PWM 0: motors at idle | `thrust` |
| 1 | pitch | 30 deg times a | `pitch` |

Motors at idle produce no attitude torque.

A moment is *held* when feet and nothing else touch the slab, nothing touches the base, the vehicle is
slower than 0.05 m/s and turns slower than 1 rad/s, both against the slab where it stands, and the motors
are at idle by command. Success is 0.3 s (15 steps) held without a break.

Reward per step: 0 while held; otherwise -1 (`time`), a further -1 near the bounds of the arena
(`bounds`), a further -6 when body or rotors touch the slab or anything touches the base (`obstacle`);
and at any time -0.5 for each weight by which the force on the feet exceeds two weights (`impact`), which
rewards a soft touchdown.

An episode ends with success, or is truncated after 300 steps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from inclined_landing.envs import swell
from inclined_landing.envs.tasks import touchdown_starts
from inclined_landing.envs.tasks.base import (
    Evaluation,
    ScoreCurve,
    Start,
    StepContext,
    Task,
    Training,
)
from inclined_landing.envs.tasks.landing import InclinedLanding, LandingConditions
from inclined_landing.envs.tasks.moving import MovingLanding
from inclined_landing.envs.tasks.options import option
from inclined_landing.envs.tasks.platform import LandingOptions
from inclined_landing.envs.tasks.slopes import SlopeLanding
from inclined_landing.envs.tasks.space import SpaceLanding
from inclined_landing.models import geometry, surface
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

IDLE_ACTION = -0.9  # thrust actions up to this one command PWM 0
REST_SPEED = 0.05  # m/s
REST_RATE = 1.0  # rad/s: the feet are then slower than 0.05 m/s too; on springy contact it trembles with 0.5
HOLD_STEPS = 15  # 0.3 s
GENTLE_FORCE = 2.0  # force on the feet that costs nothing, in weights
CONTACT_TIME = 0.02  # s, wherever a restitution is set
FRICTION, RESTITUTION = (0.5, 1.2), (0.0, 0.5)  # spread of the contact in training and its evaluation
HELD = (1.04, 1.5)  # least of both ends of that spread, in the friction that holds the slope at all


@dataclasses.dataclass(frozen=True)
class TouchdownConditions(LandingConditions):
    """Conditions under which episodes begin. The defaults are the task; other values are training aids.

    contact_limit ends episodes on the wrong parts. With an `out_of_bounds_penalty`, about the return of
    staying there, episodes that it or leave_limit ends are terminated; without one they are truncated.
    """

    around_edge: float = 0.0  # share of the episodes that begin around the raised edge, mostly low
    close: float = 0.0  # share of the episodes that begin just over the slope, in any motion
    impact_share: float = 1.0  # of the price of a hard touchdown
    friction: tuple[float, float] | None = None  # drawn per episode, mostly low; None: the plant's own
    restitution: tuple[float, float] | None = None  # mostly high


@dataclasses.dataclass(frozen=True)
class TouchdownOptions(LandingOptions):
    """The landing's options, and one more."""

    observe_contact: bool = option(False, recorded=True)  # append the feet's contact to the observation


class InclinedTouchdown(InclinedLanding):
    """The task for vehicles of one kind, with platforms as in `InclinedLanding`."""

    name = "touchdown"
    options_type = TouchdownOptions
    settings: TouchdownOptions
    goal_size = None
    reward_weights = MappingProxyType({"time": -1.0, "bounds": -1.0, "obstacle": -6.0, "impact": -0.5})
    idle_action = IDLE_ACTION
    cut_at_success = False
    table = "touchdown"
    drawn_vehicles = (3,)  # in the plane nothing answers what pushes sideways
    training = Training(
        steps=2_000_000,  # after one million, one of ten seeds loses starts at the edge of the room
        curriculum="touchdown",
        integrator="RK4",  # in which springy contact comes to rest
        keep_out=0.0,
        start_from="descent",  # the law of train.descent, so:
        learning_rate=3e-4,
        log_std_init=-2.2,  # little noise, or what it taught is lost
        gamma=0.998,  # a long discount, or it comes in too fast
        environments=128,
        batch_size=1024,
    )
    curricula = ("touchdown",)
    training_conditions = None
    score_curve = ScoreCurve("at_rest", "at rest on the slope [%]")

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **options)
        self.observe_contact = self.settings.observe_contact
        self.conditions = TouchdownConditions()
        if self.observe_contact:
            self.observation_names = (*self.observation_names, "feet")
            self.observation_scale = np.append(self.observation_scale, 1.0)
        self.goal_height = float(geometry.reach_below(self._shapes, part="feet"))  # at rest on the feet, m
        self._weight = self.vehicle.body_mass * self.vehicle.environment_gravity

    @property
    def rest_position(self) -> tuple[float, float]:
        """(x, z) of a vehicle at rest in the middle of the slope [m]."""
        height = self.goal_height
        x, z = height * math.sin(self.inclination), height * math.cos(self.inclination)
        return x, self.vehicle.platform_surface_height + z

    @property
    def goal(self) -> np.ndarray | None:
        """The observation at rest in the middle of the slope, (5,) or (6,); None where it is observed."""
        if self.observes_slope:
            return None
        rest = [*self.rest_position, 0.0, 0.0, self.inclination]
        return np.array(rest + [1.0] * self.observe_contact)

    @property
    def observation_centre(self) -> np.ndarray:
        """The landing's, and 0 for the contact."""
        centre = super().observation_centre
        return np.append(centre, np.zeros(len(self.observation_names) - len(centre)))

    def prepare(self, plant) -> None:
        """Set a plant up for this task; raises UserError for one without contact."""
        if plant.kind == "analytic":
            raise UserError(
                "the touchdown task needs the MuJoCo plant; the analytic plant does not simulate contact"
            )
        plant.torque_needs_motors = True

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """Return k starts as in the landing task, with the conditions' shares of other ones."""
        c = self.conditions
        start = super().sample(rng, k)
        if c.around_edge > 0.0:
            rows = (rng.random(k) < c.around_edge) & start.present
            start.state[rows] = touchdown_starts.around_edge(self, rng, start[rows])
        if c.close > 0.0:
            rows = (rng.random(k) < c.close) & start.present
            start.state[rows] = touchdown_starts.close(self, rng, start[rows], self.goal_height)
        contact: dict[str, Any] = {}
        if c.friction is not None:
            holds = np.tan(steepest_slopes(start))
            low, high = (np.maximum(f, h * holds) for f, h in zip(c.friction, HELD))
            contact["friction"] = low + (high - low) * rng.random(k) ** 4  # half within 6 % of the range
        if c.restitution is not None:
            low, high = c.restitution
            springy = high - (high - low) * rng.random(k) ** 2  # half within 25 %
            contact |= {"restitution": springy, "contact_time": CONTACT_TIME}
        return dataclasses.replace(start, contact=contact or None)

    def thrust_of(self, other: Task) -> tuple[float, float]:
        """Return 1 and 0; raises UserError where the PWM of an action differs, as idle is an action here."""
        if (other.pwm_centre, other.pwm_span) != (self.pwm_centre, self.pwm_span):
            raise UserError(
                f"the {self.name} task can only continue policies with its pwm_centre and pwm_span"
            )
        return 1.0, 0.0

    def observe(self, context: StepContext) -> np.ndarray:
        """Return the landing task's observations, float32, and the feet's contact where it is observed."""
        observation = super().observe(context)
        if not self.observe_contact:
            return observation
        if context.contacts is None:
            raise UserError("this touchdown task observes the contact of the feet; pass it to observe")
        return np.column_stack([observation, context.contacts.touch[:, 0, 0].astype(np.float32)])

    def evaluate(self, context: StepContext) -> Evaluation:
        """Return the reward of coming to rest gently, see the module's docstring."""
        weight, contacts, wrong = self.reward_weights, context.contacts, wrong_contact(context.contacts)
        idle = context.actions[:, 0] <= IDLE_ACTION
        holding = resting(context.state, context.platform, idle, contacts)
        excess = np.maximum(contacts.force[:, 0, 0] / self._weight - GENTLE_FORCE, 0.0)
        terms = {
            "time": weight["time"] * ~holding,
            "bounds": weight["bounds"] * (~wrong & self.near_bounds(context)),
            "obstacle": weight["obstacle"] * wrong,
            "impact": weight["impact"] * self.conditions.impact_share * excess,
        }
        success = holding & (context.held_steps + 1 >= HOLD_STEPS)
        return self.end_in_training(context, Evaluation(terms, success, holding=holding))

    def end_in_training(self, context: StepContext, evaluation: Evaluation) -> Evaluation:
        """Return an evaluation with the ends that only training has, of `TouchdownConditions`."""
        c, success = self.conditions, evaluation.success
        over = self.has_left(context)
        if c.contact_limit:
            over |= wrong_contact(context.contacts) & (context.in_contact >= c.contact_limit)
        over &= ~success
        if not c.out_of_bounds_penalty:
            return dataclasses.replace(evaluation, cut=over)
        evaluation.terms["out_of_bounds"] = -c.out_of_bounds_penalty * over
        return dataclasses.replace(evaluation, terminated=success | over)

    def evaluation_starts(self, rng: np.random.Generator, k: int) -> Start:
        """Return k random starts of the task itself, each with friction and restitution drawn."""
        before, self.conditions = (
            self.conditions,
            TouchdownConditions(friction=FRICTION, restitution=RESTITUTION),
        )
        try:
            return self.sample(rng, k)
        finally:
            self.conditions = before

    def score(self, flights: Sequence) -> dict[str, float]:
        """Return the share of the flights that come to rest."""
        rest = float(np.mean([flight.success for flight in flights]))
        return {"score": rest, "at_rest": rest}

    def flight_words(self, flight) -> str:
        """Return when a flight came to rest, if it did."""
        return f"at rest on the slope after {flight.duration:.2f} s" if flight.success else "not at rest"


class SlopeTouchdown(InclinedTouchdown, SlopeLanding):
    """The touchdown in the plane on slopes that differ from episode to episode."""


class SpaceTouchdown(InclinedTouchdown, SpaceLanding):
    """The touchdown in space, on slopes that face any way."""


class MovingTouchdown(InclinedTouchdown, MovingLanding):
    """The touchdown in space on platforms that move."""

    table = "moving"


def steepest_slopes(start: Start) -> np.ndarray:
    """Return the steepest (k,) that the platforms of starts become, with their waves [rad]."""
    slope = np.abs(start.inclination)
    return slope if start.motion is None else slope + swell.largest_tilt(start.motion.amplitude)


def wrong_contact(contacts) -> np.ndarray:
    """Return (n,) bool: body or rotors touch the slab, or anything touches the base."""
    return contacts.touch[:, 0, 1:].any(axis=1) | contacts.touch[:, 1].any(axis=1)


def resting(
    state: np.ndarray, platform: np.ndarray, idle: np.ndarray, contacts, speed=REST_SPEED, rate=REST_RATE
) -> np.ndarray:
    """Return (n,) bool: on the feet alone, slower than `speed` [m/s] and `rate` [rad/s], motors at idle.

    Both are relative to the platform (n, 12) and its point where the vehicle is. idle: (n,) bool, of the
    motors.
    """
    _, velocity, turning = surface.relative(state, platform)
    return (
        idle
        & contacts.touch[:, 0, 0]
        & ~wrong_contact(contacts)
        & (np.linalg.norm(velocity, axis=1) < speed)
        & (np.linalg.norm(turning, axis=1) < rate)
    )
