"""`landing-eval validate`: the engine against the paper's model, and contact against its laws."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import Flag, Flat, Folder, NewFolder, PolicyName, Seed, VehicleFile
from inclined_landing.models.errors import UserError, choices, shown

SUBJECTS = ("equivalence", "contact")
Subject = Annotated[
    str,
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="{equivalence,contact}",
        help="what is checked: the vehicle against the paper's model, or contact.",
    ),
]


@dataclasses.dataclass(frozen=True)
class Equivalence:
    """For equivalence.

    Args:
        policy: landing policy for recorded commands and closed loops: a file, or a shipped one.
        seed: of commands and states.
        quick: fewer commands, states and starts.
    """

    policy: PolicyName = "landing"
    seed: Seed = 0
    quick: Flag = False


@dataclasses.dataclass(frozen=True)
class Contact:
    """For contact.

    Args:
        flights: folder of measured NanoBench flights (nb_*.csv.gz): their touchdowns are simulated and the
            contact setting is fitted.
        friction: of a setting of your own, measured besides the default.
        restitution: of your own setting, 0 to 0.6; together with the contact time.
        contact_time: of your own setting in seconds, 0.012 to 0.02.
    """

    flights: NewFolder = None
    friction: float | None = None
    restitution: float | None = None
    contact_time: Annotated[float | None, tyro.conf.arg(metavar="S")] = None


def command(
    subject: Subject,
    /,
    *,
    out: Folder,
    vehicle: VehicleFile = None,
    model: Flat[Equivalence] = Equivalence(),
    contact: Flat[Contact] = Contact(),
) -> int | None:
    """Is the vehicle the paper's model, and is contact right? A page of claims.

    equivalence: the vehicle in MuJoCo against the paper's equations; the exit code is 1 when a claim fails.
    contact: rest, slip, drops, energy and more against the laws of contact.

    Args:
        subject: equivalence or contact.
        out: new folder for the page, its numbers as JSON, and the figures.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
    """
    if subject not in SUBJECTS:
        raise UserError(f"validate {shown(subject, 40)}: {choices(SUBJECTS, subject)}")
    other = contact != Contact() if subject == "equivalence" else model != Equivalence()
    if other:
        raise UserError(f"an option of validate {SUBJECTS[subject == 'equivalence']} is not one of {subject}")
    if subject == "equivalence":
        from inclined_landing.eval.truth.equivalence import command as equivalence

        return equivalence.command(out, model.policy, vehicle, model.seed, model.quick)
    from inclined_landing.eval.truth.contact_truth import command as contact_truth

    setting = (contact.friction, contact.restitution, contact.contact_time)
    contact_truth.command(out, contact.flights, vehicle, *setting)
    return None
