"""Translucent copies of the vehicle."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Ghost:
    """A copy of the vehicle at qpos (7,): `colour` mixed in by `tint`, opacity `alpha`.

    `shadow`: the copy casts one (backend "ray").
    """

    qpos: np.ndarray
    colour: tuple[float, float, float] = (0.12, 0.62, 0.30)
    alpha: float = 0.45
    tint: float = 0.8
    shadow: bool = False
