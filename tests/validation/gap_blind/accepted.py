"""What counts as the right name of a cause, and what physically comes with it: fixed on development
families."""

from __future__ import annotations

# In free flight only thrust over mass is visible: these are one name in the end.
LEVEL = ("thrust_scale", "thrust_bias", "mass")

# The library's name of a cause that is named otherwise here.
EFFECT = {
    "lateral_drag": "rotor_drag",
    "log_delay": "mocap_delay",
    "restitution": "contact_damping",
    "soft_feet": "contact_stiffness",
}

_DELAYS = frozenset({"thrust_delay", "attitude_delay"})
# A cause is also named rightly by any of these sets of effects, for the reason given.
ALIASES: tuple[tuple[str, tuple[frozenset[str], ...], str], ...] = (
    *((name, tuple(frozenset({other}) for other in LEVEL), "only thrust over mass shows") for name in LEVEL),
    (
        "slung_load",
        tuple(frozenset({other}) for other in LEVEL),
        "a load that hardly swings against the vehicle is mass",
    ),
    ("battery_voltage", (frozenset({"battery_sag"}),), "the voltage falls with the load"),
    ("battery_sag", (frozenset({"battery_voltage"}),), "where a voltage is logged, the load shows in it"),
    ("mocap_delay", (_DELAYS,), "poses late against commands are commands early against poses"),
    ("log_delay", (_DELAYS,), "poses late against commands are commands early against poses"),
)

_LOOP = ("second_order_attitude", "attitude_time_constant", "attitude_delay", "attitude_gain")
# With the causes come these effects, and naming them too is right, for the reason given.
ENTAILED: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (
        ("thrust_scale", "thrust_fade", "battery_sag", "battery_voltage"),
        _LOOP,
        "the torques come from the same motors: weaker thrust is a softer attitude loop, stronger a stiffer",
    ),
    (("motor_lag", "spin_down"), (*_LOOP, "yaw_loop"), "the attitude loops work through the same motors"),
    (
        ("spin_down",),
        LEVEL,
        "motors that slow down later than they speed up rectify the controller's corrections into thrust",
    ),
    (("battery_sag", "battery_voltage"), ("thrust_fade",), "the battery empties during the flight"),
    (
        ("mocap_delay",),
        ("attitude_gain", "attitude_time_constant"),
        "the flight controller leans on the late poses too: its estimate trails, and it tilts further",
    ),
    (("com_offset",), ("attitude_trim",), "the torque of the offset is met by a standing tilt"),
    (
        ("command_jitter",),
        ("thrust_delay", "attitude_delay", "motor_lag", "second_order_attitude"),
        "its mean is a delay, its spread a lag",
    ),
)

# Causes whose number is no number of the library's: it depends on a gain of the flight controller, or on a
# constant that the library has in another place.
NOT_COMPARED = {
    "com_offset": "the tilt that an offset makes is the one over the controller's stiffness",
    "attitude_time_constant": "a loop of higher order has no single time constant",
    "second_order_attitude": "the lag added to a rate loop is not that of the loop over it",
    "spin_down": "some motors slow down later without the cause too",
}


def accepted(cause: str) -> tuple[frozenset[str], ...]:
    """Return the sets of effect names that name `cause`, its own first."""
    return (
        frozenset({EFFECT.get(cause, cause)}),
        *(names for one, sets, _ in ALIASES if one == cause for names in sets),
    )


def entailed(cause: str) -> frozenset[str]:
    """Return the effects that physically come with `cause`."""
    return frozenset(name for ones, names, _ in ENTAILED if cause in ones for name in names)
