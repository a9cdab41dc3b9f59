"""`InclinedLanding`: reach the landing pose over a slope, the paper's planar task.

Observation, float32, unbounded:

| index | quantity | unit | inside the arena |
|---|---|---|---|
| 0 | x | m | -3.4 to 3.4 |
| 1 | z | m | 0 to 2.4 |
| 2 | vx | m/s | |
| 3 | vz | m/s | |
| 4 | pitch, positive accelerates +x | rad | |

Action, float32, from -1 to 1; roll and yaw-rate commands are zero:

| index | command | at action a | MuJoCo actuator |
|---|---|---|---|
| 0 | thrust | PWM = centre + span a, cut to 10000 .. 60000 | `thrust` |
| 1 | pitch | 30 deg times a | `pitch` |

The centre is the hover of the vehicle with its effects on the thrust, a number, the paper's 42000
(`pwm_centre="paper"`), or the hover of the flown vehicle (`pwm_centre="own"`); the span is 16500 as in the
paper, or `pwm_span`. A policy observes neither: `load_policy(POLICY, task)` refuses one that was trained with
other values.

Goal s_g = [0, 1.25, 0, 0, inclination]; goal box |s - s_g| < [d, d, min(10d, 1.5), min(10d, 1.5),
0.25d] with d from 0.25 (easiest) to 0.10 (the task).

Reward per step: 0 in the goal box; otherwise -1 (`time`), a further -1 near the bounds of the arena
(`bounds`), or a further -6 on the platform (`obstacle`): the paper's -1, -2 and -7.

An episode ends in the goal box, or is truncated after 300 steps. The goal box is not yet a landing:
its centre hovers 9 cm above the slope, and entries into it may be moving.

Options change the task, as described below: any slope with `steepest` (`slopes.py`), in space with
`dimensions=3` (`space.py`), over moving platforms with `fastest` (`moving.py`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numba
import numpy as np

from inclined_landing.envs.tasks.base import (
    COLUMNS,
    Evaluation,
    ScoreCurve,
    Start,
    StepContext,
    Task,
    Training,
    hover_states,
)
from inclined_landing.envs.tasks.platform import LandingOptions, in_platform
from inclined_landing.models import geometry
from inclined_landing.models.attitude import PITCH, VX, VZ, X, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle

GOAL_HEIGHT = 0.10  # of the goal above the centre of the surface, m
GOAL_SIZE = 0.10  # d of the task itself
EASIEST_GOAL_SIZE = 0.25
BOUND_MARGIN = 0.05  # closer than this to the arena's bounds counts as near them, m
START_CLEARANCE = 0.05  # starts keep this distance to the platform, m
START_MARGIN = 0.10  # and this one to the arena's bounds, m
_UNMOVED = np.empty((0, 12))  # platforms that carry no bounds along
LOWEST_START = 1.2  # random starts lie in the upper half of the arena, m
PAPER_STARTS = ((0.0, 2.0), (-1.5, 1.6), (1.5, 1.8))  # x, z of the paper's table
PAPER_RESULTS = (
    {"count": 28, "of": 30, "share": 28 / 30},
    {"share": 0.867},
)  # of 30 starts, and of its scattered ones


@dataclasses.dataclass(frozen=True)
class LandingConditions:
    """Conditions under which episodes begin. The defaults are the task; a curriculum passes easier ones.

    The last five fields are training aids: the task itself never uses them.
    """

    start_reach: float = 3.3  # starts lie within this of the goal in x and y, m
    start_reach_z: float | None = None  # and in z; None: the same
    tilt: float = 1.0  # goal and platform inclination as a share of the task's
    motion: float = 1.0  # speed and swell of platforms as a share of the task's
    goal_size: float = GOAL_SIZE  # d
    platform: float = 1.0  # share of the episodes with a platform
    lowest_start: float = LOWEST_START  # m
    contact_limit: int = 0  # truncate after this many steps in contact (0: never)
    leave_limit: float = math.inf  # truncate this far outside the arena, or on the floor, m
    out_of_bounds_penalty: float = 0.0  # above 0, passing leave_limit costs it and terminates the episode
    steep: float = 0.0  # share of the drawn slopes that are nearly the steepest ones
    goal_while_touching: bool = True  # does the goal box count while touching the platform


# After a real contact the vehicle lies on the slab for the rest of the episode, and from outside the arena it
# rarely comes back; neither teaches anything, so the episode ends. A truncation would bootstrap from the
# critic's value of states whose successors it never saw, and a policy may then go on falling past the goal
# from half of the starts. So it terminates, with the return of staying there: 2 a step, discounted by 0.98.
AIDED = LandingConditions(
    contact_limit=8, leave_limit=0.3, out_of_bounds_penalty=100.0, goal_while_touching=False
)


@numba.njit(cache=True, inline="always")
def goal_box(d):
    """Return half widths of x, z, vx, vz and pitch of the goal box of size d."""
    speed = min(10 * d, 1.5)
    return d, d, speed, speed, 0.25 * d


@numba.njit(cache=True)
def _in_goal(state, goal, goal_size, inclination, out):
    for i in range(len(state)):
        s, (x, z, vx, vz, pitch) = state[i], goal_box(goal_size[i])
        out[i] = (
            abs(s[X] - goal[0]) < x
            and abs(s[Z] - goal[1]) < z
            and abs(s[VX]) < vx
            and abs(s[VZ]) < vz
            and abs(s[PITCH] - inclination[i]) < pitch
        )
    return out


@numba.njit(cache=True)
def _near_bounds(state, platform, axes, arena, margin, extra_room, out):
    for k in range(len(axes)):
        axis = axes[k]
        carried = axis != Z and len(platform) > 0
        m = margin if axis == Z else margin - extra_room
        low, high = arena[k, 0] + m, arena[k, 1] - m
        for i in range(len(state)):
            place = state[i, axis] - platform[i, axis] if carried else state[i, axis]
            out[i] |= place < low or place > high
    return out


class InclinedLanding(Task):
    """The planar task for vehicles of one kind; `make_task` finds the class for other options."""

    name = "landing"
    observation_names: tuple[str, ...] = ("x", "z", "vx", "vz", "pitch")
    observation_scale: np.ndarray = np.array([1.0, 1.0, 2.0, 2.0, 0.5])
    action_names: tuple[str, ...] = ("thrust", "pitch")
    options_type = LandingOptions
    settings: LandingOptions
    has_platform = True
    is_planar = True
    goal_size: float | None = GOAL_SIZE
    reward_weights: Mapping[str, float] = MappingProxyType({"time": -1.0, "bounds": -1.0, "obstacle": -6.0})
    cut_at_success = True
    shipped = True
    table = "goal_box"
    drawn_vehicles: tuple[int, ...] = (2, 3)
    training = Training(
        steps=None,
        success=0.99,
        curriculum="adaptive",
        gamma=0.98,
        learning_rate=2e-3,
        rollout=64,
        batch_size=256,
    )
    curricula: tuple[str, ...] = ("adaptive", "fixed", "paper", "none")
    training_conditions: Any = AIDED
    score_curve = ScoreCurve(
        "strict_success",
        "strict success [%]",
        reference=(
            100.0 * PAPER_RESULTS[0]["share"],
            f"paper, one vehicle: {100 * PAPER_RESULTS[0]['share']:.1f} %",
        ),
    )
    start_axes: tuple[str, ...] = ("x", "z")
    film_starts: tuple[tuple[float, ...], ...] = (PAPER_STARTS[2], PAPER_STARTS[0], PAPER_STARTS[1])
    figure_starts: Mapping[str, tuple[float, ...]] = MappingProxyType(
        {"trajectory_above_right": PAPER_STARTS[2], "trajectory_above": PAPER_STARTS[0]}
    )
    extra_room = 0.0  # m by which the arena is wider to all sides

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **options)
        settings, v = self.settings, self.vehicle
        asked = (
            settings.dimensions == 2,
            settings.dimensions == 3 or settings.steepest is not None,
            settings.fastest is not None,
        )
        if asked != (self.is_planar, self.observes_slope, self.platform_moves):
            raise UserError(
                f"{type(self).__name__} does not take these options; make_task({self.name!r}, ...) selects "
                "the class that does, and a custom task must derive from that class"
            )
        usual = self._usual_inclination()
        self.inclination = v.check_inclination(
            usual if settings.inclination is None else settings.inclination
        )
        self._resolve(inclination=self.inclination)
        self.conditions = LandingConditions()
        self._shapes = geometry.shapes_of(compile_scene(v))
        self._fleet = geometry.Fleet.of([self._shapes])
        self._axes = np.array([COLUMNS[name] for name in self.start_axes])
        self._arena = np.array([getattr(v, f"arena_{name}") for name in self.start_axes], float)

    def _usual_inclination(self) -> float:
        return self.vehicle.platform_inclination

    # --- the goal ----------------------------------------------------------------------------------

    @property
    def goal_position(self) -> tuple[float, ...]:
        """(x, z) of the goal [m], over a level platform where the slope is observed; (x, y, z) in space."""
        return *[0.0] * (len(self.start_axes) - 1), self.vehicle.platform_surface_height + GOAL_HEIGHT

    @property
    def goal(self) -> np.ndarray | None:
        """[x z vx vz pitch] (5,) of the goal."""
        return np.array([*self.goal_position, 0.0, 0.0, self.inclination])

    @property
    def goal_half_widths(self) -> np.ndarray | None:
        """(5,) of the goal box around `goal`; None where rest on the slope is the goal instead."""
        return None if self.goal_size is None else np.array(goal_box(self.goal_size), float)

    @property
    def observation_centre(self) -> np.ndarray:
        """The goal, level: (5,)."""
        return np.array([*self.goal_position, 0.0, 0.0, 0.0])

    def in_goal(self, state, goal_size, platform=None, inclination=None) -> np.ndarray:
        """Return (n,) bool: which states (n, 13) are in the paper's goal box of size d = goal_size.

        inclination: that of the platforms, (n,) or a number [rad] (default: the task's).
        """
        of_each = np.empty((2, len(state)))
        of_each[0], of_each[1] = goal_size, self.inclination if inclination is None else inclination
        return _in_goal(state, self.goal_position, *of_each, np.empty(len(state), bool))

    # --- starts ------------------------------------------------------------------------------------

    def start_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corner, (2,) as x, z or (3,) as x, y, z [m], of the box of random starts."""
        c, goal = self.conditions, np.array(self.goal_position)
        reach = np.full(len(goal), c.start_reach)
        if c.start_reach_z is not None:
            reach[-1] = c.start_reach_z
        low = np.maximum(goal - reach, [*(self._arena[:-1, 0] + START_MARGIN), c.lowest_start])
        high = np.minimum(goal + reach, self._arena[:, 1] - START_MARGIN)
        return low, high

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """Return k starts at rest, uniform over the conditions' box, clear of the platform."""
        present = rng.random(k) < self.conditions.platform
        start = self._start(hover_states(np.zeros((k, 3)), self.vehicle), present)
        self._draw_platforms(rng, start)
        return self._place(rng, start)

    def _draw_platforms(self, rng: np.random.Generator, start: Start) -> None:
        """Draw what varies between platforms: here nothing."""

    def _place(self, rng: np.random.Generator, start: Start) -> Start:
        """Draw the places of the starts, clear of the platform."""
        low, high = self.start_box()
        todo = np.arange(len(start.state))
        for _ in range(1000):
            start.state[todo[:, None], self._axes] = low + (high - low) * rng.random((len(todo), len(low)))
            drawn = start if len(todo) == len(start) else start[todo]
            todo = todo[self.start_clearance(drawn) < START_CLEARANCE]
            if not len(todo):
                return start
        reach = self.conditions.start_reach
        raise UserError(f"no start clear of the platform was found within {reach:g} m of the goal")

    def start(self, state: np.ndarray) -> Start:
        """Return starts from given states (k, 13) under the present conditions, with a platform."""
        return self._start(state, np.full(len(state), self.conditions.platform > 0))

    def _start(self, state: np.ndarray, present: np.ndarray) -> Start:
        k, c = len(state), self.conditions
        return Start(state, np.full(k, self.inclination * c.tilt), present, np.full(k, c.goal_size))

    def start_clearance(self, start: Start) -> np.ndarray:
        """Return the distance (k,) of the real shapes to the platform [m]; inf without a platform."""
        platform = start.platforms(self.vehicle)
        return geometry.platform_clearances(start.state, platform, start.present, self.vehicle, self._fleet)

    def at_standstill(self, start: Start) -> Start:
        """Return the starts relative to platforms in their usual place: here unchanged."""
        return start

    def check_start(self, point: tuple[float, ...]) -> None:
        """Raise UserError if a vehicle there would touch the platform or be under it."""
        state = self.states_at([point])
        inside = in_platform(state[0, : Z + 1], self.inclination, self.azimuth, self.vehicle)
        if inside or self.start_clearance(self.start(state))[0] <= 0.0:
            raise UserError(f"start {','.join(f'{number:g}' for number in point)} lies inside the platform")

    # --- reward and end ----------------------------------------------------------------------------

    def near_bounds(self, context: StepContext, m: float = BOUND_MARGIN) -> np.ndarray:
        """Return (n,) bool: which vehicles are within m [m] of the arena's bounds, or beyond.

        The bounds are those of the axes that the vehicle moves along, carried along with a moving platform.
        """
        platform = context.platform if self.platform_moves else _UNMOVED
        room = self._axes, self._arena, float(m), self.extra_room
        return _near_bounds(context.state, platform, *room, np.zeros(len(context.state), bool))

    def reached(self, context: StepContext) -> np.ndarray:
        """Return (n,) bool: which vehicles are in the goal box of their episode."""
        start = context.start
        goal = self.in_goal(context.state, start.goal_size, context.platform, start.inclination)
        if not self.conditions.goal_while_touching:
            goal &= ~context.contacts.platform_near
        return goal

    def evaluate(self, context: StepContext) -> Evaluation:
        """Return the paper's reward, see the module's docstring."""
        weight, goal, obstacle = self.reward_weights, self.reached(context), context.contacts.platform_near
        terms = {
            "time": weight["time"] * ~goal,
            "bounds": weight["bounds"] * (~goal & ~obstacle & self.near_bounds(context)),
            "obstacle": weight["obstacle"] * (~goal & obstacle),
        }
        return self.end_in_training(context, Evaluation(terms, goal))

    def end_in_training(self, context: StepContext, evaluation: Evaluation) -> Evaluation:
        """Return an evaluation with the ends that only training has, of `LandingConditions`."""
        c, goal = self.conditions, evaluation.success
        outside, stuck = self.has_left(context) & ~goal, np.zeros_like(goal)
        if c.contact_limit:
            stuck = (context.in_contact >= c.contact_limit) & ~goal
        if not c.out_of_bounds_penalty:
            return dataclasses.replace(evaluation, cut=outside | stuck)
        evaluation.terms["out_of_bounds"] = -c.out_of_bounds_penalty * outside
        return dataclasses.replace(evaluation, terminated=goal | outside, cut=stuck & ~outside)

    def has_left(self, context: StepContext) -> np.ndarray:
        """Return (n,) bool: which vehicles are beyond the conditions' `leave_limit`, or on the floor."""
        if self.conditions.leave_limit == math.inf:
            return np.zeros(len(context.state), bool)
        far = self.near_bounds(context, -self.conditions.leave_limit)
        return far | context.contacts.floor

    def score(self, flights: Sequence) -> dict[str, float]:
        """Return the shares of the flights that reach the goal box without a touch before, and at all."""
        strict = float(np.mean([flight.strict for flight in flights]))
        goal = float(np.mean([flight.success for flight in flights]))
        return {"score": strict, "strict_success": strict, "goal_reached": goal}

    def flight_words(self, flight) -> str:
        """Return when a flight reached the goal box, if it did."""
        end = f"goal box after {flight.duration:.2f} s" if flight.success else "goal box not reached"
        return end + (", platform touched before" if flight.touched else "")
