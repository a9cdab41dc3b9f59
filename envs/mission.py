"""Missions from anywhere in the room to rest on the slope, flown by several policies in turn.

A mission has up to four legs, each flown by a policy for its own task:

1. climb: a vehicle that begins well below the hand-over point climbs vertically, so that its path leads
   over the platform (set-point policy);
2. approach: to the hand-over point, in the plane y = 0, until the vehicle has been near it and slow for a
   short time (set-point policy);
3. landing: until success by the task of the landing policy, which is the goal box;
4. touchdown: until the vehicle rests on its feet with motors at idle, as commanded by the touchdown policy.

Policies for planar tasks command no roll; the set-point policy's roll then keeps y at 0 (`Setpoint.across`).
The heading is held in all legs. Commands of the policies are not changed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.flights import Track
from inclined_landing.envs.history import History
from inclined_landing.envs.hover import (
    CLEAR,
    HAND_OVER,
    HAND_OVER_SPEED,
    HAND_OVER_TIME,
    TOLERANCE,
    YAW_GAIN,
    Trim,
)
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import (
    InclinedLanding,
    InclinedTouchdown,
    Setpoint,
    StepContext,
    hover_states,
)
from inclined_landing.envs.tasks.setpoint import START_BOX
from inclined_landing.models.attitude import VX, VZ, YAW, YAW_RATE_COMMAND, X, Y, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import SURFACES
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.vehicle import Vehicle

LEGS = ("climb", "approach", "landing", "touchdown")
CLIMB, APPROACH, LANDING, TOUCHDOWN = range(len(LEGS))
ENDS = ("at rest", "time limit", "fell to the floor", "left the arena")
AT_REST, LATE, FLOOR, OUTSIDE = range(len(ENDS))
FLYING = -1
CLIMB_BELOW = 0.25  # m under the hand-over point; who is higher flies straight to it
APPROACH_LIMIT = 10.0  # s, climb included
LEAVE_LIMIT = 0.3  # m outside the arena
_STEP = 0.05  # m between the points at which a way is checked


@dataclasses.dataclass(frozen=True)
class MissionPlan:
    """Policies of a mission, and the point of the hand-over to the landing policy.

    Raises UserError for incompatible policies and for a point too close to the platform.
    """

    setpoint: Policy
    landing: Policy
    touchdown: Policy
    hand_over: tuple[float, float] = HAND_OVER  # x, z of the point [m], in the plane y = 0

    def __post_init__(self):
        required = ("setpoint", Setpoint), ("landing", InclinedLanding), ("touchdown", InclinedTouchdown)
        for policy, (leg, kind) in zip(self.policies, required):
            task = policy.task
            boxless = kind is InclinedLanding and task.goal_size is None
            if not isinstance(task, kind) or boxless:
                raise UserError(f"the {leg} policy {policy.name} is for the task {task.name}")
            # Their attitude command limits may differ.
            limit = self.task.vehicle.command_angle_limit
            if task.vehicle.changed(command_angle_limit=limit) != self.task.vehicle:
                raise UserError(
                    f"the {leg} policy {policy.name} is for a different vehicle than the previous one"
                )
        first, last = slope_normal(self.landing.task), slope_normal(self.task)
        if not np.allclose(first, last, atol=1e-6):
            slopes = (math.degrees(math.acos(facing[2])) for facing in (first, last))
            text = "landing policy for one of {:.1f} deg, touchdown policy for {:.1f} deg".format(*slopes)
            raise UserError(f"the policies are for different slopes: {text}")
        if abs(last[1]) > 1e-6:
            raise UserError("missions need slopes along x; omit the azimuth of the tasks")
        v, (x, z) = self.vehicle, self.hand_over
        top = v.platform_surface_height + v.slab_half_length * abs(math.sin(self.task.inclination))
        low, high = (v.arena_x[0] + CLEAR, top + CLEAR), (v.arena_x[1] - CLEAR, v.arena_z[1] - CLEAR)
        if not (low[0] <= x <= high[0] and low[1] <= z <= high[1]):
            raise UserError(
                f"the hand-over point must lie above the platform and {CLEAR:g} m inside the arena, x from "
                f"{low[0]:g} to {high[0]:g} m and z from {low[1]:.2f} to {high[1]:g} m, not at {x:g},{z:g}"
            )

    @property
    def policies(self) -> tuple[Policy, Policy, Policy]:
        """Policies for set-point flight, landing and touchdown."""
        return self.setpoint, self.landing, self.touchdown

    @property
    def task(self) -> InclinedTouchdown:
        """Task of the last leg."""
        return self.touchdown.task  # type: ignore[return-value]

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle of the tasks, with the largest attitude command limit of them."""
        limit = max(policy.task.vehicle.command_angle_limit for policy in self.policies)
        return self.task.vehicle.changed(command_angle_limit=limit)

    @property
    def point(self) -> np.ndarray:
        """Hand-over point (3,) [m]."""
        return np.array([self.hand_over[0], 0.0, self.hand_over[1]])

    def in_box(self, state: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of states near the hand-over point and slow."""
        away = np.linalg.norm(state[:, X : Z + 1] - self.point, axis=1)
        return (away < TOLERANCE) & (np.linalg.norm(state[:, VX : VZ + 1], axis=1) < HAND_OVER_SPEED)

    def admissible(self, starts: np.ndarray) -> np.ndarray:
        """Return a mask (k,) of the starts (k, 3) [m] from which a mission may begin.

        They are inside the set-point task's START_BOX, and a climb from there to the height of the hand-over
        point keeps the distance CLEAR from the platform.
        """
        landing = self.landing.task
        low, high = np.array(START_BOX).T
        free = ((starts >= low) & (starts <= high)).all(axis=1)
        for height in np.arange(low[Z], self.hand_over[1] + _STEP, _STEP):
            raised = starts[free]
            raised[:, Z] = np.maximum(raised[:, Z], height)
            states = hover_states(raised, self.vehicle)
            free[free] = landing.start_clearance(landing.start(states)) >= CLEAR
        return free

    def check_starts(self, starts: np.ndarray) -> None:
        """Raise UserError, naming the first, unless all starts (k, 3) [m] are `admissible`."""
        for start in starts[~self.admissible(starts)][:1]:
            text = ",".join(f"{value:g}" for value in start)
            box = ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in zip("xyz", START_BOX))
            raise UserError(
                f"start {text} lies within {CLEAR:g} m of the platform, under it, or outside the set-point "
                f"task's starts ({box} m)"
            )

    def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Return n starts (n, 3) [m], uniform over the `admissible` ones of the set-point task.

        With the same generator, fewer starts are the first ones of more.
        """
        low, high = np.array(START_BOX).T
        found = np.empty((0, 3))
        while len(found) < n:
            drawn = rng.uniform(low, high, (n, 3))
            found = np.concatenate([found, drawn[self.admissible(drawn)]])
        return found[:n]


@dataclasses.dataclass(frozen=True)
class Leg:
    """One leg of a mission."""

    name: str  # of LEGS
    began: float  # s
    duration: float  # s
    done: bool  # did it hand over to the next one, or come to rest
    state: np.ndarray  # (13,) at its end
    touched: tuple[str, ...]  # of SURFACES


@dataclasses.dataclass(kw_only=True)
class Mission(Track):
    """One flown mission."""

    plan: MissionPlan
    leg: np.ndarray  # (T,) index into LEGS: who commands from t[k] on
    legs: tuple[Leg, ...]  # those that were flown
    end: str  # of ENDS

    @property
    def success(self) -> bool:
        """Return whether the mission ended at rest on the feet with motors at idle."""
        return self.end == ENDS[AT_REST]

    @property
    def goals(self) -> list[np.ndarray]:
        """Hand-over point and rest on the slope, as states (13,)."""
        return [*hover_states(self.plan.point[None], self.plan.vehicle), *super().goals]

    @property
    def summary(self) -> str:
        """Return the outcome in one line."""
        if self.success:
            return f"at rest on the slope after {self.t[-1]:.2f} s"
        return f"{self.end} in the {self.legs[-1].name} after {self.t[-1]:.2f} s"

    def find_leg(self, name: str) -> Leg | None:
        """Return the leg of this name; None if it was not flown."""
        return next((leg for leg in self.legs if leg.name == name), None)


def slope_normal(task) -> np.ndarray:
    """Return the unit normal (3,) of a task's slope, equal for -20 deg and 20 deg turned by 180 deg."""
    flat = math.sin(task.inclination)
    return np.array(
        [flat * math.cos(task.azimuth), flat * math.sin(task.azimuth), math.cos(task.inclination)]
    )


def fly_missions(
    plan: MissionPlan, starts: np.ndarray, on_progress: Callable[[int], None] = lambda count: None
) -> list[Mission]:
    """Fly a mission from hover at each of starts (n, 3) [m], all at once in MuJoCo (RK4, 4 ms); return them.

    The result of a mission does not depend on the number of others. on_progress: called after every control
    step with the number of finished missions. Raises UserError for a start where no mission can begin.
    """
    starts = np.atleast_2d(np.asarray(starts, float))
    plan.check_starts(starts)
    flying = _MissionBatch(plan, hover_states(starts, plan.vehicle))
    while (flying.end == FLYING).any():
        flying.step()
        on_progress(int((flying.end != FLYING).sum()))
    return flying.missions()


class _MissionBatch:
    """Missions in flight: n vehicles of one plant, each in its own leg."""

    def __init__(self, plan: MissionPlan, states: np.ndarray):
        n = len(states)
        everyone = np.arange(n)
        self.plan, self.plant = plan, MujocoPlant(n, plan.vehicle)
        self.hover: Setpoint = plan.setpoint.task  # type: ignore[assignment]
        self.past, self.trim = History(self.hover, n), Trim(n)
        runners = {LANDING: plan.landing, TOUCHDOWN: plan.touchdown}
        self.runners = {leg: (policy, BatchEnv(policy.task, self.plant)) for leg, policy in runners.items()}
        self.plant.set_platform(everyone, plan.task.inclination)
        self.plant.reset(everyone, states)
        self.leg, self.end = np.full(n, CLIMB), np.full(n, FLYING)
        self.target = states[:, X : Z + 1].copy()  # (n, 3) m, of set-point flight
        self.target[:, Z] = plan.hand_over[1]
        self.near = np.zeros(n, int)  # control steps in a row in the hand-over box
        self.last = np.zeros(n, int)  # control step in which the mission ended
        self.touched = np.zeros((n, len(LEGS), len(SURFACES)), bool)
        self.states = [self.plant.state.copy()]
        self.commands: list[np.ndarray] = []
        self.legs: list[np.ndarray] = []
        self._enter(CLIMB, everyone >= 0)
        self._enter(APPROACH, self._above_climb())
        self._enter(LANDING, plan.in_box(self.plant.state))

    @property
    def steps_flown(self) -> int:
        """Number of control steps so far."""
        return len(self.commands)

    def step(self) -> None:
        """Run one control step of all vehicles in flight."""
        self.legs.append(self.leg.copy())
        self.commands.append(self._command())
        self.plant.step(self.commands[-1], self.end == FLYING)
        self.states.append(self.plant.state.copy())
        self._advance_legs()

    def _command(self) -> np.ndarray:
        """Return commands (n, 4): those of the set-point policy, replaced by the policies of later legs."""
        plan, seen = self.plan, self._setpoint_observation()
        actions = plan.setpoint.predict(self.past.stack(seen))
        self.past.record(seen, actions)
        commands = self.hover.commands(actions)
        limit = plan.vehicle.command_yaw_rate_limit
        commands[:, YAW_RATE_COMMAND] = np.clip(-YAW_GAIN * self.plant.measurement[:, YAW], -limit, limit)
        for leg, (policy, env) in self.runners.items():
            ids = self._ids_in_leg(leg)
            if len(ids):
                actions = np.zeros((env.n, len(env.task.action_names)))
                actions[ids] = policy.predict(env.observe(ids))
                env.act(actions)
                columns = np.ix_(ids, [channel.column for channel in env.task.channels])
                commands[columns] = env.commands[columns]
        return commands

    def _setpoint_observation(self) -> np.ndarray:
        """Return the set-point policy's observation (n, o): relative to the target, or to y = 0 in later
        legs.
        """
        state, trim = self.plant.measurement, self.trim.offset
        target, across = self.hover.shifted(state, self.target + trim), self.hover.across(state, trim[:, Y])
        return self.hover.observe(StepContext(np.where(self.leg[:, None] <= APPROACH, target, across)))

    def _advance_legs(self) -> None:
        """Evaluate the step: vehicles enter the next leg or end their mission."""
        plan, state, contacts = self.plan, self.plant.state, self.plant.contacts
        period = self.plant.control_period
        flying = np.flatnonzero(self.end == FLYING)
        self.touched[flying, self.leg[flying]] |= contacts.touch[flying].any(axis=2)
        outcomes = {
            leg: env.outcome() for leg, (_, env) in self.runners.items() if len(self._ids_in_leg(leg))
        }
        settling = (self.leg <= APPROACH) & (np.linalg.norm(state[:, VX : VZ + 1], axis=1) < HAND_OVER_SPEED)
        self.trim.integrate(self.target - state[:, X : Z + 1], period, settling)
        self.near = np.where(plan.in_box(state), self.near + 1, 0)
        arrived = (self.leg == APPROACH) & (self.near * period >= HAND_OVER_TIME - 1e-9)
        self._stop(OUTSIDE, self._outside())
        self._stop(FLOOR, contacts.touch[:, SURFACES.index("floor")].any(axis=1))
        late = (self.leg <= APPROACH) & ~arrived
        self._stop(LATE, late & (self.steps_flown * period >= APPROACH_LIMIT - 1e-9))
        for leg, outcome in outcomes.items():
            over = (outcome.terminated | outcome.truncated) & ~outcome.success
            self._stop(LATE, over & (self.leg == leg))
            if leg == TOUCHDOWN:
                self._stop(AT_REST, outcome.success & (self.leg == leg))
        if LANDING in outcomes:
            self._enter(TOUCHDOWN, outcomes[LANDING].success & (self.leg == LANDING))
        self._enter(LANDING, arrived)
        self._enter(APPROACH, (self.leg == CLIMB) & self._above_climb())

    def _ids_in_leg(self, leg: int) -> np.ndarray:
        """Return the indices of the vehicles that fly this leg."""
        return np.flatnonzero((self.leg == leg) & (self.end == FLYING))

    def _above_climb(self) -> np.ndarray:
        """Return a mask (n,) of vehicles high enough to fly straight to the hand-over point."""
        return self.plant.state[:, Z] >= self.plan.hand_over[1] - CLIMB_BELOW

    def _outside(self) -> np.ndarray:
        """Return a mask (n,) of vehicles too far outside the arena."""
        v, place = self.plan.vehicle, self.plant.state[:, X : Z + 1]
        low, high = np.array([v.arena_x, v.arena_y, v.arena_z]).T
        return ((place < low - LEAVE_LIMIT) | (place > high + LEAVE_LIMIT)).any(axis=1)

    def _stop(self, end: int, mask: np.ndarray) -> None:
        """End the missions of `mask` (n,) bool that have not ended yet."""
        now = mask & (self.end == FLYING)
        self.end[now], self.last[now] = end, self.steps_flown

    def _enter(self, leg: int, mask: np.ndarray) -> None:
        """Enter this leg with the vehicles of `mask` (n,) bool that have not ended."""
        ids = np.flatnonzero(mask & (self.end == FLYING))
        if not len(ids):
            return
        self.leg[ids] = leg
        if leg == APPROACH:
            self.target[ids] = self.plan.point
        self.past.reset(ids, self._setpoint_observation()[ids])
        if leg in self.runners:
            self.runners[leg][1].begin_in_place(ids)

    def missions(self) -> list[Mission]:
        """Return the missions as flown."""
        every = np.array(self.states), np.array(self.commands), np.array(self.legs)
        return [self._mission(k, *(rows[:, k] for rows in every)) for k in range(len(self.end))]

    def _mission(self, k: int, state: np.ndarray, commands: np.ndarray, leg: np.ndarray) -> Mission:
        """Return the mission of vehicle k from rows (T, 13), (T - 1, 4) and (T - 1,) of all."""
        last = self.last[k]
        rows = np.minimum(np.arange(last + 1), last - 1)
        return Mission(
            task=self.plan.task,
            t=self.plant.control_period * np.arange(last + 1),
            state=state[: last + 1].copy(),
            commands=commands[rows],
            inclination=self.plan.task.inclination,
            plan=self.plan,
            leg=leg[rows],
            legs=self._legs(k, state, leg[:last]),
            end=ENDS[self.end[k]],
        )

    def _legs(self, k: int, state: np.ndarray, flown: np.ndarray) -> tuple[Leg, ...]:
        """Return the legs of vehicle k from its leg in each control step, `flown` (T - 1,)."""
        period, begins = self.plant.control_period, np.flatnonzero(np.diff(flown, prepend=FLYING))
        ends = [*begins[1:], len(flown)]
        return tuple(
            Leg(
                name=LEGS[flown[began]],
                began=float(period * began),
                duration=float(period * (end - began)),
                done=end < len(flown) or self.end[k] == AT_REST,
                state=state[end].copy(),
                touched=tuple(name for name, was in zip(SURFACES, self.touched[k, flown[began]]) if was),
            )
            for began, end in zip(begins, ends)
        )
