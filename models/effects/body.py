"""Effects of the vehicle's mass and where it sits."""

import math

from inclined_landing.models.effects.effect import Effect, Parameter


def _slung_load(vehicle, values):
    mass = values.get("mass", 0.0)
    if mass == 0.0:
        return vehicle
    present, length = vehicle.effects_load_mass, vehicle.effects_load_length
    if mass > 0.0:  # combined string length: mass-weighted mean
        length = (present * length + mass * values.get("length", length)) / (present + mass)
    return vehicle.changed(effects_load_mass=max(0.0, present + mass), effects_load_length=length)


def _com_offset(vehicle, values):
    offset = values.get("x", 0.0), values.get("y", 0.0)
    if offset == (0.0, 0.0):
        return vehicle
    present, hold = vehicle.effects_com_offset, vehicle.effects_attitude_hold
    moved = tuple(old + new for old, new in zip(present, offset))
    # Combined rate at which the moments are compensated: mean, weighted by the sizes of the offsets.
    share = math.hypot(*offset) / (math.hypot(*offset) + math.hypot(*present))
    hold += share * (values.get("hold", hold) - hold)
    return vehicle.changed(effects_com_offset=moved, effects_attitude_hold=hold)


EFFECTS = (
    Effect(
        name="mass",
        description="The vehicle is heavier or lighter than modelled: decks, markers, another battery. The "
        "inertia is unchanged.",
        formula="m = scale body_mass",
        source="bookkeeping; decks weigh 1 to 4 g, 3 to 12 % of the vehicle",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.6, 1.8),
                plausible=1.08,
                negligible=0.005,
                fields=("body_mass",),
            ),
        ),
        regimes=("hover", "climb", "lateral"),
        confused_with=("thrust_scale", "thrust_bias", "battery_sag", "slung_load"),
        remedy="Weigh the vehicle with everything it carries, and write the mass into the vehicle file. "
        "Free flight shows only thrust over mass, so no flight can distinguish mass from thrust.",
        channels=("translation",),
        changes_hover=True,
        says="the vehicle has {scale} times the modelled mass",
        scales_thrust=True,
        told_by="Weigh the vehicle: in free flight only the ratio of thrust to mass shows.",
    ),
    Effect(
        name="slung_load",
        description="A load hangs on a string from the vehicle's centre of mass and swings. The string stays "
        "taut, and the air does not touch it. If flights do not make the load swing, it acts as mass, and "
        "the length of the string has no effect.",
        formula="T = m m_l/(m + m_l) (L |q'|^2 - q . f/m) on the vehicle along q, "
        "q'' = (q (q . f) - f)/(m L) - |q'|^2 q; q: direction from vehicle to load, f: force on the vehicle "
        "without its weight",
        source="Sreenath, Lee and Kumar 2013; crazyflie-data-collection, data 2024: 4.7 g on 0.52 m",
        parameters=(
            Parameter(
                "mass",
                unit="kg",
                bounds=(0.0, 0.03),
                plausible=0.004,
                negligible=0.0003,
                one_signed=True,
                fields=("effects_load_mass",),
            ),
            Parameter(
                "length",
                unit="m",
                neutral=0.5,
                bounds=(0.05, 1.5),
                plausible=0.3,
                negligible=0.05,
                is_reference=True,
                linear=False,
            ),
        ),
        regimes=("hover", "climb", "lateral"),
        confused_with=("mass", "thrust_scale", "thrust_bias", "battery_sag"),
        remedy="Remove the load, or write its mass and the string's length into the vehicle file. Quick "
        "turns, after which it swings at about sqrt(g/L), distinguish it from a mass.",
        channels=("translation",),
        apply=_slung_load,
        changes_hover=True,
        says="a load of {mass} swings on a string of {length}",
        told_by="Weigh the load and measure its string.",
    ),
    Effect(
        name="com_offset",
        description="The centre of mass is off the line of the thrust by an offset in the body frame: a "
        "battery or deck out of the middle. The moment tilts the vehicle against its attitude loop, until "
        "the rate loop's integral holds it. Without the requests of the motors, flights show the offset over "
        "the loop's stiffness: its size is as accurate as the model's inertia, bandwidth and time constant.",
        formula="torque = (-y F_t, x F_t, 0); stiffness = inertia bandwidth/time_constant; the loops take it "
        "over by the factor s/(s + hold)",
        source="rigid-body mechanics",
        parameters=(
            Parameter(
                "x", unit="m", bounds=(-0.015, 0.015), plausible=0.001, negligible=1e-4, along_the_arm=True
            ),
            Parameter(
                "y", unit="m", bounds=(-0.015, 0.015), plausible=-0.001, negligible=1e-4, along_the_arm=True
            ),
            # The rate at which the loops take the moment over is kp ki'/(kp kp' + ki') in the firmware, with
            # its gains 6 of the angle and 250, 500 of the rate; in loops without integrals it is nearly 0.
            Parameter(
                "hold",
                unit="rad/(rad s)",
                neutral=1.5,
                bounds=(0.001, 8.0),
                plausible=0.05,
                negligible=0.2,
                is_reference=True,
                linear=False,
                fields=("effects_attitude_hold",),
            ),
        ),
        regimes=("climb", "hover", "attitude_step"),
        confused_with=(
            "attitude_trim",
            "wind",
            "weak_rotor_1",
            "weak_rotor_2",
            "weak_rotor_3",
            "weak_rotor_4",
        ),
        remedy="Balance the vehicle on two fingers under the motor arms and shift the battery. Where "
        "the commands of the four motors are not logged, its direction is right and its size relative. "
        "Climbs with changing thrust distinguish it from a trim, which does not grow with the thrust.",
        channels=("attitude", "requests"),
        apply=_com_offset,
        says="the centre of mass is {x} forward and {y} left of the middle of the rotors, and the attitude "
        "loops take its moment over at {hold}",
    ),
)
