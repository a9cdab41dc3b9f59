"""Validation of the simulator: two sets of claims, each with its tolerance and the measured value.

`equivalence` compares the vehicle with the paper's model, and `contact` compares touchdowns with mechanics.
The text and tolerances of their claims are in `claims.toml`; `report` measures them and writes the page,
`figures` draws.
"""
