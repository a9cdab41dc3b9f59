"""Reader of `crazyflie.toml`, the one source of every physical constant.

`load_vehicle()` gives the values as a frozen :class:`Vehicle`; `constants()` gives unit, source and
uncertainty beside each value.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import os
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from inclined_landing.models.errors import UserError

# Tables that a vehicle file may leave out, whole or in part: the shipped entries are taken.
_LATER = ("effects", "rotor")
_FIELDS = ("value", "unit", "source", "uncertainty")


@dataclasses.dataclass(frozen=True)
class Constant:
    """One entry of the vehicle file."""

    section: str
    name: str
    value: float | tuple[float, ...]
    unit: str
    source: str
    uncertainty: float | tuple[float, ...] | str

    @property
    def field(self) -> str:
        """Name of the field of `Vehicle`."""
        return f"{self.section}_{self.name}"


@dataclasses.dataclass(frozen=True)
class Vehicle:
    """The constants of one vehicle and its arena, SI units; field `a_b` is entry `b` of table `a`.

    Use :func:`dataclasses.replace` for a variant.
    """

    body_mass: float
    body_inertia: tuple[float, float, float]
    environment_gravity: float
    thrust_lag_rate: float
    thrust_state_gain: float
    thrust_direct_gain: float
    motor_count: float
    motor_pwm_to_force: tuple[float, float, float]
    motor_pwm_to_speed: tuple[float, float]
    rotor_arm: float
    rotor_height: float
    rotor_radius: float
    drag_coefficients: tuple[float, float, float]
    attitude_gain: float
    attitude_time_constant: float
    attitude_bandwidth: float
    attitude_yaw_bandwidth: float
    attitude_torque_limit: float
    attitude_yaw_torque_limit: float
    command_control_period: float
    command_pwm_range: tuple[float, float]
    command_angle_limit: float
    command_yaw_rate_limit: float
    command_pwm_centre: float
    command_pwm_span: float
    arena_x: tuple[float, float]
    arena_y: tuple[float, float]
    arena_z: tuple[float, float]
    platform_surface_height: float
    platform_width: float
    platform_depth: float
    platform_thickness: float
    platform_inclination: float
    platform_max_inclination: float
    contact_friction: float
    contact_solref: tuple[float, float]
    effects_thrust_bias: float
    effects_thrust_fade: float
    effects_battery_sag: float
    effects_battery_reference: float
    effects_voltage_sensitivity: float
    effects_voltage_reference: float
    effects_voltage_open: float
    effects_voltage_drop: float
    effects_voltage_discharge: float
    effects_spin_down: float
    effects_body_drag: float
    effects_wind: tuple[float, float]
    effects_translational_lift: float
    effects_axial_inflow: float
    effects_ground_effect: float
    effects_com_offset: tuple[float, float]
    effects_thrust_delay: float
    effects_attitude_delay: float
    effects_attitude_trim: tuple[float, float]
    effects_yaw_drift: float
    effects_mocap_tilt: tuple[float, float]
    effects_mocap_delay: float

    @property
    def thrust_per_pwm(self) -> float:
        """Steady total thrust per PWM [N/PWM] of the transfer function."""
        return self.thrust_state_gain / self.thrust_lag_rate + self.thrust_direct_gain

    @property
    def hover_pwm(self) -> float:
        """PWM at which the transfer function carries the weight (about 34 100)."""
        return self.body_mass * self.environment_gravity / self.thrust_per_pwm

    @property
    def hover_lag(self) -> float:
        """Lag state Omega in hover [PWM s]."""
        return self.hover_pwm / self.thrust_lag_rate

    @property
    def static_hover_pwm(self) -> float:
        """PWM at which the *static* map carries the weight (the paper quotes 42 000)."""
        a, b, c = self.motor_pwm_to_force
        force = self.body_mass * self.environment_gravity / self.motor_count
        return (-b + math.sqrt(b * b - 4 * a * (c - force))) / (2 * a)

    @property
    def slab_half_length(self) -> float:
        """Half the slab's length along the slope [m]: `width` is horizontal at the default angle."""
        return 0.5 * self.platform_width / math.cos(self.platform_inclination)

    def check_inclination(self, inclination: float) -> float:
        """Return `inclination` [rad] if the platform supports it, else raise UserError."""
        limit = self.platform_max_inclination
        if not (math.isfinite(inclination) and abs(inclination) <= limit + 1e-12):
            raise UserError(
                f"platform inclination {math.degrees(inclination):g} deg is outside the supported "
                f"range of -{math.degrees(limit):.0f} to {math.degrees(limit):.0f} deg"
            )
        return float(inclination)


def constants(path: str | Path | None = None) -> list[Constant]:
    """Every entry of the vehicle file (default: the shipped `crazyflie.toml`), in the order of that one.

    Where another file lacks the tables `effects` and `rotor`, or entries of them, the shipped entries
    stand in, so that files older than these tables stay what they were.
    Raises UserError, naming file and entry, when the file is unreadable or an entry is incomplete.
    """
    name = str(path) if path is not None else "crazyflie.toml"
    try:
        if path is None:
            text = resources.files("inclined_landing.models").joinpath(name).read_text("utf-8")
        else:
            text = Path(path).read_text("utf-8")
        tables = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"vehicle file {name} cannot be read: {error}") from error
    entries = []
    for section, table in tables.items():
        if not isinstance(table, dict):
            raise UserError(f"vehicle file {name}: entry {section} stands outside any table")
        for key, entry in table.items():
            if not isinstance(entry, dict) or set(entry) != set(_FIELDS):
                raise UserError(
                    f"vehicle file {name}: entry {section}.{key} must have exactly the fields "
                    + ", ".join(_FIELDS)
                )
            given = entry["value"]
            values = given if isinstance(given, list) else [given]
            if not all(type(x) in (int, float) and math.isfinite(x) for x in values):
                raise UserError(f"vehicle file {name}: {section}.{key} is not a finite number")
            value = tuple(map(float, given)) if isinstance(given, list) else float(given)
            entries.append(
                Constant(section, key, value, entry["unit"], entry["source"], entry["uncertainty"])
            )
    if path is None:
        return entries
    shipped = constants()
    given = {c.field for c in entries}
    entries += [c for c in shipped if c.section in _LATER and c.field not in given]
    order = {c.field: k for k, c in enumerate(shipped)}
    return sorted(entries, key=lambda c: order.get(c.field, len(order)))


@functools.lru_cache(maxsize=8)
def load_vehicle(path: str | Path | None = None) -> Vehicle:
    """Read a vehicle file (default: the shipped Crazyflie 2.1).

    Raises UserError when an entry is missing, unknown, or has the wrong number of values.
    """
    name = str(path) if path is not None else "crazyflie.toml"
    values = {c.field: c.value for c in constants(path)}
    fields = {f.name for f in dataclasses.fields(Vehicle)}
    for problem, names in (("lacks", fields - set(values)), ("has unknown", set(values) - fields)):
        if names:
            raise UserError(f"vehicle file {name} {problem} entries: {', '.join(sorted(names))}")
    if path is not None:
        shipped = dataclasses.asdict(load_vehicle())
        for field, value in values.items():
            if _shape(value) != _shape(shipped[field]):
                raise UserError(
                    f"vehicle file {name}: {field} needs {_shape(shipped[field])}, it has {_shape(value)}"
                )
    vehicle = Vehicle(**values)
    try:
        check_vehicle(vehicle)
    except UserError as error:
        raise UserError(f"vehicle file {name}: {error}") from None
    return vehicle


def check_vehicle(vehicle: Vehicle) -> None:
    """Raise UserError, naming the field, if a value makes no physical sense."""
    for field in ("body_mass", "thrust_lag_rate", "attitude_time_constant", "attitude_bandwidth"):
        if not getattr(vehicle, field) > 0:
            raise UserError(f"{field} must be positive")
    for field in ("thrust_delay", "attitude_delay", "mocap_delay", "body_drag"):
        if not getattr(vehicle, f"effects_{field}") >= 0:
            raise UserError(f"effects_{field} must not be negative")
    if not vehicle.effects_spin_down > -1:
        raise UserError("effects_spin_down must be greater than -1")
    if vehicle.effects_battery_reference == 0:
        raise UserError("effects_battery_reference must not be 0")


def write_vehicle(
    path: str | Path,
    vehicle: Vehicle,
    sources: Mapping[str, str] | None = None,
    uncertainties: Mapping[str, float | tuple[float, ...]] | None = None,
    *,
    base: str | Path | None = None,
    heading: str = "",
) -> None:
    """Write `vehicle` as a file that `load_vehicle` reads back exactly, whole or not at all.

    sources, uncertainties: of the fields (`body_mass`) that differ from the vehicle file `base`
    (default: the shipped one); entries that do not differ keep theirs. heading: a comment on top.
    Raises UserError when the file cannot be written.
    """
    sources, uncertainties = sources or {}, uncertainties or {}
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    section = None
    for c in constants(base):
        if c.section != section:
            section = c.section
            lines += ["", f"[{section}]"]
        value, source, uncertainty = getattr(vehicle, c.field), c.source, c.uncertainty
        if value != c.value:
            source = sources.get(c.field, f"changed from {_toml(c.value)}")
            uncertainty = uncertainties.get(c.field, "not known")
        lines.append(
            f"{c.name} = {{ value = {_toml(value)}, unit = {_toml(c.unit)}, source = {_toml(source)}, "
            f"uncertainty = {_toml(uncertainty)} }}"
        )
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text("\n".join(lines).lstrip("\n") + "\n", "utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise UserError(f"cannot write {path}: {(error.strerror or str(error)).lower()}") from error
    load_vehicle.cache_clear()  # the same name may have been read before


def _toml(value) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(repr(float(x)) for x in value) + "]"
    return repr(float(value))


def _shape(value) -> str:
    return f"a list of {len(value)}" if isinstance(value, tuple) else "one number"
