"""Figures on paper: trajectories, learning curves, curricula. Curves, shapes and text are vectors.

Every function returns a matplotlib Figure; `save_figure` writes it as PNG or PDF. No display is used.
"""

from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures.curriculum import curriculum_figure
from inclined_landing.eval.pictures.figures.curves import comparison_curves, final_scores, learning_curves
from inclined_landing.eval.pictures.figures.mission import mission_figure
from inclined_landing.eval.pictures.figures.trajectory import trajectory_figure

__all__ = [
    "comparison_curves",
    "curriculum_figure",
    "final_scores",
    "learning_curves",
    "mission_figure",
    "save_figure",
    "trajectory_figure",
]
