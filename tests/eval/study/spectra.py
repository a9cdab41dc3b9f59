"""Waves of the ship and car scenarios; `python -m tests.eval.study.spectra` prints them.

Ship: a sea of the spectrum of ITTC (two parameters, Bretschneider's), of the significant heights and modal
periods of NATO's sea states (STANAG 4194, annual North Atlantic). Heave and pitch answer by the closed
forms of J. J. Jensen, A. E. Mansour and A. S. Olsen, Estimation of ship motions using closed-form
expressions, Ocean Engineering 31 (2004) 61-85; roll as one damped mode under the effective slope of the
wave (J. E. Conolly, Rolling and its stabilisation by active fins, Trans. RINA 111 (1969)). The hull is a
frigate's of the class FFG-7, its roll damping estimated. The deck lies aft and moves with heave and the
lever of pitch. Lengths are scaled to the slab by Froude's law: lengths by SCALE, times and speeds by its
root, angles and accelerations as they are.

Car: a road of ISO 8608's classes (geometric mean) at walking pace, felt through a quarter-car at either
axle, with the parameters of the golden car (Sayers 1995; ASTM E1926). Not scaled: the slab on the roof of a
real car.

Amplitudes are those of the spectrum, sqrt(2 S dw), and not drawn; phases are relative to the wave at the
ship's centre, or to the road under the front axle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from inclined_landing.models.motion import MODES

GRAVITY = 9.81  # m/s2
KNOT = 1852.0 / 3600.0  # m/s
SCALE = 25.0  # of lengths: 22 m of flight deck, 0.89 m of slab
LENGTH, BEAM, DRAUGHT, BLOCK = 124.4, 13.7, 4.5, 0.45  # m, m, m, 1: FFG-7, waterline, without sonar dome
ROLL_PERIOD, ROLL_DAMPING, ROLL_SLOPE = 10.7, 0.12, 0.8  # s, of critical, of the wave's slope: estimated
DECK = -50.0  # m from the ship's centre, along the bow
SEA_STATES = {4: (1.88, 8.8), 5: (3.25, 9.7), 6: (5.0, 12.4)}  # significant height m, modal period s
SEA = np.linspace(0.35, 1.5, 11)  # rad/s, bounds of the components
ROADS = {"B": 64e-6, "E": 4096e-6}  # m3, at REFERENCE
REFERENCE = 0.1  # cycles/m
TYRE, SPRING, AXLE, DAMPER = 653.0, 63.3, 0.15, 6.0  # 1/s2, 1/s2, 1, 1/s: over the sprung mass
WHEELBASE = 2.7  # m
ROAD = np.geomspace(0.15, 6.0, 13)  # Hz, bounds of the components


class Waves(NamedTuple):
    """W components of a motion in all six axes."""

    period: np.ndarray  # (W,) s
    waves: np.ndarray  # (6, W) m and rad, of motion.MODES: amplitude exp(i phase)


def sea(state: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (W,) [rad/s] and amplitudes (W,) [m] of a sea."""
    height, period = SEA_STATES[state]
    middle, peak = 0.5 * (SEA[1:] + SEA[:-1]), 2.0 * math.pi / period
    density = 5 / 16 * height**2 * peak**4 / middle**5 * np.exp(-1.25 * (peak / middle) ** 4)
    return middle, np.sqrt(2.0 * density * np.diff(SEA))


def ship(state: int, knots: float, heading_deg: float) -> Waves:
    """Motion of the flight deck, scaled. heading_deg: of the waves from the bow's direction, 180 is a head
    sea."""
    w, a = sea(state)
    ahead, abeam = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    k = w**2 / GRAVITY
    met = w - k * knots * KNOT * ahead  # frequency of encounter
    alpha = met / w
    breadth, along = BLOCK * BEAM, np.maximum(np.abs(k * ahead), 1e-9)
    radiated = 2.0 * np.sin(0.5 * k * breadth * alpha**2) * np.exp(-k * DRAUGHT * alpha**2)
    force = np.sqrt((1.0 - k * DRAUGHT) ** 2 + (radiated**2 / (k * breadth * alpha**3)) ** 2)
    force *= np.exp(-along * DRAUGHT)
    u = 0.5 * along * LENGTH
    push = force * np.sin(u) / u
    turn = force * 24.0 / ((2.0 * u) ** 2 * LENGTH) * (np.sin(u) - u * np.cos(u))
    answer = 1.0 / (1.0 - 2.0 * k * DRAUGHT * alpha**2 + 1j * radiated**2 / (k * breadth * alpha**2))
    heave = a * push * answer
    pitch = a * 1j * math.copysign(1.0, ahead) * turn * answer  # bow down
    tuned = met * ROLL_PERIOD / (2.0 * math.pi)
    roll = -1j * a * ROLL_SLOPE * k * abeam / (1.0 - tuned**2 + 2j * ROLL_DAMPING * tuned)  # port up
    modes = {"heave": (heave - DECK * pitch) / SCALE, "roll": roll, "pitch": pitch}
    return _waves(2.0 * math.pi / met / math.sqrt(SCALE), modes)


def car(road: str, speed: float) -> Waves:
    """Motion of a car's roof on a road of a class, at a speed [m/s]."""
    f, w = np.sqrt(ROAD[1:] * ROAD[:-1]), 2.0 * math.pi * np.sqrt(ROAD[1:] * ROAD[:-1])
    density = ROADS[road] * (f / speed / REFERENCE) ** -2.0 / speed  # m2/Hz
    a = np.sqrt(2.0 * density * np.diff(ROAD))
    strut = SPRING + 1j * DAMPER * w
    body = strut * TYRE / ((strut - w**2) * (strut + TYRE - AXLE * w**2) - strut**2)
    front, rear = a * body, a * body * np.exp(-1j * w * WHEELBASE / speed)
    return _waves(1.0 / f, {"heave": 0.5 * (front + rear), "pitch": (rear - front) / WHEELBASE})


def _waves(period: np.ndarray, modes: dict[str, np.ndarray]) -> Waves:
    return Waves(period, np.array([modes.get(mode, np.zeros(len(period), complex)) for mode in MODES]))


def table(waves: Waves) -> str:
    """The entries of a scenario's waves."""

    def numbers(values, digits: int) -> str:
        return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"

    lines = [f"period = {numbers(waves.period, 4)}"]
    for k, mode in enumerate(MODES):
        amplitude = np.abs(waves.waves[k])
        if (amplitude > 1e-9).any():
            size = amplitude if k < 3 else np.degrees(amplitude)
            phase = numbers(np.degrees(np.angle(waves.waves[k])), 1)
            lines.append(
                f"{mode} = {{ amplitude = {numbers(size, 5 if k < 3 else 3)}, phase_deg = {phase} }}"
            )
    return "\n".join(lines) + "\n"


# By the name of the scenario.
MADE = {
    "ship_4_head": lambda: ship(4, 12.0, 180.0),
    "ship_5_bow": lambda: ship(5, 10.0, 135.0),
    "ship_6_beam": lambda: ship(6, 8.0, 90.0),
    "car_road": lambda: car("B", 2.0),
    "car_track": lambda: car("E", 1.5),
}

if __name__ == "__main__":
    for scenario, make in MADE.items():
        print(f"# {scenario}\n{table(make())}")
