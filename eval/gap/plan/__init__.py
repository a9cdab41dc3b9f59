"""Experiment design: the safe flight that discriminates best between the probable sets of a diagnosis.

`design` chooses smooth manoeuvres by their expected information gain.
"""

from inclined_landing.eval.gap.plan.design import Plan, design
from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.result import ScoredSet

__all__ = ["NoiseLevels", "Plan", "ScoredSet", "design"]
