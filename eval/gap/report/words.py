"""A diagnosis in plain words, the same on the page and in the terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from inclined_landing.eval.gap.result import Candidate, Diagnosis, NamedEffect, PlantGap, SearchStep
from inclined_landing.models.effects import LIBRARY

# Factor and name of the unit a person reads, by the unit of the number.
SHOWN = {
    "1": (1.0, ""),
    "rad": (180.0 / math.pi, "deg"),
    "rad/s": (180.0 / math.pi, "deg/s"),
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "N": (1e3, "mN"),
    "1/s": (100.0, "%/s"),
    "1/V": (100.0, "%/V"),
    "1/m": (1.0, "per m"),
    "m/s2": (1.0, "m/s²"),
    "s2/m2": (1.0, "s²/m²"),
}
PLANTS = {"analytic": "the equations", "mujoco": "MuJoCo"}
REGIMES = {
    "hover": "hover",
    "climb": "climb and descent",
    "lateral": "fast lateral",
    "attitude_step": "attitude step",
    "near_surface": "near a surface",
    "low_battery": "low battery",
    "touchdown": "touchdown",
    "all": "all windows",
}


def label(name: str) -> str:
    """The name of an effect as a person writes it."""
    return name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """`a, b and c`."""
    return ", ".join(names[:-1]) + f" {last} {names[-1]}" if len(names) > 1 else "".join(names)


def shown(unit: str) -> tuple[float, str]:
    """Factor to the unit a person reads, and its name."""
    return SHOWN.get(unit, (1.0, unit))


def quantity(value: float, unit: str) -> str:
    """A number with the unit a person reads: 0.012 s is 12 ms."""
    factor, name = shown(unit)
    value *= factor
    text = f"{value:.0f}" if abs(value) >= 1000 else f"{value:#.3g}".rstrip(".")
    return f"{text} {name}".rstrip()


def exact(value: float, unit: str) -> str:
    """A number of the model as it stands there, with the unit a person reads."""
    factor, name = shown(unit)
    return f"{factor * value:.4g} {name}".rstrip()


def span(ends: Sequence[float], unit: str) -> str:
    """An interval with as many digits as its width can bear, `0.876 to 0.884`."""
    factor, name = shown(unit)
    low, high = (factor * x for x in ends)
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    places = _places(high - low)
    return f"{low:.{places}f} to {high:.{places}f} {name}".rstrip()


def rounded(value: float, ends: Sequence[float], unit: str) -> str:
    """A number with one digit more than its interval has."""
    factor, name = shown(unit)
    width = factor * (ends[1] - ends[0])
    if not math.isfinite(width):
        return quantity(value, unit)
    return f"{factor * value:.{_places(width) + 1}f} {name}".rstrip()


def _places(width: float) -> int:
    return min(6, max(0, 1 - math.floor(math.log10(abs(width))))) if width else 3


def says(effect: NamedEffect) -> str:
    """What a named effect means with its values, as part of a sentence."""
    values = {name: quantity(p.value, p.unit) for name, p in effect.parameters.items()}
    return LIBRARY[effect.name].says.format(**values)


def sentence(effect: NamedEffect) -> str:
    """The same as a sentence of its own."""
    text = says(effect)
    return text[0].upper() + text[1:] + "."


def tie(effect: NamedEffect) -> str:
    """What a named effect cannot be told from, as a sentence; empty where nothing is like it."""
    alike = _alike(effect)
    return f"On these flights {label(effect.name)} cannot be told apart from {alike}." if alike else ""


def _alike(effect: NamedEffect) -> str:
    return listed([label(name) for name in effect.members if name != effect.name], "or")


def headline(d: Diagnosis) -> str:
    """The verdict in one sentence."""
    if d.verdict == "nothing":
        return "Nothing is missing: the model explains these flights as well as their noise allows."
    if not d.effects:
        return "Something is missing that no effect of the library explains."
    names = listed([label(e.name) + (f" (or {_alike(e)})" if _alike(e) else "") for e in d.effects])
    if d.verdict == "unknown":
        return f"The model lacks {names}, and something that no effect of the library explains."
    return f"The model lacks {names}."


def gap(plant: str, g: PlantGap) -> str:
    """How the gap shrank in one plant, as a sentence."""
    worth_closing = math.isfinite(g.closed) and g.before > 1.2 * g.floor
    closed = f" ({share(g.closed)} of the gap closed)" if worth_closing else ""
    change = f"goes from {centimetres(g.before)} to {centimetres(g.after)}{closed}"
    return (
        f"{g.horizon:g} s ahead, on flights left out of the fit, the position error in "
        f"{PLANTS[plant]} {change if g.after != g.before else f'is {centimetres(g.before)}'}; "
        f"the measurement noise alone makes {centimetres(g.floor)}."
    )


def centimetres(metres: float) -> str:
    """A length as `6.2 cm`."""
    return f"{100 * metres:.1f} cm" if abs(metres) < 0.1 else f"{100 * metres:.0f} cm"


def outcome(step: SearchStep, number: int) -> str:
    """What a step of the search came to."""
    said = f"nothing {'more ' if number > 1 else ''}is worth adding"
    if step.accepted:
        said = f"{label(step.accepted)} added"
    if step.dropped:
        said += ", " + ", ".join(map(label, step.dropped)) + " no longer needed"
    return said


def fate(candidate: Candidate, step: SearchStep) -> str:
    """What became of a candidate in a step of the search."""
    if candidate.effect != step.accepted:
        return "cannot be told apart" if candidate.tie else candidate.reason
    return "added, " + ", ".join(f"{label(name)} {value:.3g}" for name, value in candidate.values.items())


def share(part: float) -> str:
    """A share in percent."""
    whole = 0.0995 <= part < 0.995 or part in (0.0, 1.0)
    return f"{100 * part:.0f} %" if whole else f"{100 * part:.1f} %"


def manoeuvre(d: Diagnosis) -> str:
    """The flight that would tell ties apart; what several ties share is said once."""
    parts = re.split(r"(?<=[.!?])\s+", plain(d.separating_manoeuvre or ""))
    return " ".join(dict.fromkeys(parts))


def sentences(d: Diagnosis) -> list[str]:
    """The first lines of the report, after the headline."""
    said = []
    for effect in d.effects:
        said += [s for s in (sentence(effect), tie(effect), plain(effect.note)) if s]
    if d.separating_manoeuvre:
        said.append(f"To tell them apart: {manoeuvre(d)}")
    said += [f"What to do: {plain(effect.remedy)}" for effect in d.effects if effect.remedy]
    said += [gap(plant, g) for plant, g in d.gap.items()]
    if d.remainder.text:
        said.append(plain(d.remainder.text))
    return said


def plain(text: str) -> str:
    """A sentence of the diagnosis with effects and units as a person writes them."""
    for name in LIBRARY:
        text = text.replace(name, label(name))
    text = text.replace("m/s2", "m/s²")
    return text if not text or text.endswith((".", "!", "?")) else text + "."
