"""Can what happens at touchdown be believed? `landing-eval validate contact` answers with numbers.

`vehicles` are the unpowered vehicles that are set down or dropped, `laws` the measurements, `touchdowns`
the comparison with measured flights, `report` the page; `claims.toml` has the tolerances and the words.
"""
