"""The frozen benchmark of landings on moving decks: scenarios, controllers, scorer.

scenario: its files, read and drawn; `scenarios/` has them, `spectra` says where the ship's and the car's
motions come from. controllers: what may be scored, and how others' are loaded; planner: the one without
learning. flying: flights of a controller through a scenario, judged. report: table, figure and page.
"""
