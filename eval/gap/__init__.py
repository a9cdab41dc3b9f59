"""The gap workflow: where simulation and measured flights disagree, and which physical effect is missing.

`diagnose(flights, vehicle)` names it, `Diagnosis.apply(vehicle)` adds it, `measure_gap(vehicle, flights)`
shows the gap before and after.
"""
