"""The vehicle's own position estimate in the place of motion capture, from a Lighthouse or a Flow deck.

The firmware's Kalman filter runs on board; its estimate comes by a log block and is taken as poses without an
attitude. It is believed while the filter itself says that it knows the velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from inclined_landing.eval.flying import frames
from inclined_landing.eval.flying.interfaces import Pose
from inclined_landing.models.errors import UserError

LIGHTHOUSE, FLOW = "Lighthouse", "Flow"
PARAMETERS = {LIGHTHOUSE: "deck.bcLighthouse4", FLOW: "deck.bcFlow2"}  # 1 where the deck is there
POSITION = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
VARIANCE = ("kalman.varPX", "kalman.varPY", "kalman.varPZ")  # of the velocity, m2/s2 (`estimator_kalman.c`)
NOISE = 0.003  # m, standard deviation that the pilot gives such a position: it wanders by millimetres
UNSURE = 0.2  # m/s: a filter that knows its velocity no better has lost what its deck sees


def find_deck(value: Callable[[str], Any]) -> str:
    """Return the deck that a vehicle positions itself by, the Lighthouse first.

    value: of a parameter by name; raises KeyError for one that the firmware does not have. Raises UserError
    where there is neither.
    """
    for deck, parameter in PARAMETERS.items():
        try:
            there = int(float(value(parameter)))
        except KeyError:
            continue
        if there:
            return deck
    raise UserError(
        "the vehicle has no deck to know its position by: neither a Lighthouse deck (deck.bcLighthouse4) "
        "nor a Flow deck (deck.bcFlow2) is found"
    )


class OnboardPosition:
    """A `MotionCapture` of what the vehicle says.

    deck: the one it positions itself by. at: x, y [m] where the vehicle stands and the heading [rad] of its
    nose, for a Flow deck, which knows neither; a Lighthouse's frame is the arena's. floor: height [m] of the
    centre of mass where it stands.
    """

    def __init__(self, deck: str, at: tuple[float, float], heading: float, floor: float):
        self.deck = deck
        self._pose: Pose | None = None
        self._believed = False
        self._at, self._floor = np.array([*at, floor]), floor
        self._turn = frames.about_z(heading) if deck == FLOW else np.eye(3)
        self._origin: np.ndarray | None = None if deck == FLOW else np.zeros(3)

    def latest(self) -> Pose | None:
        """Return the newest pose; None before the first one."""
        return self._pose

    def add_position(self, time: float, position: np.ndarray) -> None:
        """Add a position (3,) [m] of the vehicle's estimate that it had at `time` [s]."""
        if not (self._believed and np.isfinite(position).all()):
            return
        if self._origin is None:  # what a Flow deck shows where the vehicle stands
            self._origin = position.copy()
        placed = self._turn @ (position - self._origin) + (self._at if self.deck == FLOW else 0.0)
        self._pose = Pose(time, placed)

    def add_variance(self, variance: np.ndarray) -> None:
        """Add what the vehicle's filter says of its velocity, (3,) [m2/s2]."""
        self._believed = bool(np.isfinite(variance).all() and math.sqrt(max(variance)) < UNSURE)
