"""The approach of a feedback law to a point over a platform, from which its descent begins.

Chosen by hand on starts that no evaluation has.
"""

from __future__ import annotations

import numpy as np

ABOVE = 0.45  # m over the height at rest, along the platform's normal, of the point
LOWEST = 0.35  # m over the height at rest, which the vehicle keeps on its way there
SINK = 0.25  # m/s into the platform at the end of the descent
STIFFNESS, DAMPING = 9.0, 5.0  # 1/s2 and 1/s, gains on the errors of position and velocity
FARTHEST = 0.6  # m, limit of the position error
LEAST_LIFT = 0.3  # least vertical thrust, in weights


def limited_error(target: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the errors (n, 3) from places to targets (n, 3), limited to FARTHEST [m]."""
    error = target - place
    far = np.linalg.norm(error, axis=1, keepdims=True)
    return error * np.minimum(1.0, FARTHEST / np.maximum(far, 1e-9))
