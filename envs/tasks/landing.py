"""`InclinedLanding`: reach the landing pose over a slope, the paper's planar task; and any slope, in space.

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
(`pwm_centre="paper"`), or the hover of whatever vehicle is flown (`pwm_centre="own"`); the span is 16500
as in the paper, or `pwm_span`. A policy knows neither: `load_policy(POLICY, task)` refuses one that was
trained with others.

Goal s_g = [0, 1.25, 0, 0, inclination]; goal box |s - s_g| < [d, d, min(10d, 1.5), min(10d, 1.5),
0.25d] with d from 0.25 (easiest) to 0.10 (the task).

Reward per step: 0 in the goal box; otherwise -1 (`time`), a further -1 near the bounds of the arena
(`bounds`), or a further -6 on the platform (`obstacle`): the paper's -1, -2 and -7.

An episode ends in the goal box, or is truncated after 300 steps. The goal box is not yet a landing:
its centre hovers 9 cm above the slope, and entries into it may be moving.

Any slope: with `steepest` [rad] every episode has an inclination of its own, drawn evenly from -steepest to
steepest. In space, with `dimensions=3`, it is drawn from 0 to steepest, with an azimuth from 0 to 360 deg:
the direction that the slope faces, from +x. Without `steepest` all have the one inclination and azimuth. Such
a task observes the slope, and everything from the centre of its surface, along level axes with the surface's
heading (`models.surface.heading_frame`): a slope looks the same whichever way it faces.

| in the plane | in space | quantity | unit |
|---|---|---|---|
| 0, 1 | 0, 1, 2 | x, (y,) z from the surface's centre | m |
| 2, 3 | 3, 4, 5 | vx, (vy,) vz | m/s |
| 4 | 6, 7 | (roll,) pitch | rad |
| 5 | 8, 9 | (slope roll,) slope pitch: of a vehicle of this heading that stands on it | rad |

In space the actions are thrust, roll and pitch, these along the same axes: roll and pitch are those of a
vehicle that has the surface's heading and the same thrust axis, and what the vehicle is commanded is turned
by its own (`headed`). So `random_yaw` asks for nothing new. The goal lies 0.10 m over the surface along its
normal, as 0.10 m straight above would leave 6.4 cm over a slope of 50 deg; in the goal box y, vy and roll
have the half widths of x, vx and pitch, about the attitude of standing. Starts come from the upper half of
the arena in all three directions, and its bounds in y are bounds too. Steep slopes need attitudes beyond 30
deg: `angle_limit` [rad] takes the place of the vehicle's. `inclination` and `azimuth` are then the slope of
given starts.

Moving decks: with `fastest` [m/s], in space, every deck travels steadily, any way, at up to this speed, and
with `swell` it heaves, rolls and pitches too (`envs.swell`). The vehicle starts at rest in the room.
Everything is observed and judged relative to the deck: velocities are against its centre, and six more
observations are its own velocity and rates, along the axes of the heading frame. The arena is carried along
with the deck's centre, and wider by the way of half a second at `fastest`, so that there is room to catch up.
Given starts have decks that stand still.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from inclined_landing.envs import swell as swells
from inclined_landing.envs.tasks.base import (
    COLUMNS,
    Judgement,
    Moment,
    ScoreCurve,
    Start,
    Task,
    Training,
    hover_states,
)
from inclined_landing.models import geometry, surface
from inclined_landing.models.attitude import (
    PITCH,
    PITCH_COMMAND,
    ROLL,
    ROLL_COMMAND,
    STATE_SIZE,
    VX,
    VZ,
    YAW,
    X,
    Y,
    Z,
    rotation,
)
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants.base import DECK_SIZE
from inclined_landing.models.scene import compile_scene

GOAL_HEIGHT = 0.10  # of the goal above the centre of the surface, m
GOAL_SIZE = 0.10  # d of the task itself
EASIEST_GOAL_SIZE = 0.25
BOUND_MARGIN = 0.05  # closer than this to the arena's bounds counts as near them, m
START_CLEARANCE = 0.05  # starts keep this distance to the platform, m
START_MARGIN = 0.10  # and this one to the arena's bounds, m
LOWEST_START = 1.2  # random starts lie in the upper half of the arena, m
SEEN = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "slope roll", "slope pitch")  # of any slope
SEEN_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.5])
SEEN_MOVING = ("deck vx", "deck vy", "deck vz", "deck wx", "deck wy", "deck wz")  # of moving decks besides
SEEN_MOVING_SCALE = np.array([1.0, 1.0, 0.5, 0.5, 0.5, 0.5])
CATCHING_UP = 0.5  # s of the fastest deck's way by which the arena of moving decks is wider
PLANAR = (X, Z, VX, VZ, PITCH, surface.SLOPE_PITCH)  # of them in the plane
PAPER_STARTS = ((0.0, 2.0), (-1.5, 1.6), (1.5, 1.8))  # x, z of the paper's table
FILM_STARTS = ((1.5, 0.6, 1.8), (0.0, -0.8, 2.0), (-1.5, 0.3, 1.6))  # m, in space
PAPER_RESULTS = (
    {"count": 28, "of": 30, "share": 28 / 30},
    {"share": 0.867},
)  # of 30 starts, and of its scattered ones


@dataclasses.dataclass(frozen=True)
class Conditions:
    """What an episode starts under. The defaults are the task; a curriculum passes easier ones.

    The last four fields are training aids: the task itself never uses them.
    """

    start_reach: float = 3.3  # starts lie within this of the goal in x and y, m
    start_reach_z: float | None = None  # and in z; None: the same
    tilt: float = 1.0  # goal and platform inclination as a share of the task's
    motion: float = 1.0  # speed and swell of decks as a share of the task's
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
    """The task for vehicles of one kind; the options are those of the module's docstring, angles in rad."""

    name = "landing"
    observation_names: tuple[str, ...] = ("x", "z", "vx", "vz", "pitch")
    observation_scale: np.ndarray = np.array([1.0, 1.0, 2.0, 2.0, 0.5])
    action_names: tuple[str, ...] = ("thrust", "pitch")
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
    curricula: tuple[str, ...] = ("adaptive", "fixed", "paper", "none")
    training_conditions: Any = AIDED
    score_curve = ScoreCurve(
        "strict_success",
        "strict success [%]",
        reference=(100.0 * PAPER_RESULTS[0]["share"], f"paper: {100 * PAPER_RESULTS[0]['share']:.1f} %"),
    )
    start_axes: tuple[str, ...] = ("x", "z")
    film_starts: tuple[tuple[float, ...], ...] = (PAPER_STARTS[2], PAPER_STARTS[0], PAPER_STARTS[1])
    figure_starts: Mapping[str, tuple[float, ...]] = MappingProxyType(
        {"trajectory_above_right": PAPER_STARTS[2], "trajectory_above": PAPER_STARTS[0]}
    )
    # Options as they are where they are not given.
    steepest: float | None = None
    dimensions = 2
    azimuth = 0.0
    random_yaw = False
    fastest: float | None = None
    swell = 0.0

    def __init__(
        self,
        vehicle: Vehicle | None = None,
        *,
        inclination: float | None = None,
        steepest: float | None = None,
        dimensions: int = 2,
        azimuth: float = 0.0,
        random_yaw: bool = False,
        fastest: float | None = None,
        swell: float = 0.0,
        angle_limit: float | None = None,
        pwm_centre: float | str = "hover",
        pwm_span: float | None = None,
        history: int = 0,
        observe_vehicle: bool = False,
    ):
        super().__init__(
            vehicle,
            angle_limit=angle_limit,
            pwm_centre=pwm_centre,
            pwm_span=pwm_span,
            history=history,
            observe_vehicle=observe_vehicle,
        )
        v = self.vehicle
        self.steepest = self._check_steepest(steepest)
        if dimensions not in (2, 3) or isinstance(dimensions, bool):
            raise UserError(f"dimensions must be 2 or 3, not {shown(repr(dimensions), 40)}")
        self.dimensions = int(dimensions)
        usual = v.platform_inclination if steepest is None else np.clip(v.platform_inclination, *self._slopes)
        self.inclination = v.check_inclination(float(usual) if inclination is None else inclination)
        if not (isinstance(azimuth, (int, float)) and math.isfinite(azimuth)):
            raise UserError(f"azimuth must be an angle in rad, not {shown(repr(azimuth), 40)}")
        self.azimuth, self.random_yaw = float(azimuth), bool(random_yaw)
        if self.dimensions == 3 and steepest is not None and self.inclination < 0.0:  # as slopes are drawn
            self.inclination, self.azimuth = -self.inclination, self.azimuth + math.pi
        if self.dimensions == 2 and (self.azimuth or self.random_yaw):
            named = "azimuth" if self.azimuth else "random_yaw"
            raise UserError(f"{named} needs dimensions=3: in the plane a vehicle cannot follow it")
        self._check_motion(fastest, swell)
        self.options = {"inclination": self.inclination, **self.options}
        for name in ("steepest", "dimensions", "azimuth", "random_yaw", "fastest", "swell"):
            if getattr(self, name) != getattr(InclinedLanding, name):
                self.options[name] = getattr(self, name)
        self.conditions = Conditions()
        self._shapes = geometry.shapes_of(compile_scene(v))
        self.sees_slope = self.steepest is not None or self.dimensions == 3
        if self.sees_slope:
            if self.table == InclinedLanding.table:
                self.table = "slopes"
            self._seen = np.array(PLANAR if self.dimensions == 2 else range(surface.HEADING_SIZE))
            self.observation_names = tuple(SEEN[column] for column in self._seen)
            self.observation_scale = SEEN_SCALE[self._seen]
        if self.fastest is not None:
            self.observation_names += SEEN_MOVING
            self.observation_scale = np.append(self.observation_scale, SEEN_MOVING_SCALE)
            self.table = "moving"
        if self.dimensions == 3:
            self.action_names, self.start_axes = ("thrust", "roll", "pitch"), ("x", "y", "z")
            self.film_starts = FILM_STARTS
            self.figure_starts = {"trajectory": FILM_STARTS[0]}
        self._axes = [COLUMNS[name] for name in self.start_axes]

    def _check_steepest(self, steepest) -> float | None:
        if steepest is None:
            return None
        limit = self.vehicle.platform_max_inclination + 1e-12
        if not (isinstance(steepest, (int, float)) and 0.0 < steepest <= limit):
            said = shown(repr(steepest), 40)
            raise UserError(f"steepest must be an angle above 0 and up to {limit:.3g} rad, not {said}")
        return float(steepest)

    def _check_motion(self, fastest, swell) -> None:
        """Take the options of moving decks; raises UserError for those that fit nothing."""
        for name, value, most in (("fastest", fastest, 10.0), ("swell", swell, 2.0)):
            if value is not None and not (isinstance(value, (int, float)) and 0.0 <= value <= most):
                said = shown(repr(value), 40)
                raise UserError(f"{name} must be a number from 0 to {most:g}, not {said}")
        if fastest is None and swell:
            raise UserError("swell is of moving decks: give it fastest too, which may be 0")
        if fastest is not None and self.dimensions == 2:
            raise UserError("fastest needs dimensions=3: in the plane a vehicle cannot follow a deck")
        self.fastest = None if fastest is None else float(fastest)
        self.swell = float(swell)
        self._room = CATCHING_UP * (self.fastest or 0.0)  # m by which the arena is wider

    @property
    def plant_options(self) -> dict[str, Any]:
        """A moving plant where decks move."""
        return {} if self.fastest is None else {"moving": True}

    @property
    def _slopes(self) -> tuple[float, float]:
        """Least and largest inclination of the slopes that are drawn [rad]."""
        steepest = self.steepest or 0.0
        return -steepest, steepest

    @property
    def goal_position(self) -> tuple[float, ...]:
        """(x, z) of the goal [m]; (x, y, z) in space. Where the slope is observed, over a level one."""
        return *[0.0] * (len(self.start_axes) - 1), self.vehicle.platform_surface_height + GOAL_HEIGHT

    @property
    def goal(self) -> np.ndarray | None:
        """[x z vx vz pitch] (5,) of the goal; None where the slope is observed, as it is the slope's."""
        return None if self.sees_slope else np.array([*self.goal_position, 0.0, 0.0, self.inclination])

    @property
    def goal_half_widths(self) -> np.ndarray | None:
        """(5,) of the goal box around `goal`; None where rest on the slope is the goal instead."""
        if self.goal_size is None or self.sees_slope:
            return None
        return np.array(goal_box(self.goal_size), float)

    def goal_on(self, deck: np.ndarray | None) -> np.ndarray | None:
        """The goal as a state (13,) over the slope of a deck (12,), with its heading."""
        return self._over(deck, GOAL_HEIGHT) if self.sees_slope else super().goal_on(deck)

    def _over(self, deck: np.ndarray | None, height: float) -> np.ndarray | None:
        """A state (13,) as the deck's (12,), height [m] over it along its normal; None without a deck."""
        if deck is None:
            return None
        state = np.zeros(STATE_SIZE)
        state[: len(deck)] = deck
        state[: Z + 1] += height * rotation(*deck[ROLL : YAW + 1])[:, 2]
        return state

    @property
    def observation_centre(self) -> np.ndarray:
        """The goal, level: (5,), or as many as are observed."""
        if not self.sees_slope:
            return np.array([*self.goal_position, 0.0, 0.0, 0.0])
        still = np.where(self._seen == Z, GOAL_HEIGHT, 0.0)
        return np.append(still, np.zeros(len(self.observation_names) - len(still)))

    def observe(self, moment: Moment) -> np.ndarray:
        """See the module's docstring, (n, o) float32; where the slope is observed it needs the decks."""
        if not self.sees_slope:
            return super().observe(moment)
        if moment.deck is None:
            raise UserError(f"this {self.name} task observes the slope; give observe the deck")
        seen = surface.heading_frame(moment.state, moment.deck)[:, self._seen]
        if self.fastest is not None:
            seen = np.concatenate([seen, surface.deck_motion(moment.deck)], axis=1)
        return seen.astype(np.float32)

    def headed(self, commands: np.ndarray, state: np.ndarray, deck: np.ndarray) -> np.ndarray:
        """In space attitude actions are along the axes of observations that are the surface's."""
        if self.dimensions == 3:
            both, v = [ROLL_COMMAND, PITCH_COMMAND], self.vehicle
            limits = v.attitude_gain, v.command_angle_limit
            commands[:, both] = surface.vehicle_commands(commands[:, both], *limits, state, deck)
        return commands

    def start_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner, (2,) as x, z or (3,) as x, y, z [m], of the box of random starts."""
        c, v = self.conditions, self.vehicle
        goal = np.array(self.goal_position)
        reach = np.full(len(goal), c.start_reach)
        if c.start_reach_z is not None:
            reach[-1] = c.start_reach_z
        sides = [getattr(v, f"arena_{name}") for name in self.start_axes]
        low = np.maximum(goal - reach, [*(side[0] + START_MARGIN for side in sides[:-1]), c.lowest_start])
        high = np.minimum(goal + reach, [side[1] - START_MARGIN for side in sides])
        return low, high

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """k starts at rest, uniform over the conditions' box, clear of the platform."""
        present = rng.random(k) < self.conditions.platform
        start = self._start(hover_states(np.zeros((k, 3)), self.vehicle), present)
        if self.steepest is not None:
            low, high = self._slopes
            start.inclination = rng.uniform(low if self.dimensions == 2 else 0.0, high, k)
            start.inclination *= self.conditions.tilt
            if self.dimensions == 3:
                start.azimuth = rng.uniform(-math.pi, math.pi, k)
        if self.fastest is not None:
            share = self.conditions.motion
            start.motion = swells.draw(rng, k, share * self.fastest, share * self.swell)
        return self._place(rng, start)

    def sample_over(self, rng: np.random.Generator, inclination: np.ndarray, azimuth: np.ndarray) -> Start:
        """Random starts as in `sample` over slopes (k,) [rad] that are given."""
        k = len(inclination)
        start = self._start(hover_states(np.zeros((k, 3)), self.vehicle), np.ones(k, bool))
        start.inclination = np.array(inclination, float)
        if self.dimensions == 3:
            start.azimuth = np.array(azimuth, float)
        return self._place(rng, start)

    def _place(self, rng: np.random.Generator, start: Start) -> Start:
        """Starts at random places, and headings where the options ask for that."""
        low, high = self.start_box()
        todo = np.arange(len(start.state))
        if self.random_yaw:
            start.state[:, YAW] = rng.uniform(-math.pi, math.pi, len(todo))
        for _ in range(1000):
            start.state[np.ix_(todo, self._axes)] = rng.uniform(low, high, (len(todo), len(low)))
            todo = todo[self.start_clearance(start[todo]) < START_CLEARANCE]
            if not len(todo):
                return start
        reach = self.conditions.start_reach
        raise UserError(f"no start clear of the platform was found within {reach:g} m of the goal")

    def start(self, state: np.ndarray) -> Start:
        """Starts from given states (k, 13) under the present conditions, with a platform."""
        return self._start(state, np.full(len(state), self.conditions.platform > 0))

    def _start(self, state: np.ndarray, present: np.ndarray) -> Start:
        k, c = len(state), self.conditions
        azimuth = np.full(k, self.azimuth) if self.dimensions == 3 else None
        slope = np.full(k, self.inclination * c.tilt)
        return Start(state, slope, present, np.full(k, c.goal_size), azimuth=azimuth)

    def start_clearance(self, start: Start) -> np.ndarray:
        """(k,) distance of the real shapes to the platform [m]; inf without a platform."""
        start = self.stopped(start)
        azimuth = 0.0 if start.azimuth is None else start.azimuth
        slope = start.inclination
        position, _ = geometry.platform_poses(slope, start.present, self.vehicle, azimuth=azimuth)
        distance = geometry.clearances(start.state, slope, position, self._shapes, azimuth=azimuth)
        return distance[:, :2].min(axis=(1, 2))

    def stopped(self, start: Start) -> Start:
        """Starts as they are over decks that stand still, where these have the slopes of the first moment.

        Positions are then relative to decks in their usual place.
        """
        if start.motion is None:
            return start
        deck = self.decks(start)
        state = start.state.copy()
        state[:, : Z + 1] -= deck[:, : Z + 1]
        state[:, Z] += self.vehicle.platform_surface_height
        slope, azimuth = surface.slope_of(deck)
        return dataclasses.replace(start, state=state, inclination=slope, azimuth=azimuth, motion=None)

    def decks(self, start: Start, t: float = 0.0) -> np.ndarray:
        """States (k, 12) of the decks of starts, t [s] after."""
        rest = np.zeros((len(start.state), DECK_SIZE))
        rest[:, Z], rest[:, PITCH] = self.vehicle.platform_surface_height, start.inclination
        rest[:, YAW] = 0.0 if start.azimuth is None else start.azimuth
        return rest if start.motion is None else start.motion.decks(t, rest)

    def carried(self, moment: Moment) -> np.ndarray:
        """States (n, 13) in an arena that is carried along with the decks' centres."""
        if self.fastest is None:
            return moment.state
        state = moment.state.copy()
        state[:, : Y + 1] -= moment.deck[:, : Y + 1]
        return state

    def check_start(self, point: tuple[float, ...]) -> None:
        """Raise UserError where a vehicle there would touch the platform or be in the hollow under it."""
        v = self.vehicle
        state = self.states_at([point])
        cos, sin = math.cos(self.azimuth), math.sin(self.azimuth)
        x, y = cos * state[0, X] + sin * state[0, Y], cos * state[0, Y] - sin * state[0, X]
        z = state[0, Z] - v.platform_surface_height
        sin, cos = math.sin(self.inclination), math.cos(self.inclination)
        along, height = x * cos - z * sin, x * sin + z * cos  # of the slab's surface
        thick, half = v.platform_thickness, v.slab_half_length
        in_slab = abs(along) < half and -thick <= height < 0.0
        under = abs(x + thick * sin) < half * cos and height < -thick
        inside = (in_slab or under) and abs(y) < 0.5 * v.platform_depth
        if inside or self.start_clearance(self.start(state))[0] <= 0.0:
            raise UserError(f"start {','.join(f'{number:g}' for number in point)} lies in the platform")

    def in_goal_over(self, state: np.ndarray, deck: np.ndarray, goal_size) -> np.ndarray:
        """(n,) bool: inside the goal box of size d = goal_size (n,) along the normal of decks (n, 12)."""
        seen = surface.heading_frame(state, deck)
        standing = seen[:, surface.SLOPE_ROLL :]
        seen[:, X : Z + 1] -= GOAL_HEIGHT * surface.normal_at_rest(*standing.T)
        seen[:, ROLL : PITCH + 1] -= standing
        place, _, speed, _, angle = goal_box(goal_size)
        return (
            (np.abs(seen[:, X : Z + 1]).max(axis=1) < place)
            & (np.abs(seen[:, VX : VZ + 1]).max(axis=1) < speed)
            & (np.abs(seen[:, ROLL : PITCH + 1]).max(axis=1) < angle)
        )

    def in_goal(self, state: np.ndarray, inclination, goal_size) -> np.ndarray:
        """(n,) bool: inside the paper's goal box of size d = goal_size (n,) for platforms at inclination."""
        gx, gz = self.goal_position[0], self.goal_position[-1]
        x, z, vx, vz, pitch = goal_box(goal_size)
        return (
            (np.abs(state[:, X] - gx) < x)
            & (np.abs(state[:, Z] - gz) < z)
            & (np.abs(state[:, VX]) < vx)
            & (np.abs(state[:, VZ]) < vz)
            & (np.abs(state[:, PITCH] - inclination) < pitch)
        )

    def near_bounds(self, state: np.ndarray, m: float = BOUND_MARGIN) -> np.ndarray:
        """(n,) bool: within m [m] of the arena's bounds in x or z, in space in y too, or beyond.

        state (n, 13): in an arena that moves, see `carried`.
        """
        (x0, x1), (z0, z1) = self.vehicle.arena_x, self.vehicle.arena_z
        x, z, side = state[:, X], state[:, Z], m - self._room
        near = (x < x0 + side) | (x > x1 - side) | (z < z0 + m) | (z > z1 - m)
        if self.dimensions == 3:
            (y0, y1), y = self.vehicle.arena_y, state[:, Y]
            near |= (y < y0 + side) | (y > y1 - side)
        return near

    def judge(self, moment: Moment) -> Judgement:
        """See the module's docstring."""
        c, state, start = self.conditions, moment.state, moment.start
        carried = self.carried(moment)
        if self.sees_slope:
            goal = self.in_goal_over(state, moment.deck, start.goal_size)
        else:
            goal = self.in_goal(state, start.inclination, start.goal_size)
        obstacle = moment.contacts.platform_near
        if not c.goal_while_touching:
            goal &= ~obstacle
        paid = ~goal
        terms = {
            "time": -1.0 * paid,
            "bounds": -1.0 * (paid & ~obstacle & self.near_bounds(carried)),
            "obstacle": -6.0 * (paid & obstacle),
        }
        gone, cut = np.zeros_like(goal), np.zeros_like(goal)
        if c.leave_limit < math.inf:
            gone |= self.near_bounds(carried, -c.leave_limit) | moment.contacts.touch[:, 2].any(axis=1)
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
