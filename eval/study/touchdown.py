"""`landing-eval touchdown`: a touchdown policy, and cutting a landing policy's motors (`motor_cut`)."""

from __future__ import annotations

from typing import Annotated

import tyro

from inclined_landing.eval.base.options import Flag, NewFolder, PolicyFile, VehicleFile
from inclined_landing.eval.study.options import NOMINAL


def command(
    policy: PolicyFile,
    /,
    *,
    vehicle: VehicleFile = None,
    effect: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")] = (),
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare a touchdown policy with a landing policy whose motors are cut (minutes).

    The landing policy is landing-nominal, the paper's, on the slope of the touchdown policy.

    Args:
        policy: touchdown policy file, or name of a shipped one (touchdown).
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        effect: effects of the library, at a plausible size, that the policies were not trained with (default:
            none).
        json: print only JSON on standard output.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
    """
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.eval.study import changes, motor_cut
    from inclined_landing.eval.study.engine import run
    from inclined_landing.eval.study.show import hand_over

    changes.check_effects(effect)
    own = load_policy(policy, "touchdown", vehicle=vehicle)
    cut = load_policy(NOMINAL, vehicle=vehicle, inclination=own.task.inclination)
    found = motor_cut.study(own, cut, effects=tuple(dict.fromkeys(effect)))
    hand_over("touchdown", run([found]), json=json, out=out)
