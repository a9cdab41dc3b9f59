"""A feedback law, with which touchdown training in 3D starts, that lands and stops the motors.

It has no memory, so that a network can imitate it. It replans at every step with minimum-snap trajectories
(polynomials of the seventh degree) that take `TIMES` s and end on the platform, moving into it and uphill,
with the acceleration of a vehicle whose thrust is along the platform's normal and constant in direction.
Among the trajectories that stay clear of the platform and within the limits of the commands, it follows the
one with the lowest cost, which includes the time. If there is none, it flies to a point from which there is
one, along the platform's normal and downhill of it. Reinforcement learning continues from there.

Mellinger and Kumar, Minimum snap trajectory generation and control for quadrotors, ICRA 2011; Mueller, Hehn
and D'Andrea, A computationally efficient motion primitive, T-RO 31 (2015).
"""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.approach import ABOVE, DAMPING, LEAST_LIFT, LOWEST, SINK, STIFFNESS, limited_error
from inclined_landing.envs.tasks import StepContext
from inclined_landing.envs.tasks.touchdown import InclinedTouchdown
from inclined_landing.models import surface
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ, X, Y, Z
from inclined_landing.models.forces import settled_hover

TIMES = np.linspace(0.3, 2.5, 45)  # s, the durations that are tried
PRICE = 1e6  # cost of a second, in units of the integral of the squared snap [m2/s7]
CHECKED = np.linspace(0.1, 1.0, 8)  # shares of the duration at which a trajectory is checked
LIFT = (0.3, 1.7)  # least and largest thrust of a trajectory, in weights
# A trajectory ends DEPTH m below the height at rest, so that the vehicle does not hover above the platform,
# with SINK into it, and uphill with gravity along the slope times UPHILL s, which a bounce takes back.
DEPTH, UPHILL = 0.02, 0.08
SLACK = 0.01  # a trajectory may pass this far [m] below its lower limit without being refused
CONE, APEX = 0.5, 0.1  # that limit rises by CONE m per m beyond APEX m from the platform's centre
EDGE = 0.1  # m, to which it extends beyond the edges of the slab
DOWNHILL = 0.08  # s2: the approach leads to a point that is downhill by gravity along the slope times this
AHEAD = 0.06  # s ahead of now, at which a trajectory is read
LARGEST = 8.0  # m/s2, limit of the lead for the attitude loop along each axis
SPOOL = 0.065  # s, lead of the thrust for the lag of the motors
CUT_HEIGHT = 0.03  # m over the height at rest, below which motors stop
CUT_ASIDE = 0.35  # m from the centre, within which motors stop
LEAST_THRUST = -0.8  # least thrust action in flight, clear of idle


class Descent:
    """The law, as actions of a touchdown task in three dimensions."""

    def __init__(self, task: InclinedTouchdown):
        v = task.vehicle
        self._task, self._rest = task, task.goal_height
        self._hover, self._gravity = settled_hover(v), v.environment_gravity
        slope, least = v.motor_pwm_to_speed
        turning = v.motor_count * (slope * self._hover + least)  # rad/s, of all rotors
        self._drag = -v.drag_coefficients[0] * turning / (v.body_mass + v.effects_load_mass)  # 1/s
        self._hover_lag, self._lead, self._gain = v.hover_lag, v.attitude_time_constant, v.attitude_gain
        self._bandwidth = v.attitude_bandwidth
        self._steepest = np.cos(v.command_angle_limit * v.attitude_gain)
        self._half = v.slab_half_length + EDGE, 0.5 * v.platform_depth + EDGE

    def __call__(self, context: StepContext, idle: float) -> np.ndarray:
        """Return actions (n, a) in n states over their platforms; idle: the action that stops the motors."""
        seen = surface.heading_frame(context.state, context.platform)
        place, velocity = seen[:, : Z + 1], seen[:, VX : VZ + 1]
        down = np.array([0.0, 0.0, -self._gravity])
        normal = _axes(seen[:, surface.SLOPE_ROLL], seen[:, surface.SLOPE_PITCH])
        thrust = self._gravity * context.state[:, LAG, None] / self._hover_lag
        drag = self._drag * (velocity + surface.platform_motion(context.platform)[:, :3])
        now = thrust * _axes(seen[:, ROLL], seen[:, PITCH]) + down - drag
        jerk = thrust * surface.thrust_turning(context.state, context.platform)
        along = down - (normal @ down)[:, None] * normal
        sinking = -SINK * normal - UPHILL * along
        end = np.array([(self._rest - DEPTH) * normal, sinking, along, np.zeros_like(along)])
        (push, jerk, snap), clear = self._trajectories(np.array([place, velocity, now, jerk]), end, normal)

        first = (self._rest + ABOVE) * normal + DOWNHILL * along
        behind = limited_error(first, place)
        height = (place * normal).sum(axis=1) - self._rest
        behind += np.maximum(0.0, LOWEST - height)[:, None] * normal
        there = STIFFNESS * behind - DAMPING * velocity

        change = (self._lead + 1.0 / self._bandwidth) * jerk + self._lead / self._bandwidth * snap
        ahead = np.where(clear[:, None], push + np.clip(change, -LARGEST, LARGEST), there) + drag - down
        lift = np.where(clear[:, None], push + SPOOL * jerk, there) + drag - down
        ahead[:, Z] = np.maximum(ahead[:, Z], LEAST_LIFT * self._gravity)
        wanted = {
            "thrust": self._hover * np.linalg.norm(lift, axis=1) / self._gravity,
            "roll": np.arctan2(-ahead[:, Y], ahead[:, Z]) / self._gain,
            "pitch": np.arcsin(ahead[:, X] / np.linalg.norm(ahead, axis=1)) / self._gain,
        }
        columns = [(wanted[c.name] - c.centre) / c.span for c in self._task.channels]
        actions = np.clip(np.column_stack(columns), -1.0, 1.0)
        actions[:, 0] = np.maximum(actions[:, 0], LEAST_THRUST)
        aside = np.linalg.norm(place - (place * normal).sum(axis=1, keepdims=True) * normal, axis=1)
        stop = (height < CUT_HEIGHT) & (aside < CUT_ASIDE)
        actions[stop, 0] = idle
        return actions

    def _trajectories(
        self, now: np.ndarray, end: np.ndarray, normal: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the beginnings (3, n, 3) of the best trajectories, acceleration and its first two
        derivatives `AHEAD` s ahead; and whether (n,) one of them is clear.

        now, end (4, n, 3): position, velocity, acceleration and jerk; normal (n, 3): of the platforms.
        """
        t = TIMES[:, None, None]
        scale = np.array([t**0, t, t**2, t**3])  # derivatives by the share of the time that is past
        known = now[:, None] * scale / _FACTORIALS[:4, None, None, None]
        remaining = end[:, None] * scale - np.einsum("dk,ktnx->dtnx", _ENDS[:, :4], known)
        trajectory = np.concatenate(
            [known, np.einsum("kd,dtnx->ktnx", _SOLVED, remaining)]
        )  # (8, times, n, 3)

        place, lift, snap = (np.einsum("ck,ktnx->ctnx", _basis(CHECKED, d), trajectory) for d in (0, 2, 4))
        price = ((snap / t**4) ** 2).sum(axis=3).mean(axis=0) * TIMES[:, None] + PRICE * TIMES[:, None]
        lift = lift / t**2 + [0.0, 0.0, self._gravity]
        size = np.linalg.norm(lift, axis=3)
        wrong = (size < LIFT[0] * self._gravity) | (size > LIFT[1] * self._gravity)
        wrong |= lift[..., Z] < self._steepest * size
        height = (place * normal).sum(axis=3)
        aside = np.linalg.norm(place - height[..., None] * normal, axis=3)
        over = (np.abs(place[..., X]) < self._half[0]) & (np.abs(place[..., Y]) < self._half[1])
        wrong |= over & (height < self._rest - DEPTH - SLACK + CONE * np.maximum(0.0, aside - APEX))
        wrong[-1] = False  # the end is given
        price = np.where(wrong.any(axis=0), np.inf, price)
        best, rows = price.argmin(axis=0), np.arange(now.shape[1])
        trajectory, taken = trajectory[:, best, rows], TIMES[best]
        soon = np.array([_basis(AHEAD / taken, d) for d in (2, 3, 4)])  # (3, n, 8)
        scale = np.array([taken**2, taken**3, taken**4])[..., None]
        begun = np.einsum("dnk,knx->dnx", soon, trajectory) / scale
        return begun, np.isfinite(price[best, rows])


def _basis(u: np.ndarray, d: int) -> np.ndarray:
    """Return the d-th derivatives (c, 8) of 1, u ... u^7 at u (c,)."""
    k = np.arange(8)
    falling = np.prod([k - i for i in range(d)], axis=0) if d else np.ones(8)
    return falling * np.asarray(u)[:, None] ** np.maximum(k - d, 0)


_FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])
_ENDS = np.concatenate([_basis(np.ones(1), d) for d in range(4)])  # (4, 8)
_SOLVED = np.linalg.inv(_ENDS[:, 4:])


def _axes(roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Return the thrust axes (n, 3) of attitudes without yaw, which are also normals of surfaces."""
    return np.column_stack([np.sin(pitch), -np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
