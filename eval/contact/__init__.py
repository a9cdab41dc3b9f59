"""Can what happens at touchdown be believed? `landing-eval contact-truth` answers with numbers.

`vehicles` are the unpowered vehicles that are set down or dropped, `laws` the measurements on them,
`touchdowns` the comparison with measured flights, `report` the page.
"""
