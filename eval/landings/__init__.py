"""Landing studies: many simulated touchdowns, each classified, over parameters given in a TOML file.

`parameters.py` says what may vary, `study.py` reads a study file, `design.py` spreads the landings,
`landing.py` simulates and classifies them, `run.py` runs a study in chunks, here or on Ray,
`sensitivity.py`, `maps.py` and `report.py` make something of the results.
"""
