"""Any slope in the plane: the landing task with `steepest` [rad]; the slope is observed.

Each episode's inclination is drawn uniformly from -steepest to steepest; `inclination` then applies to starts
given as states. Everything is observed from the centre of the surface, along level axes with the surface's
heading (`models.surface.heading_frame`), so that a slope looks the same in every direction that it faces.

| in the plane | in space | quantity | unit |
|---|---|---|---|
| 0, 1 | 0, 1, 2 | x, (y,) z from the surface's centre | m |
| 2, 3 | 3, 4, 5 | vx, (vy,) vz | m/s |
| 4 | 6, 7 | (roll,) pitch | rad |
| 5 | 8, 9 | (slope roll,) slope pitch: attitude of a vehicle with this heading at rest on it | rad |

The goal is 0.10 m from the surface along its normal, because 0.10 m vertically would be only 6.4 cm from a
slope of 50 deg. In space the goal box bounds y, vy and roll too, with the half widths of x, vx and pitch,
about the attitude of a vehicle at rest on the slope. Steep slopes require attitudes beyond 30 deg;
`angle_limit` [rad] replaces the vehicle's limit.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.envs.tasks.base import Start, StepContext, Task, hover_states
from inclined_landing.envs.tasks.landing import GOAL_HEIGHT, InclinedLanding, goal_box
from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, ROLL, STATE_SIZE, VX, VY, VZ, YAW, X, Y, Z, rotation
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.compiled import kernel

# Columns of the heading frame, and their typical sizes.
SEEN = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "slope roll", "slope pitch")
SEEN_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.5])
_PLANAR = np.array([SEEN.index(name) for name in ("x", "z", "vx", "vz", "pitch", "slope pitch")])
_SLOPES_SEED = 25_700_550  # of `over_slopes`; training never uses it, and it never changes
_CELLS = 20  # of the inclination in the plane, and in space
_SPACE_CELLS, _AZIMUTHS = 6, 12
_EACH, _SPACE_EACH = 50, 15  # starts of a cell


@kernel
def _in_goal(state, platform, goal_size, is_planar, out):
    """In the plane y, vy and roll are not bounded: policies there cannot counteract sideways forces."""
    seen = np.empty(surface.HEADING_SIZE)
    for i in range(len(state)):
        place, _, speed, _, angle = goal_box(goal_size[i])
        height = state[i, Z] - platform[i, Z]
        # The height first, over any slope: it needs no angles, and few pass.
        out[i] = abs(height) < place + GOAL_HEIGHT and abs(state[i, VZ] - platform[i, VZ]) < speed
        if not out[i]:
            continue
        s, d = state[i], platform[i]
        roll, pitch = d[ROLL], d[PITCH]  # of a vehicle that stands there
        x, y, z = surface.normal_at_rest(roll, pitch)
        out[i] = abs(height - GOAL_HEIGHT * z) < place
        if out[i]:
            surface.in_heading_frame(s, d, seen)
            out[i] = (
                abs(seen[X] - GOAL_HEIGHT * x) < place
                and abs(seen[VX]) < speed
                and abs(seen[PITCH] - pitch) < angle
            )
        if out[i] and not is_planar:
            out[i] = (
                abs(seen[Y] - GOAL_HEIGHT * y) < place
                and abs(seen[VY]) < speed
                and abs(seen[ROLL] - roll) < angle
            )
    return out


NEARLY = (0.9, 1.0)  # of the steepest slope, what is drawn more often with `LandingConditions.steep`


class SlopeLanding(InclinedLanding):
    """The landing in the plane on slopes that differ from episode to episode."""

    observation_names: tuple[str, ...] = tuple(SEEN[column] for column in _PLANAR)
    observation_scale = SEEN_SCALE[_PLANAR]
    observes_slope = True
    goal_height = GOAL_HEIGHT  # over the surface along its normal, m
    columns = _PLANAR  # of the heading frame, those that are observed
    observed_motion = 0  # numbers of the platforms' own motion that are observed
    least = -1.0  # inclination that is drawn, as a share of `steepest`

    def _usual_inclination(self) -> float:
        self.steepest, limit = self.settings.steepest, self.vehicle.platform_max_inclination + 1e-12
        if self.steepest is None:
            return super()._usual_inclination()
        if not 0.0 < self.steepest <= limit:
            said = shown(repr(self.steepest), 40)
            raise UserError(f"steepest must be an angle above 0 and up to {limit:.3g} rad, not {said}")
        return float(np.clip(super()._usual_inclination(), -self.steepest, self.steepest))

    def evaluation_groups(self, seed: int) -> dict[str, Start]:
        """Return the frozen starts over all slopes."""
        return {"frozen set": over_slopes(self).start}

    def goal_on(self, platform: np.ndarray | None) -> np.ndarray | None:
        """Return the goal as a state (13,) over the slope of a platform (12,), with its heading."""
        if platform is None:
            return None
        state = np.zeros(STATE_SIZE)
        state[: len(platform)] = platform
        state[: Z + 1] += self.goal_height * rotation(*platform[ROLL : YAW + 1])[:, 2]
        return state

    @property
    def observation_centre(self) -> np.ndarray:
        """The goal over a level platform: (o,)."""
        return np.where(np.array(self.observation_names) == "z", GOAL_HEIGHT, 0.0)

    def observe(self, context: StepContext) -> np.ndarray:
        """Return observations (n, o), float32; the present platforms are needed."""
        if context.platform is None:
            raise UserError(f"this {self.name} task observes the slope; pass the platform to observe")
        seen = np.empty((len(context.state), len(self.columns) + self.observed_motion), np.float32)
        surface.observe(context.state, context.platform, self.columns, seen)
        return seen

    def in_goal(self, state, goal_size, platform=None, inclination=None) -> np.ndarray:
        """Return (n,) bool: which states (n, 13) are in the goal box along the normal of platforms (n,
        12).
        """
        size = np.empty(len(state))
        size[:] = goal_size
        return _in_goal(state, platform, size, self.is_planar, np.empty(len(state), bool))

    def _draw_platforms(self, rng: np.random.Generator, start: Start) -> None:
        if self.steepest is not None:
            drawn = rng.uniform(self.least * self.steepest, self.steepest, len(start))
            if self.conditions.steep > 0.0:
                steep = rng.random(len(start)) < self.conditions.steep
                among = np.copysign(self.steepest * rng.uniform(*NEARLY, len(start)), drawn)
                drawn = np.where(steep, among, drawn)
            start.inclination = drawn * self.conditions.tilt

    def sample_over(self, rng: np.random.Generator, inclination: np.ndarray, azimuth: np.ndarray) -> Start:
        """Return random starts as in `sample` over given slopes (k,) [rad]; azimuths count in space only."""
        k = len(inclination)
        start = self._start(hover_states(np.zeros((k, 3)), self.vehicle), np.ones(k, bool))
        start.inclination = np.array(inclination, float)
        if start.azimuth is not None:
            start.azimuth = np.array(azimuth, float)
        return self._place(rng, start)


@dataclasses.dataclass(frozen=True)
class Slopes:
    """Stratified starts over many slopes, equally many in each cell of the angles, azimuths innermost."""

    start: Start
    cell: np.ndarray  # (2, k) which of the inclination, and which of the azimuth
    inclinations: np.ndarray  # (a + 1,) rad, edges of the cells
    azimuths: np.ndarray  # (b + 1,) rad; of one cell from 0 to 0 in the plane


def over_slopes(task: Task, every: int = 1) -> Slopes:
    """Return the frozen starts of a task over all its slopes.

    In the plane there are 20 cells of the inclination with 50 starts each; in space 6 cells of the
    inclination and 12 of the azimuth with 15 starts each. Angles are uniform within their cells, starts
    within the upper half of the arena. For a task in space with a single slope, there is only that one.
    every: use every k-th start. Raises UserError for a task that does not observe the slope.
    """
    if not isinstance(task, SlopeLanding):
        raise UserError(f"the {task.name} task of this policy has one slope and does not observe it")
    steepest, rng = task.steepest, np.random.default_rng(_SLOPES_SEED)
    if steepest is None:
        inclinations, azimuths = np.full(2, task.inclination), np.full(2, task.azimuth)
        each = _CELLS * _EACH
    elif task.is_planar:
        inclinations, azimuths, each = np.linspace(-steepest, steepest, _CELLS + 1), np.zeros(2), _EACH
    else:
        inclinations, each = np.linspace(0.0, steepest, _SPACE_CELLS + 1), _SPACE_EACH
        azimuths = np.linspace(-math.pi, math.pi, _AZIMUTHS + 1)
    cells = np.indices((len(inclinations) - 1, len(azimuths) - 1)).reshape(2, -1).repeat(each, axis=1)
    drawn = [
        edges[k] + np.diff(edges)[k] * rng.random(len(k)) for edges, k in zip((inclinations, azimuths), cells)
    ]
    return Slopes(task.sample_over(rng, *drawn)[::every], cells[:, ::every], inclinations, azimuths)
