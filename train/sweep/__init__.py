"""`landing-train sweep`: a recipe's trainings for every seed, their evaluation, and what came out.

`command` < `spread` < `jobs` < `children` < `child`: the options, the runs side by side, the steps of one of
them, its processes, one process. `check.py` looks at a recipe before it is run, `record.py` writes the result
into it.
"""
