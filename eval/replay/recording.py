"""`Recording`: the data of one flight for the page, from a policy or a log."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.envs.flights import Flight, resimulate
from inclined_landing.eval.pictures.to_rest import LandedFlight, to_rest
from inclined_landing.models.attitude import ROLL, VX, YAW
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants.recorder import still
from inclined_landing.models.vehicle import Vehicle

FLOWN, MEASURED, SIMULATED = "flown", "measured", "simulated"


@dataclasses.dataclass
class Recording:
    """Motion, commands and contacts of one flight; T rows.

    Quantities that were not logged are NaN. When a simulation restarts, it has two rows for the same time:
    the end of the old part and the start of the new one.
    """

    name: str
    kind: str  # FLOWN, MEASURED or SIMULATED
    outcome: str  # a sentence without its full stop
    vehicle: Vehicle
    inclination: float | None  # of the platform, rad; None without one
    t: np.ndarray  # (T,) s, not decreasing
    position: np.ndarray  # (T, 3) m
    attitude: np.ndarray  # (T, 3) roll, pitch, yaw, rad
    velocity: np.ndarray  # (T, 3) m/s
    commands: np.ndarray  # (T, 4) PWM, rad, rad, rad/s, from t on
    # T arrays (k, 3) m, contacts that carry force; None: not known
    points: Sequence[np.ndarray] | None = None
    forces: Sequence[np.ndarray] | None = None  # T arrays (k, 3) N, on the vehicle
    events: list[tuple[float, str]] = dataclasses.field(default_factory=list)  # time [s] and what happens
    # First rows of segments.
    restarts: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, int))
    azimuth: float = 0.0  # of the platform, rad
    goal: np.ndarray | None = None  # (13,) the task's goal as a state
    goal_size: float | None = None  # half width of its box, m

    def downsampled(self, most: int) -> Recording:
        """Return a copy with at most about `most` rows, evenly chosen; segments keep their ends."""
        stride = -(-len(self.t) // most)
        if stride == 1:
            return self
        ends = np.concatenate([[0, len(self.t) - 1], self.restarts, self.restarts - 1]).astype(int)
        rows = np.unique(np.concatenate([np.arange(0, len(self.t), stride), ends]))
        names = ("t", "position", "attitude", "velocity", "commands")
        changed: dict = {name: getattr(self, name)[rows] for name in names}
        for name in ("points", "forces"):
            if getattr(self, name) is not None:
                changed[name] = [getattr(self, name)[k] for k in rows]
        return dataclasses.replace(self, **changed, restarts=np.searchsorted(rows, self.restarts))


def from_flight(flight: Flight, name: str, plant: str) -> Recording:
    """Return the recording of a policy's flight, a landing until it is at rest.

    For the MuJoCo plant it has every engine step with its contacts (see `resimulate`); for others it is at
    the control rate, without contacts. Raises UserError for a flight over a moving platform.
    """
    if flight.motion is not None:
        raise UserError("replay cannot show moving platforms; use landing-eval video")
    task, outcome = flight.task, flight.task.flight_words(flight)
    events = [(flight.duration, "goal box")] if flight.success and task.goal_size is not None else []
    flight = to_rest(flight)
    steps = resimulate(flight) if plant == "mujoco" else None
    source = flight if steps is None else steps
    if isinstance(flight, LandedFlight):
        outcome += f"; motors cut there, {flight.ending} after {flight.t[flight.settled]:.2f} s"
    if steps is not None:
        touched = [k for k, force in enumerate(steps.forces) if len(force)]
        if touched:
            events.append((float(steps.t[touched[0]]), "first touch"))
        moving = np.flatnonzero(~still(steps.state, steps.platform))
        if len(steps.forces[-1]) and len(moving) and moving[-1] + 1 < len(steps.t):
            events.append((float(steps.t[moving[-1] + 1]), "at rest"))
    return Recording(
        name=name,
        kind=FLOWN,
        outcome=outcome,
        vehicle=task.vehicle,
        inclination=flight.inclination,
        t=source.t,
        position=source.state[:, :3],
        attitude=source.state[:, ROLL : ROLL + 3],
        velocity=source.state[:, VX : VX + 3],
        commands=source.commands,
        points=None if steps is None else steps.points,
        forces=None if steps is None else steps.forces,
        events=sorted(events),
        azimuth=0.0 if flight.platform is None else float(flight.platform[0, YAW]),
        goal=task.goal_state,
        goal_size=task.goal_size,
    )
