"""Scenario files (TOML): platform, motion, starts, and what counts as landed; `File` is their schema.

A changed scenario gets another name. An axis of the deck moves by the sum over the components of
amplitude cos(2 pi t / period + phase_deg + phase), the last drawn for each flight and common to all axes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, field, structs

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models import schema, storage
from inclined_landing.models.attitude import PITCH, YAW, Z
from inclined_landing.models.errors import UserError, choices, shown
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.schema import Table
from inclined_landing.models.vehicle import Vehicle

Angle = Annotated[float, Meta(ge=-360, le=360)]  # deg
Length = Annotated[float, Meta(ge=-10, le=10)]  # m
Speed = Annotated[float, Meta(ge=0, le=10)]  # m/s
Text = Annotated[str, Meta(min_length=1, max_length=2000, pattern=r"\S")]
_STEEPEST = 60.0  # deg: the deck's roll and pitch, with the mean slope


class Deck(Table, frozen=True):
    """[deck]: its mean slope, falling towards the bow (the deck's own +x) where positive."""

    inclination_deg: Annotated[float, Meta(ge=-50, le=50)]
    azimuth_deg: Angle | Literal["any"]  # of the bow; "any": drawn for each flight
    friction: Annotated[float, Meta(ge=0, le=3)]  # between feet and deck


class Travel(Table, frozen=True):
    """[motion]: steady travel."""

    speed: Speed
    course_deg: Angle | Literal["any"]  # from the bow


class Shift(Table, frozen=True):
    """W components of an axis: along the bow, to port of it, up."""

    amplitude: list[Length]
    phase_deg: list[Angle]


class Turn(Table, frozen=True):
    """W components of an axis: about the deck's own axes."""

    amplitude: list[Angle]
    phase_deg: list[Angle]


class Components(Table, frozen=True):
    """[waves]: the axes that move."""

    period: Annotated[tuple[Annotated[float, Meta(ge=0.05, le=1000)], ...], Meta(max_length=64)] = ()  # s
    surge: Shift | None = None
    sway: Shift | None = None
    heave: Shift | None = None
    roll: Turn | None = None
    pitch: Turn | None = None
    yaw: Turn | None = None


class Start(Table, frozen=True):
    """[start]: box of the starts at rest, along the room's axes from the centre of the deck then."""

    x: tuple[Length, Length]
    y: tuple[Length, Length]
    z: tuple[Length, Length]


class Success(Table, frozen=True):
    """[success]: how slow a vehicle rests on the deck, on its feet alone, motors idle, and for how long."""

    speed: Speed  # relative to the deck
    rate: Annotated[float, Meta(ge=0, le=100)]  # rad/s
    hold: Annotated[float, Meta(ge=0.02, le=60)]  # s
    within: Annotated[float, Meta(ge=0.1, le=600)]  # s after the start, longer than `hold`


class File(Table, frozen=True):
    """What a scenario file holds."""

    version: Literal[1]  # of the format
    title: Text
    source: Text  # where the motion comes from
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)]  # of everything drawn
    flights: Annotated[int, Meta(ge=1, le=100_000)]
    deck: Deck
    motion: Travel
    start: Start
    success: Success
    components: Components = field(name="waves", default=Components())


@dataclasses.dataclass(frozen=True)
class Waves:
    """W components of a motion in all six axes; see the module's docstring."""

    period: np.ndarray  # (W,) s
    amplitude: np.ndarray  # (6, W) m and rad, of motion.MODES
    phase: np.ndarray  # (6, W) rad


class Scenario(File, frozen=True, kw_only=True):
    """A scenario file, read."""

    name: str
    fingerprint: str  # of the file

    @property
    def inclination(self) -> float:
        """Return the deck's mean slope [rad]."""
        return math.radians(self.deck.inclination_deg)

    @property
    def waves(self) -> Waves:
        """Return the platform's motion in SI units; raises UserError for lists not as long as `period`."""
        axes: dict[str, Shift | Turn | None] = {mode: getattr(self.components, mode) for mode in MODES}
        if not self.components.period and not any(axes.values()):
            return Waves(np.ones(1), np.zeros((6, 1)), np.zeros((6, 1)))
        w = len(self.components.period)
        amplitude, phase = np.zeros((6, w)), np.zeros((6, w))
        for k, (mode, wave) in enumerate(axes.items()):
            if wave is None:
                continue
            if not len(wave.amplitude) == len(wave.phase_deg) == w:
                lists = "amplitude and phase_deg must have as many numbers as period"
                raise UserError(f"[waves] {mode}: {lists}, {w}")
            amplitude[k] = (1.0 if k < 3 else math.pi / 180.0) * np.array(wave.amplitude)
            phase[k] = np.radians(wave.phase_deg)
        return Waves(np.array(self.components.period), amplitude, phase)

    def draw(self, vehicle: Vehicle, flights: int | None = None) -> DrawnFlights:
        """Draw the flights of the scenario; fewer are the first ones.

        Every flight has a generator of its own, so that how many are flown changes none.
        """
        n = self.flights if flights is None else min(self.flights, flights)
        made = self.waves
        w = len(made.period)
        place, phase = np.empty((n, 3)), np.empty((n, w))
        low, high = np.transpose([self.start.x, self.start.y, self.start.z])
        azimuth, course = (np.full(n, _radians(a)) for a in (self.deck.azimuth_deg, self.motion.course_deg))
        for k in range(n):
            draws = np.random.default_rng([self.seed, k]).random(5 + w)
            place[k] = low + draws[:3] * (high - low)
            if self.deck.azimuth_deg == "any":
                azimuth[k] = 2.0 * math.pi * draws[3] - math.pi
            if self.motion.course_deg == "any":
                course[k] = 2.0 * math.pi * draws[4] - math.pi
            phase[k] = 2.0 * math.pi * draws[5:]
        heading = azimuth + course
        velocity = self.motion.speed * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(n)])
        waves = made.amplitude * np.exp(1j * (made.phase + phase[:, None, :]))  # (n, 6, W)
        bow = np.exp(1j * azimuth)[:, None]
        surge, sway = waves[:, 0].copy(), waves[:, 1].copy()
        waves[:, 0] = bow.real * surge - bow.imag * sway
        waves[:, 1] = bow.imag * surge + bow.real * sway
        motion = Motion(
            velocity=velocity,
            amplitude=np.abs(waves),
            frequency=np.broadcast_to(2.0 * math.pi / made.period, (n, 6, w)),
            phase=np.angle(waves) + 0.5 * math.pi,  # of a sine
        )
        rest = np.zeros((n, PLATFORM_SIZE))
        rest[:, Z], rest[:, PITCH], rest[:, YAW] = vehicle.platform_surface_height, self.inclination, azimuth
        place += motion.platforms(0.0, rest)[:, : Z + 1]
        return DrawnFlights(np.full(n, self.inclination), azimuth, motion, hover_states(place, vehicle))


@dataclasses.dataclass(frozen=True)
class DrawnFlights:
    """n flights of a scenario, in the room."""

    inclination: np.ndarray  # (n,) rad, of the platforms without their waves
    azimuth: np.ndarray  # (n,) rad
    motion: Motion
    start: np.ndarray  # (n, 13)


def shipped() -> dict[str, Path]:
    """Return the paths of the frozen scenarios by name, in the order of the tables."""
    folder = Path(str(resources.files("inclined_landing.eval.study.platforms") / "scenarios"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_scenario(name: str | Path) -> Scenario:
    """Read a scenario file, or a frozen scenario by name.

    Raises UserError, one sentence naming the file and the entry, for whatever is wrong.
    """
    path = shipped().get(str(name)) or storage.as_path(name, "scenario")
    if not os.path.lexists(path):
        raise UserError(f"scenario {shown(path, 200)} does not exist; {choices(shipped(), str(name))}")
    content = storage.read_bytes(path, "scenario")
    try:
        return _parse(path.stem, storage.read_toml(path, "scenario"), hashlib.sha256(content).hexdigest())
    except UserError as error:
        said = str(error)
        raise UserError(said if said.startswith("scenario ") else f"scenario {path}: {said}") from error


def _parse(name: str, data: dict, fingerprint: str) -> Scenario:
    file = schema.parse(data, File)
    scenario = Scenario(
        **structs.asdict(file)
        | {"title": file.title.strip(), "source": file.source.strip()}
        | {"name": name, "fingerprint": fingerprint}
    )
    tilt = np.abs(scenario.waves.amplitude[3:5]).sum() + abs(scenario.inclination)
    if tilt > math.radians(_STEEPEST):
        raise UserError(
            f"slope, roll and pitch together reach {math.degrees(tilt):.0f} deg; the limit is {_STEEPEST:g}"
        )
    hold, within = file.success.hold, file.success.within
    if hold >= within:
        raise UserError(f"[success] hold is {hold:g} s, but must be shorter than within, {within:g} s")
    for axis, (low, high) in structs.asdict(file.start).items():
        if low > high:
            raise UserError(f"[start] {axis}: the lower end {low:g} is above the upper end {high:g}")
    return scenario


def _radians(angle: float | Literal["any"]) -> float:
    """Return an angle in deg in rad, NaN for "any"."""
    return math.nan if angle == "any" else math.radians(angle)
