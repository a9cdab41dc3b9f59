"""Can what happens at touchdown be believed? `landing-eval contact-truth` answers with numbers.

`vehicles` are the unpowered vehicles that are set down or dropped, `impulse` is what contact gives in one
engine step, `laws` are the measurements, `touchdowns` the comparison with measured flights, `report` the
page.
"""
