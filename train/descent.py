"""A feedback law that touchdown over moving platforms begins with: stay over the platform, sink, stop the
motors.

It sees what the policy sees and remembers nothing, so that a network can take it over by imitation. It
knows nothing of the slope: the vehicle comes down level. Reinforcement learning goes on from there.
"""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.tasks import StepContext, Task
from inclined_landing.models import surface
from inclined_landing.models.attitude import VX, VZ, X, Y, Z
from inclined_landing.models.equations import settled_hover

NAME = "descent"  # as in --from
STIFFNESS, DAMPING = 4.0, 3.0  # 1/s2, 1/s
LARGEST = 4.0  # m/s2 along each axis
FUNNEL = 4.0  # m of height per metre beside the platform's centre, beyond
CENTRE, HIGHEST = 0.05, 0.4  # m, and up to m
CUT_HEIGHT, CUT_BESIDE = 0.06, 0.2  # m over and beside the centre, where the motors stop


class Descent:
    """The law, as actions of a task in three dimensions."""

    def __init__(self, task: Task):
        v = task.vehicle
        self._task = task
        self._hover, self._gravity = settled_hover(v), v.environment_gravity
        slope, least = v.motor_pwm_to_speed
        turning = v.motor_count * (slope * self._hover + least)  # rad/s, of all rotors
        self._drag = -v.drag_coefficients[0] * turning / (v.body_mass + v.effects_load_mass)  # 1/s

    def __call__(self, context: StepContext, idle: float) -> np.ndarray:
        """Return actions (n, a) in n states over their platforms; idle: that of stopped motors."""
        seen = surface.heading_frame(context.state, context.platform)
        beside = np.hypot(seen[:, X], seen[:, Y])
        place = seen[:, : Z + 1].copy()
        place[:, Z] -= np.clip(FUNNEL * (beside - CENTRE), 0.0, HIGHEST)
        push = np.clip(-STIFFNESS * place - DAMPING * seen[:, VX : VZ + 1], -LARGEST, LARGEST)
        push[:, :Z] += self._drag * surface.platform_motion(context.platform)[:, :Z]
        wanted = {
            "thrust": self._hover * (1.0 + push[:, Z] / self._gravity),
            "roll": -push[:, Y] / self._gravity,
            "pitch": push[:, X] / self._gravity,
        }
        columns = [(wanted[c.name] - c.centre) / c.span for c in self._task.channels]
        actions = np.clip(np.column_stack(columns), -1.0, 1.0)
        stop = (seen[:, Z] < CUT_HEIGHT) & (beside < CUT_BESIDE)
        actions[stop, 0] = idle
        return actions
