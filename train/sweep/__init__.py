"""`landing-train sweep`: command lines for every seed, in parallel, and the resulting numbers.

`command` runs what `recipe` reads: each seed is a job (`jobs`), `result` summarises the numbers.
"""
