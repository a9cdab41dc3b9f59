"""The flight that tells: a safe flight that separates what a diagnosis holds for possible.

`design` chooses smooth pieces of flight by the information that they are expected to bring.
"""

from inclined_landing.eval.gap.plan.design import Plan, design
from inclined_landing.eval.gap.plan.information import Hypothesis, NoiseLevels

__all__ = ["Hypothesis", "NoiseLevels", "Plan", "design"]
