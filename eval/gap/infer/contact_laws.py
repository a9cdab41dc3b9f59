"""Differences between contact laws: which contact effects are not identifiable, and which are confounded.

MuJoCo's contact is a damped spring on accelerations, with friction that answers within 1/damping. Other
engines have other laws, and nature has another again. The numbers were measured with MuJoCo's law on landings
of two engines, Bullet (impulses, restitution, a friction cone; tests/validation of commit cd884583) and the
independent simulator of tests/validation (springs and dampers on forces, bristles), and on tosses of a real
cube (tests/validation/tosses.py): see docs/evidence/hidden_effects.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Scatter(NamedTuple):
    """Standard deviation of an effect's size between laws of contact, in plausible sizes."""

    alone: float  # of the size itself, where landings are compared with the vehicle file
    referred: float  # of its difference to the reference vehicle's landings


# Friction: of a real cube between strikes, tumbling and sliding (0.18 to 0.24); alone, also of the engines.
# Feet, after a reference: of the height at which that cube rests between kinds of motion, 0.7 mm.
SCATTER = {
    "friction": Scatter(0.25, 0.21),
    "contact_stiffness": Scatter(0.6, 0.3),
    "contact_damping": Scatter(0.5, 0.2),
    "foot_height": Scatter(0.3, 0.17),
    "platform_height": Scatter(0.1, 0.1),
    "platform_tilt": Scatter(0.18, 0.16),
}
OF_OTHERS = Scatter(0.5, 0.3)  # of effects of other libraries: as wide as those of the spring

# Effect -> what, under another law, looked like it, for sizes within these ends, in plausible sizes. Feet
# that rebound or give way under one law are rougher or shorter ones under another; stiffer feet take away no
# more than what they give way under the weight (1.6 mm), and longer ones differ from them beyond.
_ALL = (-math.inf, math.inf)
LOOKS_LIKE: dict[str, tuple[tuple[float, float], tuple[str, ...]]] = {
    "friction": ((0.0, math.inf), ("contact_damping", "contact_stiffness")),
    "contact_damping": (_ALL, ("contact_stiffness", "friction")),
    "contact_stiffness": (_ALL, ("contact_damping", "foot_height", "friction")),
    "foot_height": ((-1.1, 0.6), ("contact_stiffness",)),
}


def look_alike(name: str, size: float) -> tuple[str, ...]:
    """Return the effects that under another law look like `name`, of a size in plausible sizes."""
    (low, high), others = LOOKS_LIKE.get(name, (_ALL, ()))
    return others if low < size < high else ()
