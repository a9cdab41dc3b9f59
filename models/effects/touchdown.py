"""Effects on touchdowns: contact, which only MuJoCo simulates, and the pose of the platform."""

import math

from inclined_landing.models.effects.effect import Effect, Parameter


def _spring(vehicle, stiffness: float, damping: float):
    """Return the vehicle with stiffness and damping of its contact spring multiplied by two factors.

    They are written in the engine's direct format, (-stiffness, -damping), in which the engine does not clip
    the time constant to twice the time step.
    """
    if stiffness == 1.0 and damping == 1.0:
        return vehicle
    first, second = vehicle.contact_solref
    if first > 0:  # time constant and damping ratio
        first, second = -1.0 / (first * first * second * second), -2.0 / first
    return vehicle.changed(contact_solref=(first * stiffness, second * damping))


def spring_of(vehicle) -> tuple[float, float]:
    """Return stiffness [1/s2] and damping [1/s] of the vehicle's contact spring."""
    first, second = vehicle.contact_solref
    if first > 0:
        return 1.0 / (first * first * second * second), 2.0 / first
    return -first, -second


def _tilt(vehicle, values):
    tilt = vehicle.platform_inclination + values.get("offset", 0.0)
    # The board keeps its length, so that its horizontal extent changes.
    width = vehicle.platform_width * (math.cos(tilt) / math.cos(vehicle.platform_inclination))
    return vehicle.changed(platform_inclination=tilt, platform_width=width)


EFFECTS = (
    Effect(
        name="friction",
        description="The friction of the feet on the platform differs from the model.",
        formula="friction = scale contact_friction",
        source="Coulomb friction; plastic on wood 0.2 to 0.9",
        parameters=(
            Parameter(
                "scale",
                neutral=1.0,
                bounds=(0.05, 3.0),
                plausible=0.6,
                negligible=0.05,
                fields=("contact_friction",),
            ),
        ),
        regimes=("touchdown",),
        confused_with=("platform_tilt", "contact_damping"),
        remedy="Tilt the platform until a switched-off vehicle slides: the tangent of that angle is the "
        "friction. Put rubber on the feet or a mat on the platform.",
        channels=("touchdown",),
        says="the friction of the feet is {scale} times the modelled one",
    ),
    Effect(
        name="contact_stiffness",
        description="The stiffness of feet and surface differs from the model.",
        formula="stiffness of the contact spring times scale, damping unchanged",
        source="MuJoCo's contact model: r'' = -damping r' - stiffness r",
        parameters=(Parameter("scale", neutral=1.0, bounds=(0.1, 4.0), plausible=0.4, negligible=0.1),),
        regimes=("touchdown",),
        confused_with=("contact_damping", "platform_height"),
        remedy="Drop the switched-off vehicle from 5 cm and film the rebound; measure the contact with "
        "restitution and contact time.",
        channels=("touchdown",),
        apply=lambda vehicle, values: _spring(vehicle, values.get("scale", 1.0), 1.0),
        says="the contact stiffness is {scale} times the modelled one",
    ),
    Effect(
        name="contact_damping",
        description="The damping of the contact differs from the model; with little damping the vehicle "
        "bounces.",
        formula="damping of the contact spring times scale, stiffness unchanged",
        source="MuJoCo's contact model: r'' = -damping r' - stiffness r",
        parameters=(Parameter("scale", neutral=1.0, bounds=(0.1, 3.0), plausible=0.4, negligible=0.1),),
        regimes=("touchdown",),
        confused_with=("contact_stiffness", "friction"),
        remedy="Drop the switched-off vehicle from 5 cm and film the rebound; put foam under the feet if it "
        "bounces.",
        channels=("touchdown",),
        apply=lambda vehicle, values: _spring(vehicle, 1.0, values.get("scale", 1.0)),
        says="the contact damping is {scale} times the modelled one",
    ),
    Effect(
        name="foot_height",
        description="The feet reach lower or higher than modelled.",
        formula="reach below the centre of mass + offset",
        source="bookkeeping; rubber tips and pads add millimetres",
        parameters=(
            Parameter("offset", unit="m", bounds=(-0.008, 0.02), plausible=0.004, negligible=0.0005),
        ),
        regimes=("touchdown",),
        confused_with=("platform_height", "contact_stiffness"),
        remedy="Stand the vehicle on the floor and read the height of its motion capture origin.",
        channels=("touchdown",),
        says="the feet reach lower by {offset}",
    ),
    Effect(
        name="platform_height",
        description="The platform's surface is higher or lower than measured.",
        formula="surface height at x = 0: platform_surface_height + offset",
        source="bookkeeping; a tape measure is accurate to about 5 mm",
        parameters=(
            Parameter(
                "offset",
                unit="m",
                bounds=(-0.15, 0.15),
                plausible=0.02,
                negligible=0.001,
                fields=("platform_surface_height",),
            ),
        ),
        regimes=("touchdown", "near_surface"),
        confused_with=("platform_tilt", "contact_stiffness", "foot_height", "ground_effect"),
        remedy="Put a motion capture marker on the platform, or the vehicle itself, and read its height.",
        channels=("touchdown",),
        says="the platform's surface is off by {offset} in height",
    ),
    Effect(
        name="platform_tilt",
        description="The platform's inclination differs from the measured one.",
        formula="inclination: platform_inclination + offset",
        source="bookkeeping; a protractor is accurate to about 1 deg",
        parameters=(Parameter("offset", unit="rad", bounds=(-0.2, 0.2), plausible=0.05, negligible=0.002),),
        regimes=("touchdown", "near_surface"),
        confused_with=("friction", "platform_height"),
        remedy="Put a spirit level app or three markers on the platform and read the angle.",
        channels=("touchdown",),
        apply=_tilt,
        says="the platform's tilt is off by {offset}",
    ),
)
