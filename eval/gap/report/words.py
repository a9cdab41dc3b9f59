"""Sentences and numbers of a diagnosis, the same on the page and in the terminal."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.result import (
    Dependence,
    Diagnosis,
    Difference,
    Estimate,
    InconsistentFlights,
    NamedEffect,
    SetAside,
)
from inclined_landing.models.effects import LIBRARY

NAMES = 3  # of an equivalence class in its title
REGIME_LABELS = {
    "hover": "hover",
    "climb": "climb and descent",
    "lateral": "fast lateral",
    "attitude_step": "attitude step",
    "near_surface": "near a surface",
    "low_battery": "low battery",
    "touchdown": "touchdown",
}


def label(name: str) -> str:
    """Return the name of an effect as a person reads it."""
    text = name.replace("_", " ")
    return text.replace("mocap", "motion capture").replace("com offset", "centre of mass offset")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a list in a sentence: `a, b and c`."""
    return ", ".join(names[:-1]) + f" {last} {names[-1]}" if len(names) > 1 else "".join(names)


def labels(names: Iterable[str], last: str = "and") -> str:
    """Return effects as a list in a sentence."""
    return listed([label(name) for name in names], last)


def with_probabilities(parts: Mapping[str, float], last: str = "or") -> str:
    """Return effects with their probabilities as a list in a sentence: `wind (40 %) or mass (30 %)`."""
    return listed([f"{label(name)} ({probability(part)})" for name, part in parts.items()], last)


def value(p: Estimate) -> str:
    """Return the size of a parameter as every part of the report shows it."""
    return rounded(p.value, p.ci95, p.unit)


def title(effect: NamedEffect) -> str:
    """Return the name of an equivalence class: `rotor drag`, `mocap tilt or wind`, `thrust over mass`."""
    names = [label(name) for name in effect.members]
    if is_ratio(effect):
        return "thrust over mass"
    if effect.parts:
        return "attitude loops"
    more = len(names) - NAMES
    return listed(names if more < 2 else [*names[:NAMES], f"{more} others"], "or")


def is_ratio(effect: NamedEffect) -> bool:
    """Return whether an equivalence class is the ratio of thrust to mass, which free flight shows alone."""
    own = next(iter(effect.parameters.values()))
    scales = all(LIBRARY[name].scales_thrust for name in effect.members if name in LIBRARY)
    return len(effect.members) > 1 and scales and own.neutral == 1.0


def measured_by(effect: NamedEffect) -> dict[str, Estimate]:
    """Return what an equivalence class is measured by: its parameters, or the one ratio of thrust to mass."""
    if not is_ratio(effect):
        return effect.parameters
    (p,) = effect.parameters.values()
    if effect.name == "mass":
        low, high = p.ci95
        p = dataclasses.replace(p, value=1.0 / p.value, ci95=(1.0 / high, 1.0 / low))
    return {"ratio": p}


class SizeRow(NamedTuple):
    """A size of an effect as words."""

    parameter: str  # "" for one alone
    value: str
    interval: str  # of 95 %


def size_rows(effect: NamedEffect) -> tuple[SizeRow, ...]:
    """Return the sizes of an equivalence class."""
    shown = {name: p for name, p in measured_by(effect).items() if p.is_shown}
    return tuple(
        SizeRow(label(name) if len(shown) > 1 else "", value(p), interval(p.ci95, p.unit))
        for name, p in shown.items()
    )


def sentence(effect: NamedEffect) -> str:
    """Return the physical meaning of a named effect with its size, as a sentence."""
    parts = measured_by(effect)
    if effect.parts:
        (p,) = parts.values()
        change = "slower" if p.value > p.neutral else "quicker"
        times = f"{value(p)} after a step of the command, before at {quantity(p.neutral, p.unit)}"
        return f"The attitude loops are {change} than modelled: roll is at 63 % of its steady angle {times}."
    if len(parts) == 1 and (p := next(iter(parts.values()))).neutral == 1.0:
        factor = float(value(p))
        change = f"{abs(round(100 * (factor - 1)))} % {'higher' if factor > 1 else 'lower'} than modelled"
        name = title(effect) if is_ratio(effect) else label(effect.name)
        text = f"{name} is {change if 0.5 < factor < 2 else f'{value(p)} times the modelled value'}"
    else:
        firm = any(p.differs for p in parts.values())
        text = said(effect.name, {name: (p.value, _shown(p, firm)) for name, p in parts.items()})
    return text[0].upper() + text[1:] + "."


def _shown(p: Estimate, firm: bool) -> str:
    """Return a size in a sentence; firm: another size differs from neutral, so that one that may not is 0."""
    return f"about {quantity(0.0, p.unit)}" if firm and p.neutral == 0.0 and not p.differs else value(p)


# Parts of the effects' sentences (`Effect.says`), and what takes their place for a negative number, which
# then loses its sign: -14 ms older is 14 ms younger.
_NEGATIVE = {
    " older than": " younger than",
    " more than": " less than",
    " higher than": " lower than",
    "act {delay} after they were sent": "act {delay} earlier than modelled",
}


def said(name: str, numbers: Mapping[str, tuple[float, str]]) -> str:
    """Return an effect's sentence with its numbers, each with its text; a negative one reverses the sense."""
    sentence, texts = LIBRARY[name].says, {key: text for key, (_, text) in numbers.items()}
    if len(numbers) == 1 and all(number < 0.0 for number, _ in numbers.values()):
        for usual, reverse in _NEGATIVE.items():
            if usual in sentence:  # the sense is reversed, and the number loses its sign
                positive = {key: text.lstrip("-") for key, text in texts.items()}
                return sentence.replace(usual, reverse).format(**positive)
    return sentence.format(**texts)


def remedy(effect: NamedEffect) -> str:
    """Return what a person can do about a named effect; where its size cannot be, where else to look."""
    if all(p.at_bound for p in effect.sizes):
        return "At the bound of its range, it stands for another cause: landing-eval plan designs a flight."
    less = [p for p in LIBRARY[effect.name].parameters if p.one_signed and p.name in effect.parameters]
    if any(effect.parameters[p.name].value < p.neutral for p in less):
        return "The vehicle had more of it when it was identified: look for what else has changed since then."
    return effect.remedy


def probability(part: float) -> str:
    """Return a probability in percent, 1 % to 99 %."""
    if part > 0.99:
        return "over 99 %"
    return "under 1 %" if part < 0.01 else f"{100 * part:.0f} %"


def how_sure(effect: NamedEffect) -> str:
    """Return the verdict on a named effect with the probability of its equivalence class."""
    at_bound = "; at the bound of its range" * any(p.at_bound for p in effect.parameters.values())
    likely = effect.probability >= thresholds.SURE
    word = "sure" if effect.sure else "in doubt" if likely else "possible"
    return f"{word}, {probability(effect.probability)}{at_bound}"


def confounding_sentence(d: Diagnosis, effect: NamedEffect) -> str:
    """Return a sentence on the probability of each effect of an equivalence class; empty for one alone."""
    if len(effect.members) < 2:
        return ""
    parts = {name: d.probability(name) for name in effect.members}
    each = [
        f"{label(name)} ({probability(part) if part >= thresholds.CONFOUNDED else 'which predicts as well'})"
        for name, part in parts.items()
    ]
    shows = "free flight shows only the ratio of thrust to mass" if is_ratio(effect) else ""
    return f"This could be {listed(each, 'or')}: {shows or 'these flights cannot distinguish them'}."


def headline(d: Diagnosis) -> str:
    """Return what is wrong with the model in a sentence or two."""
    if not d.effects:
        return _nameless(d)
    first, *others = sorted(d.effects, key=lambda e: not e.sure)  # by gain already
    text = sentence(first) if first.sure else f"Possibly, {sentence(first)[0].lower()}{sentence(first)[1:]}"
    sure = [title(e) for e in others if e.sure]
    rest = [title(e) for e in others if not e.sure]
    if sure:
        text += f" Also wrong or missing: {listed(sure)}."
    if rest:
        text += f" Possibly also: {listed(rest, 'or')}."
    return f"{text} In addition, {_UNEXPLAINED}." if d.verdict == "unknown" else text


_UNEXPLAINED = "the flights show an error that no effect of the library explains"


def _nameless(d: Diagnosis) -> str:
    """Return the headline of a diagnosis without a named effect."""
    if d.verdict == "undecided":
        return f"Undecided: the model may lack {with_probabilities(d.undecided)}."
    before = centimetres(d.reference.error) if d.reference else ""
    larger = "the error is larger than in the reference flights, "
    larger += f"{centimetres(d.remaining.error)} for {before} one second ahead"
    if d.verdict == "unknown":
        if d.remaining.functions or not d.larger_error:
            return f"{_UNEXPLAINED[0].upper()}{_UNEXPLAINED[1:]}."
        return f"No effect is named: {larger}, as if the air were moving."
    how = f" ({probability(d.nothing)})" if d.nothing >= 0.5 else ""
    if d.inconsistent_flights:
        return f"No missing effect is common to all flights{how}."
    well = "the model explains these flights as well as noise and disturbances allow"
    return f"Nothing of a size that matters is missing{how}: {well}."


def how_much(d: Diagnosis) -> str:
    """Return sentences on the error one second ahead: how much was explained, is left, and repeats."""
    lines = []
    if g := d.ahead:
        before, after = centimetres(g.before), centimetres(g.after)
        error = "position error one second ahead"
        beside = f"noise alone: {centimetres(g.floor)}"
        if d.reference:
            beside = f"reference flights: {centimetres(d.reference.error)}, {beside}"
        if before == after:
            lines.append(f"The {error} is {after} ({beside}).")
        elif g.after < g.before:
            share = f"{100.0 * (1.0 - g.after / g.before):.0f} %"
            lines.append(
                f"Explained: {share} of the {error}, which falls from {before} to {after} ({beside})."
            )
        else:
            lines.append(f"With the correction, the {error} grows from {before} to {after} ({beside}).")
    if d.thrust_over_weight:
        ratio, ends = d.thrust_over_weight
        times = f"{rounded(ratio, ends, '1')} times the modelled one ({interval(ends, '1')})"
        lines.append(f"With the named effects, thrust over weight is {times} at the flights' usual command.")
    if material := d.remaining.functions:
        most = max(material, key=lambda one: one.displacement)
        repeats = f"Of the remaining error, {centimetres(most.displacement)} repeats from flight to flight"
        lines.append(f"{repeats}: {axis(most)}, depending on {most.on}.")
    if not (d.residual.depends_on or d.inconsistent_flights):
        like = "noise and air disturbances" if not d.larger_error else "gusts and other disturbances"
        lines.append(f"The remaining error does not depend on any logged signal, just like {like}.")
    if d.verdict == "undecided":
        lines.append("To refit all constants without naming one, run landing-eval identify on these flights.")
    return " ".join(lines)


@dataclasses.dataclass(frozen=True)
class Answer:
    """A named effect, or a function of the residual, as words."""

    title: str
    how: str  # sure or possible, with the probability
    sizes: tuple[SizeRow, ...]
    cost: str  # position error one second ahead; "" where it was not measured
    text: str  # sentences: the physical meaning, what limits the name, and what to do


def answers(d: Diagnosis) -> list[Answer]:
    """Return named effects, or those among which it is undecided, then what material depends on."""
    found = [_undecided(d, name) for name in d.undecided] if d.verdict == "undecided" else []
    for e in d.effects:
        cost = centimetres(e.cost) if math.isfinite(e.cost) else ""
        text = " ".join(filter(None, [sentence(e), confounding_sentence(d, e), e.doubt, remedy(e)]))
        found.append(Answer(title(e), how_sure(e), size_rows(e), cost, text))
    for one in d.remaining.functions:
        size, ends = quantity(one.displacement, "m"), interval(one.displacement_ci95, "m")
        found.append(
            Answer(
                title=f"unknown, {axis(one)}: depends on {one.on}",
                how="repeats on flights left out",
                sizes=(SizeRow("displacement in 1 s", size, ends),),
                cost=centimetres(one.displacement),
                text=f"An error {axis(one)} depends on {one.on}. More flights that vary this would show it.",
            )
        )
    return found


def _undecided(d: Diagnosis, name: str) -> Answer:
    """Return an effect that was not named, with its sizes in the most probable set that has it."""
    effect, best = LIBRARY[name], next(one for one in d.sets if name in one.effects)
    rows, sizes = [], {}
    for p in (p for p in effect.parameters if p.name in best.values[name]):
        error = best.standard_errors.get(name, {}).get(p.name, math.nan)
        value, half = best.values[name][p.name], 1.96 * error
        sizes[p.name] = value, rounded(value, (value - half, value + half), p.unit)
        if not p.is_reference:
            ends = interval((value - half, value + half), p.unit) if math.isfinite(half) else ""
            rows.append(SizeRow(label(p.name), sizes[p.name][1], ends))
    how, says = f"undecided, {probability(d.probability(name))}", said(name, sizes)
    rows = rows if len(rows) > 1 else [rows[0]._replace(parameter="")]
    return Answer(label(name), how, tuple(rows), "", f"Possibly, {says}. {effect.remedy}")


def possible_sentence(d: Diagnosis) -> str:
    """Return a sentence on the effects that are possible, and not said elsewhere; empty for none."""
    said = d.undecided if d.verdict == "undecided" else {}
    others = {name: part for name, part in d.possible.items() if name not in said}
    return f"Not named, but possible: {with_probabilities(others)}." if others else ""


def inconsistency(c: InconsistentFlights) -> list[str]:
    """Return sentences on inconsistent flights: which, in which effects, and a remedy."""
    these, n = listed(c.flights), len(c.others)
    if len(c.flights) == n:
        subject = f"Two groups of flights contradict each other: {these} against {listed(c.others)}."
        names = "the first group", "the second"
    else:
        verb = "contradicts" if len(c.flights) == 1 else "contradict"
        subject = f"{these} {verb} the other {n} flights."
        names = c.flights[0] if len(c.flights) == 1 else "these flights", "the others"
    return [
        subject,
        *(_difference_sentence(one, *(names[::-1] if one.swapped else names)) for one in c.differences),
        "Was the vehicle or the calibration different? The result below mixes the two; run landing-eval gap "
        f"on the logs of each. False-alarm rate: {100 * thresholds.INCONSISTENT:g} %.",
    ]


def _difference_sentence(one: Difference, there: str, model: str) -> str:
    """Return a sentence on one effect by which flights differ from a model of the others."""
    units = {p.name: p.unit for p in LIBRARY[one.effect].parameters}
    texts = {
        name: (x, rounded(x, one.ci95[name], units[name]) if name in one.ci95 else quantity(x, units[name]))
        for name, x in one.values.items()
    }
    ends = [
        f"{label(name) + ' ' if len(one.ci95) > 1 else ''}{interval(x, units[name])}"
        for name, x in one.ci95.items()
    ]
    lines = f"Compared with {model}, in {there} {said(one.effect, texts)}"
    lines += f" (95 % interval{'s' * (len(ends) > 1)}: {', '.join(ends)})."
    others = labels(one.confounded_with, "or")
    return f"{lines} The difference could equally be {others}." if others else lines


def axis(d: Dependence) -> str:
    """Return the direction of a residual function as part of a sentence."""
    return {"forward": "along the heading", "left": "across the heading"}.get(d.channel, f"in {d.channel}")


def centimetres(metres: float) -> str:
    """Return a length as `6.2 cm`."""
    return f"{100 * metres:.1f} cm" if abs(metres) < 0.1 else f"{100 * metres:.0f} cm"


def causes(d: Diagnosis) -> list[str]:
    """Return a paragraph for each answer, then one on what is possible."""
    return [*(one.text for one in answers(d)), *filter(None, [possible_sentence(d)])]


def set_aside(one: SetAside) -> str:
    """Return a sentence on a flight that was not used."""
    return f"{one.flight} was set aside and not used: {one.reason}"


def notes(*groups: Sequence[str]) -> list[str]:
    """Return the notes of some groups as a person reads them, each once."""
    return [readable(note) for note in dict.fromkeys(note for group in groups for note in group)]


def readable(text: str) -> str:
    """Return a sentence of the diagnosis with displayed names of effects and units."""
    for name in LIBRARY:
        text = text.replace(name, label(name))
    text = text.replace("m/s2", "m/s²")
    return text if not text or text.endswith((".", "!", "?")) else text + "."


# Unit -> factor to the displayed unit, and its name.
SHOWN = {
    "1": (1.0, ""),
    "rad": (180.0 / math.pi, "deg"),
    "rad/s": (180.0 / math.pi, "deg/s"),
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "N": (1e3, "mN"),
    "kg": (1e3, "g"),
    "1/s": (100.0, "%/s"),
    "rad/(rad s)": (1.0, "per s"),
    "1/V": (100.0, "%/V"),
    "1/m": (1.0, "per m"),
    "m/s2": (1.0, "m/s²"),
    "rad/s2": (180.0 / math.pi, "deg/s²"),
    "s2/m2": (1.0, "s²/m²"),
}


def shown(unit: str) -> tuple[float, str]:
    """Return the factor to the displayed unit, and its name."""
    return SHOWN.get(unit, (1.0, unit))


def quantity(value: float, unit: str) -> str:
    """Return a number with three digits in the displayed unit: 0.012 s is 12 ms."""
    factor, name = shown(unit)
    value *= factor
    text = f"{value:.0f}" if abs(value) >= 1000 else f"{value:#.3g}".rstrip(".")
    return f"{text} {name}".rstrip()


def exact(value: float, unit: str) -> str:
    """Return a number of the model with four digits in the displayed unit."""
    factor, name = shown(unit)
    value *= factor
    return f"{value:.0f} {name}".rstrip() if abs(value) >= 1e4 else f"{value:.4g} {name}".rstrip()


def interval(ends: Sequence[float], unit: str) -> str:
    """Return an interval with the significant digits of its width, `0.876 to 0.884`."""
    factor, name = shown(unit)
    low, high = (factor * x for x in ends)
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    if high - low <= 1e-6 * abs(high):
        return quantity(ends[0], unit)
    places = _places(max(high - low, 1e-3 * abs(high)))
    return f"{_fixed_point(low, places)} to {_fixed_point(high, places)} {name}".rstrip()


def rounded(value: float, ends: Sequence[float], unit: str) -> str:
    """Return a number with the decimal places of its interval."""
    factor, name = shown(unit)
    width = factor * (ends[1] - ends[0])
    if not (math.isfinite(width) and width):
        return quantity(value, unit)
    return f"{_fixed_point(factor * value, _places(max(width, 1e-3 * abs(factor * value))))} {name}".rstrip()


def _places(width: float) -> int:
    """Return the decimal places that show two digits of a width; negative: tens, hundreds."""
    return min(6, 1 - math.floor(math.log10(abs(width)))) if width else 3


def _fixed_point(value: float, places: int) -> str:
    """Return a number rounded to decimal places, never -0; negative places: tens, hundreds."""
    return f"{round(value, places) + 0.0:.{max(0, places)}f}" if value else "0"
