"""The path of a flight, and the positions of copies of the vehicle on it."""

from __future__ import annotations

import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL


def path_share(state: np.ndarray, turn: float = 0.0) -> np.ndarray:
    """Return the share (T,) of the path length covered at states (T, 13); by index if at rest.

    turn: path length [m] that a turn of one radian counts.
    """
    # s_k = sum_j |dp_j| + turn (|droll_j| + |dpitch_j|), over its last value
    step = np.linalg.norm(np.diff(state[:, :3], axis=0), axis=1)
    turned = np.abs(np.diff(state[:, [ROLL, PITCH]], axis=0)).sum(axis=1)
    length = np.concatenate([[0.0], np.cumsum(step + turn * turned)])
    return length / length[-1] if length[-1] > 0.0 else np.linspace(0.0, 1.0, len(state))


def select_copies(state: np.ndarray, copies: int, spacing: float, turn: float = 0.0) -> np.ndarray:
    """Return at most `copies` samples of states (T, 13), first and last included, evenly spaced on the path.

    spacing: they are at least about this [m] apart. turn: as for `path_share`.
    """
    length = np.linalg.norm(np.diff(state[:, :3], axis=0), axis=1).sum()
    count = int(np.clip(length / spacing, 1, max(copies - 1, 1)))
    samples = np.searchsorted(path_share(state, turn), np.linspace(0.0, 1.0, count + 1) - 1e-9)
    return np.unique(np.minimum(samples, len(state) - 1))
