"""Land without learning: a polynomial path with feedback, compared with a shipped policy on the same actions.

python examples/classical_landing.py [POLICY]

The goal box requires the slope's pitch alpha, at which a quadrotor that keeps its height accelerates by
g tan(alpha). The path therefore ends with this acceleration and without speed: from a waypoint above the
goal it swings out downhill and comes back up. Law and policy fly from the frozen grid of 251 starts.
"""

import sys

import numpy as np

from inclined_landing.envs import load_policy, make_task, record_flights
from inclined_landing.envs.tasks import frozen as starts
from inclined_landing.envs.tasks import hover_states

ABOVE = np.array([-0.1, 0.45])  # m from the goal to the waypoint in x, z
CRUISE, APPROACH = (0.9, 0.45), 1.0  # s, and s per m, to the waypoint; s from there to the goal
LAG = 0.08  # s by which thrust and attitude lag their commands; the law looks this far ahead
MOST = 5.5  # m/s2, of the acceleration in x and in z
SHORTEST = 0.25  # s, least time to go that the law assumes


class Law:
    """A controller with a policy's interface, for vehicles that start together."""

    def __init__(self, task):
        vehicle = task.vehicle
        self.task, self.g = task, vehicle.environment_gravity
        self.hover, self.period = vehicle.hover_pwm, vehicle.command_control_period
        self.thrust, self.pitch = task.channels
        self.goal, self.time, self.first = np.array(task.goal_position), 0.0, None
        self.push = np.zeros(2)
        self.last_push = np.array([self.g * np.tan(task.inclination), 0.0])  # m/s2

    def predict(self, observation):
        """Return actions (n, 2) for observations (n, 5): x, z, vx, vz, pitch."""
        place, speed = observation[:, :2] - self.goal, observation[:, 2:4]
        if self.first is None:
            self.first = CRUISE[0] + CRUISE[1] * np.linalg.norm(place - ABOVE, axis=1)
        place, speed = place + speed * LAG + self.push * LAG**2 / 2, speed + self.push * LAG
        left = self.first - self.time - LAG
        cruising = left > SHORTEST
        waypoint, goal = (np.maximum(t, SHORTEST)[:, None] for t in (left, left + APPROACH))
        push = np.where(
            cruising[:, None],
            accelerate(place - ABOVE, speed, 0.0, waypoint),
            accelerate(place, speed, self.last_push, goal),
        )
        push = np.clip(push, -MOST, MOST)
        self.push = (push + self.push) / 2  # is felt after the lag
        self.time += self.period
        up = np.maximum(push[:, 1] + self.g, 1.0)
        pitch = np.clip(np.arctan2(push[:, 0], up), -self.pitch.span, self.pitch.span)
        pwm = self.hover * np.hypot(push[:, 0], up) / self.g
        actions = np.column_stack([(pwm - self.thrust.centre) / self.thrust.span, pitch / self.pitch.span])
        return np.clip(actions, -1.0, 1.0)


def accelerate(place, speed, last, left):
    """Return the acceleration with which the minimum-jerk path begins.

    It ends after `left` seconds at position 0 and speed 0 with acceleration `last`: with the time to go s,
    x = last s^2/2 + c3 s^3 + c4 s^4, and c3, c4 from the current position and speed.
    """
    e, d = place - last * left**2 / 2, -last * left - speed
    return last + (6 * d * left - 12 * e) / left**2


def main() -> None:
    policy = load_policy(sys.argv[1] if len(sys.argv) > 1 else "landing-nominal")
    task = make_task("landing")
    for name, pilot in {"feedback law": Law(task), f"policy {policy.name}": policy}.items():
        flights = record_flights(pilot, "hybrid", hover_states(starts.grid(), pilot.task.vehicle))
        strict = [flight.strict for flight in flights]
        seconds = np.median([flight.duration for flight in flights if flight.strict] or [np.nan])
        print(
            f"{name}: {sum(strict)} of {len(strict)} starts, strict; median {seconds:.2f} s to the goal box"
        )


if __name__ == "__main__":
    main()
