"""Scenario files (TOML): which deck, which motion, which starts, and what counts as landed.

version   of the scenario; whoever changes one gives it another name
title     one line; source: where the motion comes from
seed      of everything drawn; flights: how many

[deck]    inclination_deg: mean slope, falling towards the bow (the deck's own +x) where positive;
          azimuth_deg: of the bow, or "any": drawn for each flight; friction: between feet and deck
[motion]  speed [m/s]: of steady travel; course_deg: its direction from the bow, or "any"
[waves]   period [s] (W,): of the components. For each of surge, sway, heave [m], roll, pitch, yaw [deg]
          that moves: amplitude (W,) and phase_deg (W,). All axes of a component share one phase, drawn for
          each flight. Surge is along the bow, sway to port of it, roll and pitch about the deck's own axes.
[start]   x, y, z [m]: box of the starts, hovering at rest in the room; from the centre of the deck at the
          start, along the room's axes
[success] speed [m/s], rate [rad/s]: of the vehicle relative to the deck, below which it rests; hold [s]: for
          how long, on the feet alone, motors idle; within [s] of the start, which must be longer

An axis moves by sum over w of amplitude cos(2 pi t / period + phase + the flight's own phase of w).
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import math
import os
from importlib import resources
from pathlib import Path

import numpy as np

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models import storage
from inclined_landing.models.attitude import PITCH, YAW, Z
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants.base import DECK_SIZE

VERSION = 1  # of the format
ANY = "any"
_TABLES = {
    "deck": ("inclination_deg", "azimuth_deg", "friction"),
    "motion": ("speed", "course_deg"),
    "waves": ("period", *MODES),
    "start": ("x", "y", "z"),
    "success": ("speed", "rate", "hold", "within"),
}
_TOP = ("version", "title", "source", "seed", "flights", *_TABLES)
_MOST_FLIGHTS, _MOST_WAVES = 100_000, 64
# Ranges that a number may be from.
_LIMITS = {
    "inclination_deg": (-50.0, 50.0),
    "friction": (0.0, 3.0),
    "speed": (0.0, 10.0),
    "period": (0.05, 1000.0),
    "rate": (0.0, 100.0),
    "hold": (0.02, 60.0),
    "within": (0.1, 600.0),
}
_ANGLE, _LENGTH = (-360.0, 360.0), (-10.0, 10.0)
_STEEPEST = 60.0  # deg: the deck's roll and pitch, with the mean slope


@dataclasses.dataclass(frozen=True)
class Waves:
    """Components of a motion, W of them; see the module's docstring."""

    period: np.ndarray  # (W,) s
    amplitude: np.ndarray  # (6, W) m and rad, of motion.MODES
    phase: np.ndarray  # (6, W) rad


@dataclasses.dataclass(frozen=True)
class Success:
    """Below what a vehicle rests on the deck, and for how long."""

    speed: float  # m/s
    rate: float  # rad/s
    hold: float  # s
    within: float  # s after the start


@dataclasses.dataclass(frozen=True)
class Scenario:
    """One scenario file."""

    name: str
    title: str
    source: str
    seed: int
    flights: int
    inclination: float  # rad
    azimuth: float | None  # rad; None: any
    friction: float
    speed: float  # m/s
    course: float | None  # rad; None: any
    waves: Waves
    start: np.ndarray  # (3, 2) m, from and to
    success: Success
    fingerprint: str  # of the file

    def draw(self, vehicle: Vehicle, flights: int | None = None) -> Drawn:
        """The flights of the scenario; fewer are the first ones.

        Every flight has a generator of its own, so that how many are flown changes none.
        """
        n = self.flights if flights is None else min(self.flights, flights)
        w = len(self.waves.period)
        place, azimuth, course = np.empty((n, 3)), np.empty(n), np.empty(n)
        phase = np.empty((n, w))
        for k in range(n):
            draws = np.random.default_rng([self.seed, k]).random(5 + w)
            place[k] = self.start[:, 0] + draws[:3] * (self.start[:, 1] - self.start[:, 0])
            azimuth[k] = 2.0 * math.pi * draws[3] - math.pi if self.azimuth is None else self.azimuth
            course[k] = 2.0 * math.pi * draws[4] - math.pi if self.course is None else self.course
            phase[k] = 2.0 * math.pi * draws[5:]
        heading = azimuth + course
        velocity = self.speed * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(n)])
        waves = self.waves.amplitude * np.exp(1j * (self.waves.phase + phase[:, None, :]))  # (n, 6, W)
        bow = np.exp(1j * azimuth)[:, None]
        surge, sway = waves[:, 0].copy(), waves[:, 1].copy()
        waves[:, 0] = bow.real * surge - bow.imag * sway
        waves[:, 1] = bow.imag * surge + bow.real * sway
        motion = Motion(
            velocity=velocity,
            amplitude=np.abs(waves),
            frequency=np.broadcast_to(2.0 * math.pi / self.waves.period, (n, 6, w)),
            phase=np.angle(waves) + 0.5 * math.pi,  # of a sine
        )
        rest = np.zeros((n, DECK_SIZE))
        rest[:, Z], rest[:, PITCH], rest[:, YAW] = vehicle.platform_surface_height, self.inclination, azimuth
        place += motion.decks(0.0, rest)[:, : Z + 1]
        return Drawn(np.full(n, self.inclination), azimuth, motion, hover_states(place, vehicle))


@dataclasses.dataclass(frozen=True)
class Drawn:
    """n flights of a scenario, in the room."""

    inclination: np.ndarray  # (n,) rad, of the decks without their waves
    azimuth: np.ndarray  # (n,) rad
    motion: Motion
    start: np.ndarray  # (n, 13)


def shipped() -> dict[str, Path]:
    """The frozen scenarios, by name, in the order of the tables."""
    folder = Path(str(resources.files("inclined_landing.eval.moving") / "scenarios"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_scenario(name: str | Path) -> Scenario:
    """Read a scenario file, or a frozen scenario by name.

    Raises UserError, one sentence naming the file and the entry, for whatever is wrong.
    """
    path = shipped().get(str(name), Path(name))
    if not os.path.lexists(path):
        known = shipped()
        near = difflib.get_close_matches(str(name), known, 1) or list(known)
        frozen = f"the {len(known)} frozen ones are such as {near[0]}"
        raise UserError(f"scenario {shown(path, 200)} does not exist; {frozen}")
    content = storage.read_bytes(path, "scenario")
    try:
        return _parse(path.stem, storage.read_toml(path, "scenario"), hashlib.sha256(content).hexdigest())
    except UserError as error:
        said = str(error)
        raise UserError(said if said.startswith("scenario ") else f"scenario {path}: {said}") from error


def _parse(name: str, data: dict, fingerprint: str) -> Scenario:
    _only(data, _TOP, "the file")
    missing = [key for key in _TOP if key not in data and key != "waves"]
    if missing:
        raise UserError(f"{missing[0]} is missing")
    if data["version"] != VERSION or isinstance(data["version"], bool):
        raise UserError(f"version must be {VERSION}, not {shown(repr(data['version']), 40)}")
    tables = {key: data.get(key, {}) for key in _TABLES}
    for key, table in tables.items():
        _only(table, _TABLES[key], f"[{key}]")
        if lacking := [entry for entry in _TABLES[key] if entry not in table and key != "waves"]:
            raise UserError(f"[{key}] lacks {lacking[0]}")
    deck, motion, success = tables["deck"], tables["motion"], tables["success"]
    inclination = math.radians(_number(deck, "inclination_deg", "[deck] "))
    waves = _waves(tables["waves"])
    tilt = np.abs(waves.amplitude[3:5]).sum() + abs(inclination)
    if tilt > math.radians(_STEEPEST):
        raise UserError(
            f"slope, roll and pitch together reach {math.degrees(tilt):.0f} deg; {_STEEPEST:g} at most"
        )
    rest = Success(*(_number(success, key, "[success] ") for key in _TABLES["success"]))
    if rest.hold >= rest.within:
        raise UserError(
            f"[success] hold is {rest.hold:g} s, but must be shorter than within, {rest.within:g} s"
        )
    return Scenario(
        name=name,
        title=_text(data, "title"),
        source=_text(data, "source"),
        seed=_whole(data, "seed", 0, 2**32 - 1),
        flights=_whole(data, "flights", 1, _MOST_FLIGHTS),
        inclination=inclination,
        azimuth=_angle_or_any(deck, "azimuth_deg", "[deck] "),
        friction=_number(deck, "friction", "[deck] "),
        speed=_number(motion, "speed", "[motion] "),
        course=_angle_or_any(motion, "course_deg", "[motion] "),
        waves=waves,
        start=np.array([_box(tables["start"], axis) for axis in "xyz"]),
        success=rest,
        fingerprint=fingerprint,
    )


def _waves(table: dict) -> Waves:
    if not table:
        return Waves(np.ones(1), np.zeros((6, 1)), np.zeros((6, 1)))
    period = _numbers(table, "period", "[waves] ", None, _LIMITS["period"])
    w = len(period)
    if not 1 <= w <= _MOST_WAVES:
        raise UserError(f"[waves] period has {w} entries; a motion has 1 to {_MOST_WAVES} components")
    amplitude, phase = np.zeros((6, w)), np.zeros((6, w))
    for k, mode in enumerate(MODES):
        if mode not in table:
            continue
        _only(table[mode], ("amplitude", "phase_deg"), f"[waves] {mode}")
        limits, factor = (_LENGTH, 1.0) if k < 3 else (_ANGLE, math.pi / 180.0)
        amplitude[k] = factor * _numbers(table[mode], "amplitude", f"[waves] {mode}: ", w, limits)
        phase[k] = np.radians(_numbers(table[mode], "phase_deg", f"[waves] {mode}: ", w, _ANGLE))
    return Waves(period, amplitude, phase)


def _box(table: dict, axis: str) -> np.ndarray:
    low, high = _numbers(table, axis, "[start] ", 2, _LENGTH)
    if low > high:
        raise UserError(f"[start] {axis} goes from {low:g} down to {high:g}")
    return np.array([low, high])


def _angle_or_any(table: dict, key: str, where: str) -> float | None:
    if table[key] == ANY:
        return None
    if isinstance(table[key], str):
        raise UserError(f"{where}{key} must be an angle or {ANY!r}, not {shown(repr(table[key]), 40)}")
    return math.radians(_checked(table[key], f"{where}{key}", _ANGLE))


def _number(table: dict, key: str, where: str) -> float:
    return _checked(table[key], where + key, _LIMITS[key])


def _numbers(table: dict, key: str, where: str, count: int | None, limits: tuple[float, float]) -> np.ndarray:
    values = table.get(key)
    if not isinstance(values, list) or (count is not None and len(values) != count):
        many = "numbers" if count is None else f"{count} numbers"
        raise UserError(f"{where}{key} must be a list of {many}, not {shown(repr(values), 40)}")
    return np.array([_checked(value, where + key, limits) for value in values])


def _checked(value, what: str, limits: tuple[float, float]) -> float:
    low, high = limits
    if type(value) not in (int, float) or not low <= value <= high:
        raise UserError(f"{what} must be a number from {low:g} to {high:g}, not {shown(repr(value), 40)}")
    return float(value)


def _whole(table: dict, key: str, low: int, high: int) -> int:
    value = table[key]
    if type(value) is not int or not low <= value <= high:
        raise UserError(f"{key} must be a whole number from {low} to {high}, not {shown(repr(value), 40)}")
    return value


def _text(table: dict, key: str) -> str:
    value = table[key]
    if not isinstance(value, str) or not 0 < len(value.strip()) <= 2000:
        raise UserError(f"{key} must be a text of at most 2000 characters")
    return value.strip()


def _only(table, known: tuple[str, ...], where: str) -> None:
    if not isinstance(table, dict):
        raise UserError(f"{where} must be a table")
    if unknown := sorted(set(table) - set(known)):
        said = shown(repr(unknown[0]), 40)
        raise UserError(f"unknown entry {said} in {where}; known are {', '.join(known)}")
