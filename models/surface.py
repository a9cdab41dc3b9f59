"""The frame of an inclined surface: out of it, and along it. Inclinations as the platform's, in rad."""

from __future__ import annotations

import numpy as np


def normal_of(inclination) -> np.ndarray:
    """Unit normal (..., 3) of surfaces inclined by `inclination` (...)."""
    a = np.asarray(inclination, float)
    return np.stack([np.sin(a), np.zeros_like(a), np.cos(a)], axis=-1)


def downhill_of(inclination) -> np.ndarray:
    """Unit vector (..., 3) along the surface towards -x, downhill where the inclination is negative."""
    a = np.asarray(inclination, float)
    return np.stack([-np.cos(a), -np.zeros_like(a), np.sin(a)], axis=-1)


def split(vector: np.ndarray, inclination) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (..., 3) as their part along the normal, positive outward, and the size of the rest."""
    normal = normal_of(inclination)
    away = (vector * normal).sum(axis=-1)
    return away, np.linalg.norm(vector - away[..., None] * normal, axis=-1)
