"""The frozen benchmark of landings on moving platforms, `landing-eval robustness --over moving`.

scenario: its files, read and drawn; `scenarios/` has them. controllers: what may be scored, and how others'
are loaded; planner: the one without learning. study: flights of controllers through scenarios, and what is
counted of them.
"""
