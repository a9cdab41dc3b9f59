"""`landing-train sweep`: command lines for every seed, side by side, and the numbers that come out.

`command` runs what `recipe` reads: each seed is a job (`jobs`), the numbers are summed up in `result`.
"""
