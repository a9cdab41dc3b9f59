"""Effects of a platform that does not stand where the vehicle file puts it."""

import math

from inclined_landing.models.effects.effect import Effect, Parameter, added


def _tilt(vehicle, values):
    tilt = vehicle.platform_inclination + values.get("offset", 0.0)
    # The board keeps its length, so that its horizontal extent changes.
    width = vehicle.platform_width * (math.cos(tilt) / math.cos(vehicle.platform_inclination))
    return vehicle.changed(platform_inclination=tilt, platform_width=width)


EFFECTS = (
    Effect(
        name="platform_height",
        description="The platform's surface is higher or lower than measured.",
        formula="surface height at x = 0: platform_surface_height + offset",
        source="bookkeeping; a tape measure is good for about 5 mm",
        parameters=(Parameter("offset", unit="m", bounds=(-0.15, 0.15), plausible=0.02, negligible=0.001),),
        regimes=("touchdown", "near_surface"),
        confused_with=("platform_tilt", "contact_stiffness", "ground_effect"),
        remedy="Put a motion capture marker on the platform, or the vehicle itself, and read its height.",
        channels=("touchdown",),
        apply=added("platform_surface_height", "offset"),
        says="the platform's surface is off by {offset} in height",
    ),
    Effect(
        name="platform_tilt",
        description="The platform is tilted by another angle than measured.",
        formula="inclination: platform_inclination + offset",
        source="bookkeeping; a protractor is good for about 1 deg",
        parameters=(Parameter("offset", unit="rad", bounds=(-0.2, 0.2), plausible=0.05, negligible=0.002),),
        regimes=("touchdown", "near_surface"),
        confused_with=("friction", "platform_height"),
        remedy="Put a spirit level app or three markers on the platform and read the angle.",
        channels=("touchdown",),
        apply=_tilt,
        says="the platform's tilt is off by {offset}",
    ),
)
