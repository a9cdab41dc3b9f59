"""Contact at touchdown compared with the laws of mechanics: `landing-eval contact`.

`drops` simulates unpowered vehicles that are set down or dropped, `laws` measures, `figures` draws.
"""
