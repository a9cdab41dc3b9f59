"""`InclinedTouchdown`: come to rest on the slope, on the feet, motors at idle, by the policy's own command.

Nothing outside ends the flight: there is no goal box and nobody who cuts the motors in it. The contact
is real, so that only the MuJoCo plant can judge this task.

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

Motors at idle make no attitude torque either.

A moment is *held* when feet and nothing else touch the slab, nothing touches the base, the vehicle is
slower than 0.05 m/s and turns slower than 1 rad/s, both against the slab where it stands, and the motors
are at idle by command. Success is 0.3 s (15 steps) held without a break.

Reward per step: 0 while held; otherwise -1 (`time`), a further -1 near the bounds of the arena
(`bounds`), a further -6 when body or rotors touch the slab or anything touches the base (`obstacle`);
and at any time -0.5 for each weight that the force on the feet exceeds two weights by (`impact`), which
asks for a soft touchdown.

An episode ends with success, or is truncated after 300 steps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.base import (
    Judgement,
    Moment,
    ScoreCurve,
    Start,
    Task,
    Training,
    hover_states,
)
from inclined_landing.envs.tasks.landing import START_CLEARANCE, InclinedLanding
from inclined_landing.envs.tasks.landing import Conditions as LandingConditions
from inclined_landing.envs.tasks.options import option
from inclined_landing.envs.tasks.platform import LandingOptions
from inclined_landing.models import geometry, surface
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, VZ, YAW, X, Y, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

IDLE_ACTION = -0.9  # thrust actions up to this one command PWM 0
REST_SPEED = 0.05  # m/s
REST_RATE = 1.0  # rad/s: the feet are then slower than 0.05 m/s too; on springy contact it trembles with 0.5
HOLD_STEPS = 15  # 0.3 s
GENTLE_FORCE = 2.0  # force on the feet that costs nothing, in weights
IMPACT = 0.5  # reward lost for each weight beyond it
CONTACT_TIME = 0.02  # s, wherever a restitution is set
FRICTION, RESTITUTION = (0.55, 1.2), (0.0, 0.5)  # spread of the contact in training and its evaluation
# Training starts close to the slope: these bounds times a number from 0 (at rest on the slope) to 1.
_CLOSE_HEIGHT = 0.25  # m over the height at rest
_CLOSE_PITCH = 0.15  # rad to both sides of the inclination
_CLOSE_FALL = 0.8  # m/s into the surface
_CLOSE_SPEED = 0.5  # m/s along it, both ways
_CLOSE_THRUST = (0.3, 1.1)  # lag state as a share of hover
_CLOSE_ALONG = 0.25  # m to both sides of the centre, always
_CLOSE_ACROSS = 0.6  # of the slab's half depth to both sides, always, in space
# Training starts around the raised edge, in half lengths of the slab towards it from the centre.
_BESIDE = (-1.0, 2.5)


@dataclasses.dataclass(frozen=True)
class Conditions(LandingConditions):
    """Under which conditions episodes begin. The defaults are the task; the rest are training aids.

    contact_limit ends episodes on the wrong parts. With an `out_of_bounds_penalty`, about the return of
    staying there, episodes that it or leave_limit ends are terminated; without one they are truncated.
    """

    beside: float = 0.0  # share of the episodes that begin around the raised edge, mostly low
    close: float = 0.0  # share of the episodes that begin just over the slope, in any motion
    impact: float = IMPACT  # reward lost for each weight of force beyond two
    friction: tuple[float, float] | None = None  # drawn per episode; None: the plant's own
    restitution: tuple[float, float] | None = None


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
    idle_action = IDLE_ACTION
    cut_at_success = False
    table = "touchdown"
    training = Training(
        steps=1_500_000,
        curriculum="touchdown",
        integrator="RK4",  # in which springy contact comes to rest
        keep_out=0.0,
        learning_rate=4e-4,
        log_std_init=-1.2,
        start_from="landing",
    )
    curricula = ("touchdown",)
    training_conditions = None
    score_curve = ScoreCurve("at_rest", "at rest on the slope [%]")

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **options)
        self.observe_contact = self.settings.observe_contact
        self.conditions = Conditions()
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
            raise UserError("the touchdown task needs the MuJoCo plant: in the analytic one nothing is felt")
        plant.torque_needs_motors = True

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """k starts: as in the landing task, but for the conditions' shares of others."""
        c = self.conditions
        start = super().sample(rng, k)
        if c.beside > 0.0:
            beside = (rng.random(k) < c.beside) & start.present
            start.state[beside] = self._along(
                start[beside], self._beside(rng, self.at_standstill(start[beside]))
            )
        if c.close > 0.0:
            close = (rng.random(k) < c.close) & start.present
            start.state[close] = self._along(
                start[close], self._close(rng, self.at_standstill(start[close])), True
            )
        contact: dict[str, Any] = {}
        if c.friction is not None:
            contact["friction"] = rng.uniform(*c.friction, k)
        if c.restitution is not None:
            contact |= {"restitution": rng.uniform(*c.restitution, k), "contact_time": CONTACT_TIME}
        return dataclasses.replace(start, contact=contact or None)

    def _beside(self, rng: np.random.Generator, start: Start) -> np.ndarray:
        """States (k, 13) at rest around the raised edge, where the way to the slope leads over it.

        Half of them lie in the lowest quarter of the start box. start: as drawn, with slopes and headings.
        """
        k = len(start.state)
        uphill = np.where(start.inclination > 0.0, -1.0, 1.0) * self.vehicle.slab_half_length
        (*_, low), (*_, high) = self.start_box()
        positions = np.zeros((k, 3))
        todo = np.arange(k)
        beside = dataclasses.replace(start, state=np.zeros((k, STATE_SIZE)), present=np.ones(k, bool))
        while len(todo):
            positions[todo, 0] = uphill[todo] * rng.uniform(*_BESIDE, len(todo))
            positions[todo, 2] = low + (high - low) * rng.random(len(todo)) ** 2
            state = hover_states(positions[todo], self.vehicle)
            beside.state[todo] = self._into_space(rng, state, start[todo])
            todo = todo[self.start_clearance(beside[todo]) < START_CLEARANCE]
        return beside.state

    def _along(self, start: Start, state: np.ndarray, moving: bool = False) -> np.ndarray:
        """States (k, 13) over decks in their usual place as states over those of the starts.

        moving: they move along with the decks' centres.
        """
        if start.motion is None:
            return state
        deck = start.decks(self.vehicle)
        state[:, : Z + 1] += deck[:, : Z + 1]
        state[:, Z] -= self.vehicle.platform_surface_height
        if moving:
            state[:, VX : VZ + 1] += deck[:, VX : VZ + 1]
        return state

    def _into_space(self, rng: np.random.Generator, state: np.ndarray, start: Start) -> np.ndarray:
        """States (k, 13) in the plane of their slopes, shifted across it and turned with the slopes.

        They take the headings of the starts. In the plane they stay as they are.
        """
        if start.azimuth is None:
            return state
        state, half = state.copy(), 0.5 * self.vehicle.platform_depth
        state[:, Y] += rng.uniform(-_CLOSE_ACROSS * half, _CLOSE_ACROSS * half, len(state))
        state = surface.turned(state, start.azimuth)
        state[:, YAW] = start.state[:, YAW]
        return state

    def _close(self, rng: np.random.Generator, start: Start) -> np.ndarray:
        """States (k, 13) just over the slope, in motion; start: as drawn, with slopes and headings."""
        inclination = start.inclination
        k, v = len(inclination), self.vehicle
        sin, cos = np.sin(inclination), np.cos(inclination)  # along (cos, -sin), normal (sin, cos)
        far = rng.random(k)  # 0: at rest on the feet, motors at idle
        along = rng.uniform(-_CLOSE_ALONG, _CLOSE_ALONG, k)
        height = self.goal_height + far * _CLOSE_HEIGHT
        speed = far * rng.uniform(-_CLOSE_SPEED, _CLOSE_SPEED, k)
        fall = far * rng.uniform(0.0, _CLOSE_FALL, k)
        state = np.zeros((k, STATE_SIZE))
        state[:, X] = along * cos + height * sin
        state[:, Z] = v.platform_surface_height - along * sin + height * cos
        state[:, VX] = speed * cos - fall * sin
        state[:, VZ] = -speed * sin - fall * cos
        state[:, PITCH] = inclination + far * rng.uniform(-_CLOSE_PITCH, _CLOSE_PITCH, k)
        state[:, LAG] = v.hover_lag * far * rng.uniform(*_CLOSE_THRUST, k)
        state = self._into_space(rng, state, start)
        if start.azimuth is not None:
            roll, pitch = surface.standing(inclination, start.azimuth - state[:, YAW])
            state[:, ROLL] = roll + far * rng.uniform(-_CLOSE_PITCH, _CLOSE_PITCH, k)
            state[:, PITCH] += pitch - inclination
        return state

    def thrust_of(self, other: Task) -> tuple[float, float]:
        """As they are; raises UserError where the PWM of an action differs, as idle is an action here."""
        if (other.pwm_centre, other.pwm_span) != (self.pwm_centre, self.pwm_span):
            raise UserError(
                f"the {self.name} task goes on only from policies of its own pwm_centre and pwm_span"
            )
        return 1.0, 0.0

    def observe(self, moment: Moment) -> np.ndarray:
        """That of the landing task, float32, and the feet's contact where it is observed."""
        observation = super().observe(moment)
        if not self.observe_contact:
            return observation
        if moment.contacts is None:
            raise UserError("this touchdown task observes the feet's contact; give it to observe")
        return np.column_stack([observation, moment.contacts.touch[:, 0, 0].astype(np.float32)])

    def judge(self, moment: Moment) -> Judgement:
        """See the module's docstring."""
        c, state, contacts = self.conditions, moment.state, moment.contacts
        wrong, in_arena = wrong_contact(contacts), self.in_arena(moment)
        holding = resting(state, moment.deck, moment.actions[:, 0] <= IDLE_ACTION, contacts)
        excess = np.maximum(contacts.force[:, 0, 0] / self._weight - GENTLE_FORCE, 0.0)
        terms = {
            "time": -1.0 * ~holding,
            "bounds": -1.0 * (~wrong & self.near_bounds(in_arena)),
            "obstacle": -6.0 * wrong,
            "impact": -c.impact * excess,
        }
        success = holding & (moment.held + 1 >= HOLD_STEPS)
        cut = np.zeros_like(success)
        if c.leave_limit < math.inf:
            cut |= self.near_bounds(in_arena, -c.leave_limit) | contacts.touch[:, 2].any(axis=1)
        if c.contact_limit:
            cut |= wrong & (moment.in_contact >= c.contact_limit)
        cut &= ~success
        if c.out_of_bounds_penalty:
            terms["out_of_bounds"] = -c.out_of_bounds_penalty * cut
            return Judgement(terms, success, success | cut, np.zeros_like(cut), holding)
        return Judgement(terms, success, success, cut, holding)

    def evaluation_starts(self, rng: np.random.Generator, k: int) -> Start:
        """k random starts of the task itself, with a contact of their own each."""
        before, self.conditions = self.conditions, Conditions(friction=FRICTION, restitution=RESTITUTION)
        try:
            return self.sample(rng, k)
        finally:
            self.conditions = before

    def score(self, flights: Sequence) -> dict[str, float]:
        """Share of the flights that come to rest."""
        rest = float(np.mean([flight.success for flight in flights]))
        return {"score": rest, "at_rest": rest}

    def flight_words(self, flight) -> str:
        """When a flight came to rest, if it did."""
        return f"at rest on the slope after {flight.duration:.2f} s" if flight.success else "not at rest"


def wrong_contact(contacts) -> np.ndarray:
    """(n,) bool: body or rotors touch the slab, or anything touches the base."""
    return contacts.touch[:, 0, 1:].any(axis=1) | contacts.touch[:, 1].any(axis=1)


def resting(
    state: np.ndarray, deck: np.ndarray, idle: np.ndarray, contacts, speed=REST_SPEED, rate=REST_RATE
) -> np.ndarray:
    """(n,) bool: on the feet and nothing else, slower than `speed` [m/s], turning slower than `rate` [rad/s].

    Both are relative to the deck (n, 12) and its point where the vehicle is. idle: (n,) bool, of the motors.
    """
    _, velocity, turning = surface.relative(state, deck)
    return (
        idle
        & contacts.touch[:, 0, 0]
        & ~wrong_contact(contacts)
        & (np.linalg.norm(velocity, axis=1) < speed)
        & (np.linalg.norm(turning, axis=1) < rate)
    )
