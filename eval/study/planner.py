"""A planner without learning: hover over the platform, then a minimum-jerk trajectory onto it.

Everything is planned in the frame that moves with the platform's centre. A vehicle first flies to a point
along the platform's normal from which the final trajectory is short. From there a minimum-jerk trajectory, a
polynomial of the fifth degree, leads to the platform: to its centre, descending at `SINK`, and with the
acceleration of a vehicle whose thrust is along the platform's normal, so that it arrives aligned with it. The
end of the trajectory is replanned in every control period, because a platform may tilt. Commands combine its
acceleration, a proportional and a derivative term, and the platform's acceleration from differences; attitude
commands lead by the loop's time constant. The motors stop at `CUT` above the height at rest.

Mellinger and Kumar, Minimum snap trajectory generation and control for quadrotors, ICRA 2011, for flat
outputs; Mueller, Hehn and D'Andrea, A computationally efficient motion primitive, T-RO 31 (2015), for
minimum-jerk trajectories.
"""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.approach import ABOVE, DAMPING, LEAST_LIFT, LOWEST, SINK, STIFFNESS, limited_error
from inclined_landing.envs.tasks import StepContext
from inclined_landing.models import geometry, surface
from inclined_landing.models.attitude import VX, VZ, YAW, Z
from inclined_landing.models.forces import settled_hover
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle

# Chosen by hand on starts that no scenario has.
WAY = 0.9  # s, duration of the final trajectory
CUT = 0.015  # m over the height at rest, below which the motors stop
NEAR, SLOW = 0.12, 0.35  # m and m/s: the final trajectory begins within these of the point above the platform
LEAST = 0.15  # s, least time for which the rest of the trajectory is planned
_CALMING = 0.01  # share of each period's normal in its average, for platforms that tilt to and fro
_FILTER = 0.3  # share of each period's difference quotient in the filtered acceleration of the platform


class Planner:
    """A pilot (see `rest.Pilot`) for one kind of vehicle."""

    def __init__(self, vehicle: Vehicle):
        self._period, self._gravity = vehicle.command_control_period, vehicle.environment_gravity
        self._hover, self._gain = settled_hover(vehicle), vehicle.attitude_gain
        self._lead, self._angle = vehicle.attitude_time_constant, vehicle.command_angle_limit
        self._pwm, self._yaw_rate = vehicle.command_pwm_range, vehicle.command_yaw_rate_limit
        self._rest = float(geometry.reach_below(geometry.shapes_of(compile_scene(vehicle)), part="feet"))
        self._remaining = np.empty(0)

    def _begin(self, platform: np.ndarray) -> None:
        """Begin with all vehicles, over platforms (n, 12)."""
        n = len(platform)
        self._remaining = np.full(n, np.inf)  # s until touching; inf: not on the last way yet
        self._stopped = np.zeros(n, bool)
        self._way = np.zeros((3, n, 3))  # place, velocity, acceleration on it, from the platform's centre
        self._calm, self._platform_speed = surface.normals(platform), platform[:, VX : VZ + 1].copy()
        self._platform_push = np.zeros((n, 3))
        self._thrust = np.tile([0.0, 0.0, self._gravity], (n, 1))

    def __call__(self, t: float, context: StepContext) -> np.ndarray:
        """Return commands (n, 4) within the vehicle's limits."""
        state, platform = context.state, context.platform
        if len(self._remaining) != len(state):
            self._begin(platform)
        speed = platform[:, VX : VZ + 1]
        self._platform_push += _FILTER * ((speed - self._platform_speed) / self._period - self._platform_push)
        self._platform_speed = speed.copy()
        place = state[:, : Z + 1] - platform[:, : Z + 1]
        velocity = state[:, VX : VZ + 1] - speed
        normal = surface.normals(platform)

        waiting = np.isinf(self._remaining)
        self._calm += _CALMING * (normal - self._calm)
        # The final trajectory starts above the platform and downhill of it.
        end, _, along = self._end(self._calm)
        first = end + ABOVE * self._calm + 0.1 * WAY**2 * along
        error, drift = place - first, velocity
        ready = (np.linalg.norm(error, axis=1) < NEAR) & (np.linalg.norm(drift, axis=1) < SLOW)
        begins = waiting & ready
        self._remaining[begins] = WAY
        self._way[0, begins], self._way[1, begins] = place[begins], velocity[begins]
        self._way[2, begins] = 0.0
        waiting &= ~ready
        self._follow(~waiting, normal)

        target = np.where(waiting[:, None], first, self._way[0])
        behind = limited_error(target, place)
        height = (place * normal).sum(axis=1) - self._rest
        behind += (waiting * np.maximum(0.0, LOWEST - height))[:, None] * normal
        wanted = STIFFNESS * behind + DAMPING * (np.where(waiting[:, None], 0.0, self._way[1]) - velocity)
        wanted += np.where(waiting[:, None], 0.0, self._way[2]) + self._platform_push
        commands = self._commands(wanted, state[:, YAW])
        self._stopped |= ~waiting & ((height < CUT) | (self._remaining < 0.0))
        commands[self._stopped, 0] = 0.0
        return commands

    def _end(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position, velocity and acceleration (n, 3) at the end, relative to the platform's centre."""
        down = np.array([0.0, 0.0, -self._gravity])
        along = down - (normal @ down)[:, None] * normal  # of gravity, under thrust that bears the rest
        return self._rest * normal, -SINK * normal, along

    def _follow(self, on: np.ndarray, normal: np.ndarray) -> None:
        """Advance by a period on the minimum-jerk trajectories from the vehicles to the present platforms."""
        remaining = np.maximum(self._remaining, LEAST)
        remaining[~on] = 1.0
        end = np.array(self._end(normal))
        place, velocity, push = self._way
        s = remaining[:, None]
        # The jerk, its rate and its second rate at the beginning of the way that is remaining.
        gap = end[0] - place - velocity * s - 0.5 * push * s**2
        rush = end[1] - velocity - push * s
        turn = end[2] - push
        jerk = (60.0 * gap / s**3) - (24.0 * rush / s**2) + (3.0 * turn / s)
        snap = -(360.0 * gap / s**4) + (168.0 * rush / s**3) - (24.0 * turn / s**2)
        crackle = (720.0 * gap / s**5) - (360.0 * rush / s**4) + (60.0 * turn / s**3)
        h = self._period
        moved = (
            place
            + velocity * h
            + push * h**2 / 2
            + jerk * h**3 / 6
            + snap * h**4 / 24
            + crackle * h**5 / 120,
            velocity + push * h + jerk * h**2 / 2 + snap * h**3 / 6 + crackle * h**4 / 24,
            push + jerk * h + snap * h**2 / 2 + crackle * h**3 / 6,
        )
        for row, value in zip(self._way, moved):
            row[on] = value[on]
        self._remaining[on] -= h

    def _commands(self, wanted: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Return commands (n, 4) for accelerations (n, 3) [m/s2]."""
        thrust = wanted + [0.0, 0.0, self._gravity]
        thrust[:, Z] = np.maximum(thrust[:, Z], LEAST_LIFT * self._gravity)
        rate = (thrust - self._thrust) / self._period
        self._thrust = thrust
        ahead = thrust + np.clip(self._lead * rate, -0.5 * self._gravity, 0.5 * self._gravity)
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y, z = cos * ahead[:, 0] + sin * ahead[:, 1], cos * ahead[:, 1] - sin * ahead[:, 0], ahead[:, 2]
        pitch = np.arcsin(x / np.linalg.norm(ahead, axis=1)) / self._gain
        roll = np.arctan2(-y, z) / self._gain
        pwm = self._hover * np.linalg.norm(thrust, axis=1) / self._gravity
        angles = np.clip(np.column_stack([roll, pitch]), -self._angle, self._angle)
        turn = np.clip(-yaw, -self._yaw_rate, self._yaw_rate)
        return np.column_stack([np.clip(pwm, *self._pwm), angles, turn])
