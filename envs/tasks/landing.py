"""`InclinedLanding`: reach the landing pose over the slope, the paper's planar task.

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

The centre is the hover of the vehicle with its effects on the thrust, a number, or the paper's 42000
(`pwm_centre="paper"`); the span is 16500 as in the paper, or `pwm_span`. A policy knows neither:
`load_policy(POLICY, task)` refuses one that was trained with others.

Goal s_g = [0, 1.25, 0, 0, inclination]; goal box |s - s_g| < [d, d, min(10d, 1.5), min(10d, 1.5),
0.25d] with d from 0.25 (easiest) to 0.10 (the task).

Reward per step: 0 in the goal box; otherwise -1 (`time`), a further -1 near the bounds of the arena
(`bounds`), or a further -6 on the platform (`obstacle`): the paper's -1, -2 and -7.

An episode ends in the goal box, or is truncated after 300 steps. The goal box is not yet a landing:
its centre hovers 9 cm above the slope, and entries into it may be moving.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

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
from inclined_landing.models import geometry
from inclined_landing.models.attitude import PITCH, VX, VZ, X, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.scene import compile_scene

GOAL_HEIGHT = 0.10  # of the goal above the centre of the surface, m
GOAL_SIZE = 0.10  # d of the task itself
EASIEST_GOAL_SIZE = 0.25
BOUND_MARGIN = 0.05  # closer than this to the arena's bounds counts as near them, m
START_CLEARANCE = 0.05  # starts keep this distance to the platform, m
START_MARGIN = 0.10  # and this one to the arena's bounds, m
LOWEST_START = 1.2  # random starts lie in the upper half of the arena, m
PAPER_STARTS = ((0.0, 2.0), (-1.5, 1.6), (1.5, 1.8))  # x, z of the paper's table
PAPER_RESULTS = (
    {"count": 28, "of": 30, "share": 28 / 30},
    {"share": 0.867},
)  # of 30 starts, and of its scattered ones


@dataclasses.dataclass(frozen=True)
class Conditions:
    """What an episode starts under. The defaults are the task; a curriculum passes easier ones.

    The last four fields are training aids: the task itself never uses them.
    """

    start_reach: float = 3.3  # starts lie within this of the goal in x, m
    start_reach_z: float | None = None  # and in z; None: the same
    tilt: float = 1.0  # goal and platform inclination as a share of the task's
    goal_size: float = GOAL_SIZE  # d
    platform: float = 1.0  # share of the episodes with a platform
    lowest_start: float = LOWEST_START  # m
    contact_limit: int = 0  # truncate after this many steps in contact (0: never)
    leave_limit: float = math.inf  # truncate this far outside the arena, or on the floor, m
    departure: float = 0.0  # with a price, who passes leave_limit pays it once and is out for good
    goal_while_touching: bool = True  # does the goal box count while touching the platform


# A real contact upsets the vehicle, which then lies on the slab for the rest of the episode, and one that
# leaves the arena rarely comes back; neither teaches anything. Cut without a price, a fall to the floor would
# cost what the critic says of states that it never saw anything follow: a policy may then go on falling past
# the goal from half of the starts. The price is that of staying there, 2 a step at a discount of 0.98.
AIDED = Conditions(contact_limit=8, leave_limit=0.3, departure=100.0, goal_while_touching=False)


def goal_box(goal_size) -> tuple[np.ndarray, ...]:
    """Half widths of x, z, vx, vz and pitch of goal boxes of size d = goal_size (n,) or a number."""
    d = np.asarray(goal_size)
    speed = np.minimum(10 * d, 1.5)
    return d, d, speed, speed, 0.25 * d


class InclinedLanding(Task):
    """The task for vehicles of one kind and one platform inclination [rad]."""

    name = "landing"
    observation_names: tuple[str, ...] = ("x", "z", "vx", "vz", "pitch")
    observation_scale = np.array([1.0, 1.0, 2.0, 2.0, 0.5])
    action_names = ("thrust", "pitch")
    has_platform = True
    goal_size: float | None = GOAL_SIZE
    cut_at_success = True
    shipped = True
    table = "goal_box"
    training = Training(
        *(None, 0.99),
        curriculum="adaptive",
        gamma=0.98,
        learning_rate=2e-3,
        rollout=64,
        batch_size=256,
    )
    curricula: tuple[str, ...] = ("adaptive", "paper", "none")
    training_conditions: Any = AIDED
    score_curve = ScoreCurve(
        "strict_success",
        "strict success [%]",
        reference=(100.0 * PAPER_RESULTS[0]["share"], f"paper: {100 * PAPER_RESULTS[0]['share']:.1f} %"),
    )
    start_axes = ("x", "z")
    film_starts = (PAPER_STARTS[2], PAPER_STARTS[0], PAPER_STARTS[1])
    figure_starts: ClassVar = {"trajectory_above_right": PAPER_STARTS[2], "trajectory_above": PAPER_STARTS[0]}

    def __init__(
        self,
        vehicle: Vehicle | None = None,
        *,
        inclination: float | None = None,
        pwm_centre: float | str = "hover",
        pwm_span: float | None = None,
        history: int = 0,
    ):
        super().__init__(vehicle, pwm_centre=pwm_centre, pwm_span=pwm_span, history=history)
        v = self.vehicle
        given = v.platform_inclination if inclination is None else inclination
        self.inclination = v.check_inclination(given)
        self.options = {"inclination": self.inclination, **self.options}
        self.conditions = Conditions()
        self._shapes = geometry.shapes_of(compile_scene(v))

    @property
    def goal_position(self) -> tuple[float, float]:
        """(x, z) of the goal [m]."""
        return 0.0, self.vehicle.platform_surface_height + GOAL_HEIGHT

    @property
    def goal(self) -> np.ndarray:
        """[x z vx vz pitch] (5,) of the goal."""
        return np.array([*self.goal_position, 0.0, 0.0, self.inclination])

    @property
    def goal_half_widths(self) -> np.ndarray | None:
        """(5,) of the goal box around `goal`; None where rest on the slope is the goal instead."""
        return None if self.goal_size is None else np.array(goal_box(self.goal_size), float)

    @property
    def observation_centre(self) -> np.ndarray:
        """(5,) the goal, level."""
        return np.array([*self.goal_position, 0.0, 0.0, 0.0])

    def start_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (2,), as x, z [m], of the box that random starts come from."""
        c, v = self.conditions, self.vehicle
        goal = np.array(self.goal_position)
        reach = np.array([c.start_reach, c.start_reach if c.start_reach_z is None else c.start_reach_z])
        low = np.maximum(goal - reach, [v.arena_x[0] + START_MARGIN, c.lowest_start])
        high = np.minimum(goal + reach, [v.arena_x[1] - START_MARGIN, v.arena_z[1] - START_MARGIN])
        return low, high

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """k starts at rest, uniform over the conditions' box, clear of the platform."""
        c, v = self.conditions, self.vehicle
        low, high = self.start_box()
        present = rng.random(k) < c.platform
        positions = np.zeros((k, 3))
        todo = np.arange(k)
        for _ in range(1000):
            positions[todo, ::2] = rng.uniform(low, high, (len(todo), 2))
            start = self._start(hover_states(positions[todo], v), present[todo])
            todo = todo[self.start_clearance(start) < START_CLEARANCE]
            if not len(todo):
                return self._start(hover_states(positions, v), present)
        raise UserError(f"no start clear of the platform was found within {c.start_reach:g} m of the goal")

    def start(self, state: np.ndarray) -> Start:
        """Starts from given states (k, 13) under the present conditions, with a platform."""
        return self._start(state, np.full(len(state), self.conditions.platform > 0))

    def _start(self, state: np.ndarray, present: np.ndarray) -> Start:
        k, c = len(state), self.conditions
        return Start(state, np.full(k, self.inclination * c.tilt), present, np.full(k, c.goal_size))

    def start_clearance(self, start: Start) -> np.ndarray:
        """(k,) distance of the real shapes to the platform [m]; inf without a platform."""
        position, _ = geometry.platform_poses(start.inclination, start.present, self.vehicle)
        distance = geometry.clearances(start.state, start.inclination, position, self._shapes)
        return distance[:, :2].min(axis=(1, 2))

    def check_start(self, point: tuple[float, ...]) -> None:
        """Raise UserError where a vehicle at (x, z) would touch the platform or be in the hollow under it."""
        v = self.vehicle
        x, z = point[0], point[1] - v.platform_surface_height
        sin, cos = math.sin(self.inclination), math.cos(self.inclination)
        along, height = x * cos - z * sin, x * sin + z * cos  # of the slab's surface
        thick, half = v.platform_thickness, v.slab_half_length
        in_slab = abs(along) < half and -thick <= height < 0.0
        under = abs(x + thick * sin) < half * cos and height < -thick
        touching = self.start_clearance(self.start(self.states_at([point])))[0] <= 0.0
        if in_slab or under or touching:
            raise UserError(f"start {point[0]:g},{point[1]:g} lies in the platform")

    def in_goal(self, state: np.ndarray, inclination, goal_size) -> np.ndarray:
        """(n,) bool: inside the goal box of size d = goal_size (n,) for platforms at inclination."""
        gx, gz = self.goal_position
        x, z, vx, vz, pitch = goal_box(goal_size)
        return (
            (np.abs(state[:, X] - gx) < x)
            & (np.abs(state[:, Z] - gz) < z)
            & (np.abs(state[:, VX]) < vx)
            & (np.abs(state[:, VZ]) < vz)
            & (np.abs(state[:, PITCH] - inclination) < pitch)
        )

    def near_bounds(self, state: np.ndarray, m: float = BOUND_MARGIN) -> np.ndarray:
        """(n,) bool: within m [m] of the arena's bounds in x or z, or beyond."""
        (x0, x1), (z0, z1) = self.vehicle.arena_x, self.vehicle.arena_z
        x, z = state[:, X], state[:, Z]
        return (x < x0 + m) | (x > x1 - m) | (z < z0 + m) | (z > z1 - m)

    def judge(self, moment: Moment) -> Judgement:
        """See the module's docstring."""
        c, state, start = self.conditions, moment.state, moment.start
        goal = self.in_goal(state, start.inclination, start.goal_size)
        obstacle = moment.contacts.platform_near
        if not c.goal_while_touching:
            goal &= ~obstacle
        paid = ~goal
        terms = {
            "time": -1.0 * paid,
            "bounds": -1.0 * (paid & ~obstacle & self.near_bounds(state)),
            "obstacle": -6.0 * (paid & obstacle),
        }
        gone, cut = np.zeros_like(goal), np.zeros_like(goal)
        if c.leave_limit < math.inf:
            gone |= self.near_bounds(state, -c.leave_limit) | moment.contacts.touch[:, 2].any(axis=1)
            gone &= ~goal
        if c.contact_limit:
            cut |= moment.in_contact >= c.contact_limit
        if c.departure:
            terms["departure"] = -c.departure * gone
            return Judgement(terms, goal, goal | gone, cut & ~goal & ~gone)
        return Judgement(terms, goal, goal, (cut | gone) & ~goal)

    def score(self, flights: Sequence) -> dict[str, float]:
        """Shares of the flights that reach the goal box without a touch before, and at all."""
        strict = float(np.mean([flight.strict for flight in flights]))
        goal = float(np.mean([flight.success for flight in flights]))
        return {"score": strict, "strict_success": strict, "goal_reached": goal}

    def flight_words(self, flight) -> str:
        """When a flight reached the goal box, if it did."""
        end = f"goal box after {flight.duration:.2f} s" if flight.success else "goal box not reached"
        return end + (", platform touched before" if flight.touched else "")
