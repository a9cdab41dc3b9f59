"""Landing studies: many simulated and classified touchdowns over parameters given in a TOML file.

`parameters.py` defines the parameters, `study.py` reads a study file, `landing.py` simulates and classifies
landings, `run.py` distributes and runs those of a study, here or on Ray, and `sensitivity.py`, `maps.py` and
`report.py` evaluate the results.
"""
