"""`landing-train sweep`: a recipe's trainings for every seed, their evaluation, and what came out.

`command` < `summary` < `jobs` < `children`: the options, the numbers, the steps of one run, its processes.
`record.py` writes the result into the recipe.
"""
