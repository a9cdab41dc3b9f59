"""The frozen benchmark of landings on moving platforms: scenarios, controllers, scorer.

scenario: its files, read and drawn; `scenarios/` has them, `spectra` says where the ship's and the car's
motions come from. controllers: what may be scored, and how others' are loaded; planner: the one without
learning. flying: flights of a controller through a scenario, evaluated. report: table and figure.
`landing-eval robustness --over moving` runs it.
"""
