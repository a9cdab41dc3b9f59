"""The gap workflow: where simulation and measured flights disagree, and which physical effect is missing.

`diagnose(flights, vehicle)` names it, `Diagnosis.apply(vehicle)` adds it, `measure_gap(vehicle, flights)`
shows the gap before and after.
"""

from inclined_landing.eval.gap.answer.diagnosis import diagnose
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.eval.gap.search.rollout import measure_gap

__all__ = ["Diagnosis", "diagnose", "measure_gap"]
