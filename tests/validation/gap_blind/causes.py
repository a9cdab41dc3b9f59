"""The hidden causes: what each does to the simulator's world, and what the label says about it.

A cause has three sizes. The number drawn lies within 15 % of the size, with a random sign or direction where
both make sense. What it does to thrust, drag or the ground's cushion has the form of the reality it is hidden
in.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from tests.validation.simulator import Reality, World, reference
from tests.validation.simulator.vehicle import CHEESEMAN

SIZES = ("weak", "medium", "strong")
_TICK = 0.002  # s, delays are whole control periods


@dataclasses.dataclass(frozen=True)
class Drawn:
    """One cause with its numbers.

    world: fields of the simulator's World that differ; parameters: the same in the library's names and
    units, for the label; voltage: the log needs a battery channel; spread: fields that differ by flight,
    each uniform within (lo, hi).
    """

    world: dict[str, float]
    parameters: dict[str, float]
    voltage: bool = False
    spread: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)

    def world_of(self, rng: np.random.Generator) -> World:
        """Return the world of one flight."""
        return World(**self.world | {field: rng.uniform(*ends) for field, ends in self.spread.items()})


Draw = Callable[[float, np.random.Generator, Reality], Drawn]


def _sign(rng) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0


def _scale(field: str, both: bool = True, parameters: tuple[str, ...] = ("scale",)) -> Draw:
    """Return how a factor is drawn: size 0.1 is 1.1, or 1/1.1 where both make sense."""

    def draw(size, rng, reality):
        up = not both or rng.uniform() < 0.5
        value = 1 + size if up else 1 / (1 + size)
        return Drawn({field: value}, dict.fromkeys(parameters, value))

    return draw


def _less(field: str) -> Draw:
    """Return how a factor below 1 is drawn; below 0.65 of the nominal friction landings slide off."""

    def draw(size, rng, reality):
        return Drawn({field: (1 - size) * World._field_defaults[field]}, {"scale": 1 - size})

    return draw


def _divided(field: str) -> Draw:
    return lambda size, rng, reality: Drawn({field: 1 / (1 + size)}, {"scale": 1 / (1 + size)})


def _plain(field: str, parameter: str, signed: bool = False, force: bool = False) -> Draw:
    """Return how a number that is added to the nominal one is drawn.

    force: it is labelled as for the paper's mass, since flights show forces over mass alone.
    """

    def draw(size, rng, reality):
        value = size * (_sign(rng) if signed else 1.0)
        per_mass = reference().constants.mass / reality.constants.mass if force else 1.0
        return Drawn({field: value}, {parameter: value * per_mass})

    return draw


def _delay(*fields: str) -> Draw:
    def draw(size, rng, reality):
        value = max(1, round(size / _TICK)) * _TICK
        return Drawn(dict.fromkeys(fields, value), {"delay": value})

    return draw


def _vector(first: str, second: str, names: tuple[str, str]) -> Draw:
    def draw(size, rng, reality):
        a = rng.uniform(-math.pi, math.pi)
        x, y = size * math.cos(a), size * math.sin(a)
        return Drawn({first: x, second: y}, {names[0]: x, names[1]: y})

    return draw


def _battery(channel: bool) -> Draw:
    """Return how a battery is drawn, by the volts that it loses at hover load.

    Without a channel every flight starts on the same charge.
    """

    def draw(size, rng, reality):
        c, power = reality.constants, reality.build.battery_power
        start = rng.uniform(-0.1, 0.15)
        full = c.battery_voltage + start
        # The supply at which PWM gives its nominal thrust: that of a load of 0.7 to 1.2 times hover.
        supply = full - size * rng.uniform(0.7, 1.2)
        world = {
            "battery_resistance": size / c.hover_current,
            "battery_reference": supply,
            "battery_voltage": start,
        }
        # Thrust is PWM times a power of the voltage, and the voltage falls with thrust. In hover:
        hover = full - size
        if channel:
            spread = {"battery_voltage": (start - 0.15, start + 0.15)}
            return Drawn(world, {"slope": power / hover, "voltage": hover}, True, spread)
        pwm = c.mass * c.gravity / c.thrust_per_pwm * (supply / hover) ** power
        lost = power * size / hover  # share of thrust per share of thrust
        return Drawn(world, {"slope": lost / (1.0 + lost) / pwm, "pwm": pwm})

    return draw


def _ground(size, rng, reality):
    """Return a ground effect, labelled by the thrust that it adds four radii above the ground.

    All forms agree there to first order.
    """
    added = size / 256.0
    if reality.build.ground == CHEESEMAN:
        added /= 1.0 - added
    return Drawn({"ground_effect": size}, {"gain": added})


def _updraft(size, rng, reality):
    world = {"updraft": size * _sign(rng), "updraft_radius": rng.uniform(0.3, 0.5)}
    world |= {"updraft_x": rng.uniform(-0.5, 0.5), "updraft_y": rng.uniform(-0.5, 0.5)}
    return Drawn(world, {})


def _swing(size, rng, reality):
    turn = rng.uniform(-math.pi, math.pi)
    return Drawn({"swing": size, "swing_period": rng.uniform(2.0, 5.0), "swing_direction": turn}, {})


def _outside(field: str, signed: bool = False, **also) -> Draw:
    return lambda size, rng, reality: Drawn({field: size * (_sign(rng) if signed else 1.0), **also}, {})


# name: (weak, medium, strong), how it is drawn. Names are those of the library of effects.
FREE_FLIGHT: dict[str, tuple[tuple[float, float, float], Draw]] = {
    "thrust_scale": ((0.02, 0.06, 0.14), _scale("thrust_scale")),
    "thrust_bias": ((0.008, 0.02, 0.045), _plain("thrust_bias", "force", signed=True, force=True)),
    "thrust_fade": ((0.0015, 0.003, 0.007), _plain("thrust_fade", "rate")),
    "battery_sag": ((0.10, 0.22, 0.42), _battery(False)),
    "battery_voltage": ((0.10, 0.22, 0.42), _battery(True)),
    "motor_lag": ((0.4, 0.7, 1.2), _scale("motor_time_scale")),
    "spin_down": ((0.6, 1.0, 1.8), _plain("spin_down", "excess")),
    "mass": ((0.025, 0.06, 0.14), _scale("mass_scale", both=False)),
    "slung_load": ((0.0015, 0.003, 0.005), _plain("load_mass", "mass", force=True)),
    "rotor_drag": ((0.4, 0.8, 1.6), _scale("drag_scale", parameters=("lateral", "axial"))),
    "lateral_drag": ((0.4, 0.8, 1.6), _scale("lateral_drag", parameters=("lateral",))),
    "body_drag": ((0.004, 0.008, 0.016), _plain("body_drag", "coefficient", force=True)),
    "wind": ((0.15, 0.4, 0.9), _vector("wind_x", "wind_y", ("x", "y"))),
    "translational_lift": ((0.015, 0.035, 0.08), _plain("translational_lift", "coefficient")),
    "axial_inflow": ((0.02, 0.045, 0.10), _plain("axial_inflow", "coefficient")),
    "ground_effect": ((2.5, 5.0, 9.0), _ground),
    "com_offset": ((1.5e-4, 6e-4, 2.5e-3), _vector("com_x", "com_y", ("x", "y"))),
    "thrust_delay": ((0.008, 0.014, 0.03), _delay("thrust_delay")),
    "attitude_delay": ((0.008, 0.014, 0.03), _delay("attitude_delay")),
    "mocap_delay": ((0.008, 0.014, 0.03), _delay("mocap_delay")),
    "log_delay": ((0.008, 0.014, 0.03), _delay("log_delay")),
    "attitude_gain": ((0.05, 0.12, 0.25), _scale("attitude_gain_scale")),
    "attitude_time_constant": ((0.15, 0.35, 0.7), _scale("attitude_time_scale")),
    "second_order_attitude": ((0.015, 0.03, 0.06), _plain("rate_lag", "rate_lag")),
    "attitude_trim": ((0.006, 0.015, 0.04), _vector("trim_roll", "trim_pitch", ("roll", "pitch"))),
    "mocap_tilt": ((0.008, 0.02, 0.045), _vector("mocap_roll", "mocap_pitch", ("roll", "pitch"))),
    "level_calibration": ((0.008, 0.02, 0.045), _vector("level_roll", "level_pitch", ("roll", "pitch"))),
    "yaw_drift": ((0.03, 0.08, 0.25), _plain("yaw_drift", "rate", signed=True)),
}

# Outside the library of effects, and the same in every flight: the diagnosis should say that something
# repeats that it does not know.
UNKNOWN: dict[str, tuple[tuple[float, float, float], Draw]] = {
    "updraft": ((0.5, 0.9, 1.4), _updraft),
    "dead_zone": ((0.03, 0.05, 0.08), _outside("dead_zone")),
    "cross_coupling": ((0.12, 0.2, 0.35), _outside("cross_coupling", signed=True)),
    "yaw_loss": ((0.02, 0.04, 0.08), _outside("yaw_loss")),
    "wall": ((0.4, 0.8, 1.5), _outside("wall")),
    "capture_scale": ((0.03, 0.06, 0.12), _outside("capture_scale", signed=True)),
    "swing": ((0.1, 0.2, 0.4), _swing),
    "heading_force": ((0.1, 0.2, 0.4), _outside("heading_force", signed=True)),
    "quantum": ((0.03, 0.05, 0.08), _outside("quantum")),
}

# What no two flights have alike: a disturbance, not something unknown.
DISTURBANCE: dict[str, tuple[tuple[float, float, float], Draw]] = {
    "gust": ((0.4, 0.7, 1.1), _outside("gust")),
    "slow_gust": ((0.3, 0.5, 0.8), _outside("gust", gust_time=4.0)),
    "burst": ((0.6, 1.0, 1.6), _outside("gust", gust_time=0.4, gust_calm=0.75)),
    "command_jitter": ((0.01, 0.02, 0.04), _outside("command_jitter")),
}

# Seen only when the feet touch.
TOUCHDOWN: dict[str, tuple[tuple[float, float, float], Draw]] = {
    "friction": ((0.10, 0.18, 0.27), _less("friction")),
    "contact_stiffness": ((0.6, 1.3, 2.5), _scale("stiffness_scale")),
    "contact_damping": ((0.5, 0.9, 1.6), _scale("damping_scale")),
    "platform_height": ((0.006, 0.012, 0.03), _plain("surface_height", "offset", signed=True)),
    "platform_tilt": ((0.02, 0.05, 0.1), _plain("surface_tilt", "offset", signed=True)),
}

# Those of landings after an identification: see tests/validation/landings.py.
LANDINGS: dict[str, tuple[tuple[float, float, float], Draw]] = {
    "friction": TOUCHDOWN["friction"],
    "restitution": ((0.5, 0.8, 1.2), _divided("damping_scale")),
    "platform_tilt": TOUCHDOWN["platform_tilt"],
    "soft_feet": ((0.6, 1.3, 2.5), _divided("stiffness_scale")),
    "foot_height": ((0.002, 0.004, 0.008), _plain("foot_height", "offset", signed=True)),
}


ALL = FREE_FLIGHT | UNKNOWN | DISTURBANCE | TOUCHDOWN | LANDINGS


def draw(name: str, size: str, rng: np.random.Generator, reality: Reality | None = None) -> Drawn:
    """Draw the numbers of cause `name` at `size` (weak, medium, strong) in a reality (None: the
    reference)."""
    sizes, how = ALL[name]
    reality = reference() if reality is None else reality
    return how(sizes[SIZES.index(size)] * rng.uniform(0.85, 1.15), rng, reality)


def combined(*drawn: Drawn) -> Drawn:
    """Return all of `drawn` in one world, where factors multiply, without their parameters."""
    world: dict[str, float] = {}
    for one in drawn:
        for field, value in one.world.items():
            if World._field_defaults[field] == 1.0:
                value *= world.get(field, 1.0)
            world[field] = value
    spread = {field: ends for one in drawn for field, ends in one.spread.items()}
    return Drawn(world, {}, any(one.voltage for one in drawn), spread)
