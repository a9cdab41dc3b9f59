"""Effects on the size of the collective thrust."""

from inclined_landing.models.effects.battery import with_sag
from inclined_landing.models.effects.effect import Effect, Parameter
from inclined_landing.models.parameters import load_vehicle

EFFECTS = (
    Effect(
        name="thrust_scale",
        description="The rotors give a constant share of the modelled thrust: worn or wrong propellers, "
        "motors of another batch, a thrust function identified on another vehicle.",
        formula="F_t = scale (state_gain Omega + direct_gain PWM)",
        source="Kooi and Babuska 2021: their flights needed 0.88 of the modelled force",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.2, 2.0),
                plausible=0.88,
                negligible=0.005,
                fields=("thrust_state_gain", "thrust_direct_gain"),
                reported="thrust gain",
                share=True,
            ),
        ),
        regimes=("hover", "climb", "lateral"),
        confused_with=("mass", "thrust_bias", "battery_sag", "battery_voltage", "ground_effect"),
        remedy="Weigh the vehicle to distinguish it from a wrong mass. Then replace worn or bent propellers, "
        "or "
        "accept the corrected thrust function.",
        channels=("translation",),
        changes_hover=True,
        says="the rotors give {scale} times the modelled thrust",
        scales_thrust=True,
    ),
    Effect(
        name="thrust_bias",
        description="A constant force along the body's z axis is added to the thrust, independent of the "
        "command: an offset in the firmware's PWM, or a static map that does not pass through zero.",
        formula="F_t = state_gain Omega + direct_gain PWM + force",
        source="offset of the static map in Foerster 2015",
        parameters=(Parameter("force", unit="N", bounds=(-0.25, 0.25), plausible=-0.02, negligible=0.003),),
        regimes=("hover", "climb", "lateral"),
        confused_with=("thrust_scale", "mass", "battery_sag", "ground_effect"),
        remedy="Fly climbs and descents with a wide range of PWM to distinguish an offset from a scale. "
        "Check the "
        "firmware's base thrust.",
        channels=("translation",),
        of_the_drive=True,
        changes_hover=True,
        says="a constant {force} is added to the thrust",
        scales_thrust=True,
    ),
    Effect(
        name="thrust_curve",
        description="The thrust grows faster than its command, because it depends on the square of the "
        "rotor speed and the modelled line is correct at one load only. In the equations it is a battery "
        "sag of the other sign: an upward curve is this effect, a downward one a sag.",
        formula="F_t times (1 + curvature (load/reference - 1)),  load = lag_rate Omega",
        source="static map of Foerster 2015: a curvature of 0.42 about its hover PWM",
        parameters=(
            Parameter("curvature", bounds=(-0.03, 0.9), plausible=0.3, negligible=0.01, one_signed=True),
            Parameter(
                "reference",
                unit="PWM",
                neutral=load_vehicle().effects_battery_reference,
                bounds=(5000.0, 65000.0),
                plausible=34100.0,
                negligible=1000.0,
                is_reference=True,
            ),
        ),
        regimes=("climb",),
        confused_with=("battery_sag", "thrust_bias", "thrust_scale", "axial_inflow"),
        remedy="Identify the thrust with the static map, or hover with and without a load of known mass: two "
        "loads give two points of the curve.",
        channels=("translation",),
        apply=lambda vehicle, values: with_sag(
            vehicle, -values.get("curvature", 0.0), values.get("reference")
        ),
        of_the_drive=True,
        changes_hover=True,
        says="the thrust grows faster than its command (curvature {curvature}, modelled thrust at a load of "
        "{reference})",
    ),
    Effect(
        name="thrust_fade",
        description="The thrust falls linearly with the time since the start, as a battery drains and "
        "motors warm up, independent of the load.",
        formula="F_t times (1 - rate t)",
        source="linear part of the discharge of a lithium-polymer cell; nanobench flights",
        parameters=(Parameter("rate", unit="1/s", bounds=(-0.01, 0.02), plausible=0.003, negligible=0.0003),),
        regimes=("hover", "climb", "low_battery"),
        confused_with=("battery_voltage", "battery_sag", "thrust_scale"),
        remedy="Start with a full battery, fly shorter, or log the battery voltage and compensate the thrust "
        "command for it.",
        channels=("translation",),
        of_the_drive=True,
        says="the thrust falls by {rate} of flight",
    ),
)
