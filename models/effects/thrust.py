"""Effects on the size of the collective thrust."""

from inclined_landing.models.effects.effect import Effect, FittedConstant, Parameter, added, scaled

EFFECTS = (
    Effect(
        name="thrust_scale",
        description="The rotors give a constant share of the modelled thrust: worn or wrong propellers, "
        "motors of another batch, a thrust function identified on another vehicle.",
        formula="F_t = scale (state_gain Omega + direct_gain PWM)",
        source="Kooi and Babuska 2021: their flights needed 0.88 of the modelled force",
        parameters=(
            Parameter(
                *("scale", "1", 1.0, (0.4, 1.6), 0.88, 0.005),
                constant=FittedConstant(
                    *("thrust gain", "thrust_state_gain", "1", lambda v, x: x),
                    also=("thrust_direct_gain", "effects_thrust_bias"),
                ),
            ),
        ),
        regimes=("hover", "climb", "lateral"),
        confused_with=("mass", "thrust_bias", "battery_sag", "battery_voltage", "ground_effect"),
        remedy="Weigh the vehicle, to tell it from a wrong mass. Then replace worn or bent propellers, or "
        "accept the corrected thrust function.",
        channels=("translation",),
        apply=scaled("thrust_state_gain", "thrust_direct_gain"),
        says="the rotors give {scale} times the modelled thrust",
        scales_thrust=True,
    ),
    Effect(
        name="thrust_bias",
        description="A constant force along the body's z axis is added to the thrust, whatever the command: "
        "an offset in the firmware's PWM, or a static map that does not pass through zero.",
        formula="F_t = state_gain Omega + direct_gain PWM + force",
        source="offset of the static map in Foerster 2015",
        parameters=(Parameter("force", "N", 0.0, (-0.12, 0.12), -0.02, 0.002),),
        regimes=("hover", "climb", "lateral"),
        confused_with=("thrust_scale", "mass", "battery_sag", "ground_effect"),
        remedy="Fly climbs and descents with a wide range of PWM, to tell an offset from a scale. Check the "
        "firmware's base thrust.",
        channels=("translation",),
        apply=added("effects_thrust_bias", "force"),
        says="a constant {force} is added to the thrust, whatever the command",
        scales_thrust=True,
    ),
    Effect(
        name="thrust_fade",
        description="The thrust falls linearly with the time since the start, as a battery drains and "
        "motors warm up, without regard to the load.",
        formula="F_t times (1 - rate t)",
        source="linear part of the discharge of a lithium-polymer cell; nanobench flights",
        parameters=(Parameter("rate", "1/s", 0.0, (-0.01, 0.02), 0.003, 0.0003),),
        regimes=("hover", "climb", "low_battery"),
        confused_with=("battery_voltage", "battery_sag", "thrust_scale"),
        remedy="Start with a full battery, fly shorter, or log the battery voltage and compensate the thrust "
        "command for it.",
        channels=("translation",),
        apply=added("effects_thrust_fade", "rate"),
        says="the thrust falls by {rate} of flight",
    ),
)
