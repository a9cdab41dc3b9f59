"""The option that names a policy; apart from the other options, as it imports the tasks."""

from __future__ import annotations

from typing import Annotated

import tyro

from inclined_landing.envs.policy import SHIPPED

AnyPolicy = Annotated[
    str,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="POLICY", help=f"policy file, run folder, or a shipped one: {', '.join(SHIPPED)}."),
]
