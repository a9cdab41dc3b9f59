"""The gap workflow: where simulation and measured flights disagree, and which physical effect is missing.

`diagnose(flights, vehicle)` names it, `Diagnosis.apply(vehicle)` adds it, `measure_gap(vehicle, flights)`
shows the gap before and after.
"""

from typing import TYPE_CHECKING

from inclined_landing.models.base.imports import at_first_use

if TYPE_CHECKING:
    from inclined_landing.eval.gap.answer.rollout import measure_gap
    from inclined_landing.eval.gap.pipeline import diagnose
    from inclined_landing.eval.gap.result import Diagnosis

__all__ = ["Diagnosis", "diagnose", "measure_gap"]

_MODULES = {"Diagnosis": "result", "diagnose": "pipeline", "measure_gap": "answer.rollout"}
__getattr__ = at_first_use(__name__, _MODULES)
