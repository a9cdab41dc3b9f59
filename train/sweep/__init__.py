"""`landing-train sweep`: run command lines for every seed, in parallel, and summarise the numbers.

`recipe` reads the file, `command` runs each seed as a job (`jobs`), and `result` summarises the numbers.
"""
