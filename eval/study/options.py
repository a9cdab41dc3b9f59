"""Options of the studies and their defaults; nothing slow is imported."""

from __future__ import annotations

THRUSTS = tuple(round(0.70 + 0.05 * k, 2) for k in range(10))  # actual thrust over that of the training
VEHICLES = ("crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird")
PLANNER = "planner"
BASELINES = ("touchdown-moving", "landing-moving", PLANNER)  # on moving platforms
NOMINAL = "landing-nominal"  # its motors are cut, for comparison with touchdown policies
FRICTIONS = (0.5, 0.6, 0.8, 1.2)
RESTITUTIONS = (0.0, 0.25, 0.5)
