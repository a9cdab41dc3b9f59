"""Effects of the vehicle's mass and where it sits."""

from inclined_landing.models.effects.effect import Effect, Parameter, added, scaled

EFFECTS = (
    Effect(
        name="mass",
        description="The vehicle is heavier or lighter than modelled: decks, markers, another battery. The "
        "inertia is left as it is.",
        formula="m = scale body_mass",
        source="bookkeeping; decks weigh 1 to 4 g, 3 to 12 % of the vehicle",
        parameters=(Parameter("scale", "1", 1.0, (0.6, 1.8), 1.08, 0.005),),
        regimes=("hover", "climb", "lateral"),
        confused_with=("thrust_scale", "thrust_bias", "battery_sag"),
        remedy="Weigh the vehicle as it flies and write the mass into the vehicle file. In free flight only "
        "thrust over mass can be seen, so that no flight tells mass from thrust.",
        channels=("translation",),
        apply=scaled("body_mass"),
        says="the vehicle has {scale} times the modelled mass",
        scales_thrust=True,
        told_by="Weigh the vehicle: in free flight only the ratio of thrust to mass shows.",
    ),
    Effect(
        name="com_offset",
        description="The centre of mass sits beside the line of the thrust, by the offset in the body frame: "
        "a battery or deck out of the middle. The moment tilts the vehicle against its attitude loop, "
        "so that flights show the offset over the loop's stiffness: its size is as right as the model's "
        "inertia, bandwidth and time constant.",
        formula="torque = (-y F_t, x F_t, 0); stiffness = inertia bandwidth/time_constant",
        source="rigid-body mechanics",
        parameters=(
            Parameter("x", "m", 0.0, (-0.015, 0.015), 0.001, 1e-4, placement=1e-3),
            Parameter("y", "m", 0.0, (-0.015, 0.015), -0.001, 1e-4, placement=1e-3),
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
        remedy="Balance the vehicle on two fingers under the motor arms and shift the battery. Climbs with "
        "changing thrust tell it from a trim, which does not grow with the thrust.",
        channels=("attitude", "requests"),
        apply=added("effects_com_offset", "x", "y"),
        says="the centre of mass sits {x} forward and {y} left of the middle of the rotors",
    ),
)
