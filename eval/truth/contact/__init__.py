"""Can what happens at touchdown be believed? `landing-eval contact` answers with numbers.

`drops` are the unpowered vehicles that are set down or dropped, `laws` the measurements, `figures` what is
drawn of them. Measured touchdowns are simulated by `python -m tests.proof touchdowns`, from a clone.
"""
