"""A custom controller: `landing-eval robustness examples/own_controller.py:Descend --over moving`."""

import numpy as np


class Descend:
    """Stays over the platform, sinks with it in view, and stops the motors just above."""

    def __init__(self, vehicle):
        self.g, self.limit = vehicle.environment_gravity, np.radians(30)
        self.hover = 34_100  # PWM

    def __call__(self, t, state, platform):
        place, speed = state[:, :3] - platform[:, :3], state[:, 3:6] - platform[:, 3:6]
        aside = np.linalg.norm(place[:, :2], axis=1)
        place[:, 2] -= np.where(aside < 0.1, 0.0, 0.4)  # sink once over the centre
        push = np.clip(-4 * place - 3 * speed, -4, 4)  # m/s2
        pwm = self.hover * (1 + push[:, 2] / self.g)
        pwm[(state[:, 2] - platform[:, 2] < 0.05) & (aside < 0.2)] = 0
        roll, pitch = np.clip([-push[:, 1] / self.g, push[:, 0] / self.g], -self.limit, self.limit)
        return np.column_stack([pwm, roll, pitch, 0 * pwm])
