"""`landing-eval touchdown`: a touchdown policy, and cutting a landing policy's motors (`motor_cut`)."""

from __future__ import annotations

from typing import Annotated

import tyro

from inclined_landing.eval.base.options import Flag, NewFolder, PolicyFile, PolicyName, VehicleFile
from inclined_landing.eval.study.options import FRICTIONS, NOMINAL, RESTITUTIONS
from inclined_landing.models.base.errors import UserError


def command(
    policy: PolicyFile,
    /,
    *,
    baseline: PolicyName = NOMINAL,
    vehicle: VehicleFile = None,
    friction: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MU [MU ...]")] = FRICTIONS,
    restitution: Annotated[tuple[float, ...], tyro.conf.arg(metavar="E [E ...]")] = RESTITUTIONS,
    effect: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")] = (),
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare a touchdown policy with a landing policy whose motors are cut (minutes).

    Args:
        policy: touchdown policy file, or name of a shipped one (touchdown).
        baseline: landing policy file, or name of a shipped one; landing-nominal is the paper's.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        friction: friction coefficients between feet and slope.
        restitution: coefficients of restitution of the feet on the slope, 0 to 0.6.
        effect: effects of the library, at a plausible size, that the policies were not trained with (default:
            none).
        json: print only JSON on standard output.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
    """
    if not (friction and restitution):
        raise UserError("give at least one --friction and one --restitution")
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.eval.study import changes, motor_cut
    from inclined_landing.eval.study.engine import run
    from inclined_landing.eval.study.show import hand_over
    from inclined_landing.models import contact
    from inclined_landing.models.parameters import load_vehicle

    contact.check_friction(friction)
    contact.check_restitution(restitution)
    changes.check_effects(effect)
    flown = load_vehicle(vehicle) if vehicle is not None else None
    found = motor_cut.study(
        load_policy(policy, "touchdown", vehicle=flown),
        load_policy(baseline, "landing", vehicle=flown),
        frictions=friction,
        restitutions=restitution,
        effects=tuple(dict.fromkeys(effect)),
    )
    hand_over("touchdown", run([found]), json=json, out=out)
