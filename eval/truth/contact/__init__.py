"""Can what happens at touchdown be believed? `landing-eval contact` answers with numbers.

`drops` are the unpowered vehicles that are set down or dropped, `laws` the measurements, `touchdowns` the
comparison with measured flights, `figures` what is drawn of them.
"""
