"""Experiment design: the safe flight that discriminates best between the probable sets of a diagnosis.

`design.design` chooses smooth manoeuvres by their expected information gain.
"""

SECONDS = 20.0  # of a planned flight, unless another duration is given
