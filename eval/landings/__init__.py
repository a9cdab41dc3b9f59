"""Landing studies: many simulated and classified touchdowns over parameters given in a TOML file.

`parameters.py` defines the parameters, `study.py` reads a study file, `design.py` distributes the landings,
`landing.py` simulates and classifies them, `run.py` runs a study in chunks, here or on Ray, and
`sensitivity.py`, `maps.py` and `report.py` evaluate the results.
"""
