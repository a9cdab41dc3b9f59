"""`landing-eval contact`: contact in the engine against the laws of mechanics."""

from __future__ import annotations

from functools import partial

from inclined_landing.eval.base.options import RunFolder, VehicleFile


def command(*, out: RunFolder, vehicle: VehicleFile = None) -> int:
    """Check contact against mechanics: rest, slip, drops, energy ...; writes a page of claims.

    Takes about 10 s on two cores. The exit code is 1 if a claim does not hold.

    Args:
        out: new folder for contact.html, contact.json and the figures.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
    """
    from inclined_landing.eval.truth.contact import laws
    from inclined_landing.eval.truth.report import check
    from inclined_landing.models.parameters import load_vehicle

    tested = load_vehicle(vehicle)
    spring = tested.contact_solref
    setting = f"friction {tested.contact_friction:g}, solref {spring[0]:g} s, {spring[1]:g}"
    return check(
        out,
        "contact",
        {name: partial(law, tested) for name, law in laws.LAWS.items()},
        title="Contact compared with mechanics",
        lead=f"The vehicle of this package in MuJoCo, contact setting {setting}, RK4 at 4 ms unless a line "
        "says otherwise.",
    )
