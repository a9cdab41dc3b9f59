"""`landing-eval equivalence`: the vehicle in MuJoCo against the paper's equations."""

from __future__ import annotations

import time

from inclined_landing.eval.base.options import Flag, RunFolder, Seed, VehicleFile


def command(
    *,
    out: RunFolder,
    vehicle: VehicleFile = None,
    seed: Seed = 0,
    quick: Flag = False,
) -> int:
    """Check the vehicle in MuJoCo against the paper's equations; writes a page of claims.

    Takes about 12 s on two cores. The exit code is 1 if a claim does not hold.

    Args:
        out: new folder for report.html, report.json and the figures.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        seed: seed for commands and states.
        quick: use fewer commands, states and starts.
    """
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.shared import runs
    from inclined_landing.eval.truth.equivalence import measured
    from inclined_landing.eval.truth.report import publish
    from inclined_landing.models.parameters import load_vehicle

    loaded = load_policy("landing", vehicle=None if vehicle is None else load_vehicle(vehicle))
    began = time.monotonic()
    sections, images = measured.measure(loaded, seed, quick)
    seconds = round(time.monotonic() - began, 1)
    claims = [c for s in sections for c in s.claims]
    record = {
        "command": "equivalence",
        "policy": str(loaded.path),
        "vehicle": str(vehicle) if vehicle is not None else "crazyflie.toml",
        "seed": int(seed),
        "quick": quick,
        "seconds": seconds,
        "versions": runs.versions(),
        "passed": all(c.passed for c in claims),
        "claims": len(claims),
        "failed": [c.name for c in claims if not c.passed],
    }
    name = "landing-eval equivalence" + (" --quick" if quick else "")
    passed = publish(
        out,
        "report",
        sections,
        images,
        record,
        title="The MuJoCo vehicle and the paper's model",
        lead="The MuJoCo vehicle, with its native plugins, against the equations of Kooi and Babuska "
        "(IROS 2021).",
        run=f"{name} · seed {seed} · policy {loaded.path.name} · {seconds:.0f} s",
    )
    return 0 if passed else 1
