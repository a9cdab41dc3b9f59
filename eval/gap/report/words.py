"""Sentences on a diagnosis, the same on the page and in the terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.result import (
    Dependence,
    Diagnosis,
    Difference,
    Disturbance,
    Estimate,
    InconsistentFlights,
    NamedEffect,
    PlantGap,
    ScoredSet,
)
from inclined_landing.models.effects import LIBRARY

# Unit -> factor to the displayed unit, and its name.
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
    "rad/s2": (180.0 / math.pi, "deg/s²"),
    "s2/m2": (1.0, "s²/m²"),
}
SETS = 7  # rows of the table of sets
NAMED = 3  # names of an equivalence class in the headline
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
    """Return the name of an effect with spaces."""
    return name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a list in a sentence: `a, b and c`."""
    return ", ".join(names[:-1]) + f" {last} {names[-1]}" if len(names) > 1 else "".join(names)


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
    if low == high:
        return quantity(ends[0], unit)
    places = _places(max(high - low, 1e-3 * abs(high)))
    return f"{_fixed_point(low, places)} to {_fixed_point(high, places)} {name}".rstrip()


def rounded(value: float, ends: Sequence[float], unit: str) -> str:
    """Return a number with one digit more than its interval."""
    factor, name = shown(unit)
    width = factor * (ends[1] - ends[0])
    if not math.isfinite(width):
        return quantity(value, unit)
    places = _places(max(width, 1e-2 * abs(factor * value)))
    return f"{_fixed_point(factor * value, places + 1)} {name}".rstrip()


def _places(width: float) -> int:
    """Return the decimal places that show two digits of a width; negative: tens, hundreds."""
    return min(6, 1 - math.floor(math.log10(abs(width)))) if width else 3


def _fixed_point(value: float, places: int) -> str:
    """Return a number rounded to decimal places; negative: tens, hundreds."""
    return f"{round(value, places):.{max(0, places)}f}"


def meaning(effect: NamedEffect) -> str:
    """Return the physical meaning of a named effect with its values, as part of a sentence."""
    values = {name: _value_text(p) for name, p in effect.parameters.items()}
    return LIBRARY[effect.name].says.format(**values)


def _value_text(p: Estimate) -> str:
    """Return a value with three digits, or the significant ones of its interval."""
    return min(quantity(p.value, p.unit), rounded(p.value, p.ci95, p.unit), key=len)


def sentence(effect: NamedEffect) -> str:
    """Return the physical meaning of a named effect as a sentence."""
    text = meaning(effect)
    return text[0].upper() + text[1:] + "."


def confounding_sentence(effect: NamedEffect) -> str:
    """Return a sentence on the effects confounded with a named one; empty where there are none."""
    others = [label(name) for name in effect.members if name != effect.name]
    if not others:
        return ""
    if _only_the_ratio(effect.members):
        return (
            f"It may as well be {listed(others, 'or')}: free flight shows only the ratio of thrust to mass."
        )
    return f"On these flights {listed(others, 'or')} may take the place of {label(effect.name)}."


def _only_the_ratio(names: Sequence[str]) -> bool:
    """Return whether all effects scale the thrust: only the ratio of thrust to mass is identifiable."""
    return all(LIBRARY[name].scales_thrust for name in names if name in LIBRARY)


def probability(part: float) -> str:
    """Return a probability in percent, 1 % to 99 %."""
    if part > 0.99:
        return "over 99 %"
    return "under 1 %" if part < 0.01 else f"{100 * part:.0f} %"


def _shortened(names: Sequence[str]) -> list[str]:
    """Return the first names, and the number of the others."""
    more = len(names) - NAMED
    return list(names) if more < 2 else [*names[:NAMED], f"{more} others"]


def _headline_entry(effect: NamedEffect) -> str:
    """Return a named effect for the headline: `rotor drag (98 %)`, `mass or thrust scale (99 %: ...)`."""
    names = listed(_shortened([label(name) for name in effect.members]), "or")
    why = (
        ": flights show only their ratio"
        if len(effect.members) > 1 and _only_the_ratio(effect.members)
        else ""
    )
    return f"{names} ({probability(effect.probability)}{why})"


def headline(d: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if d.verdict == "nothing":
        lines = f" ({probability(d.nothing)})" if d.sets else ""
        if d.inconsistent_flights:
            return f"Nothing is missing that all flights share{lines}."
        if d.possible and d.nothing < 0.5:
            name, part = next(iter(d.possible.items()))
            return (
                f"Nothing to correct: {label(name)} ({probability(part)}) fits these flights, but those left "
                "out are predicted no better with it."
            )
        as_well = "the model explains these flights as well as noise and disturbances allow"
        return f"Nothing is missing{lines}: {as_well}."
    sure = listed([_headline_entry(e) for e in d.effects if e.sure])
    rest = listed([_headline_entry(e) for e in d.effects if not e.sure])
    if rest and not sure and d.verdict != "unknown":
        return f"Possibly wrong or missing in the model: {rest}."
    parts = [part for part in (sure, rest and f"possibly {rest}") if part]
    if not parts:
        return "Something is missing that no effect of the library explains."
    if d.verdict == "unknown":
        parts.append("something that no effect of the library explains")
    return (
        f"Wrong or missing in the model: {listed(parts, 'and') if len(parts) < 3 else ', and '.join(parts)}."
    )


ANSWER_HEADS = ("what is wrong", "how sure", "costs after 1 s", "what to do")


def answer_rows(d: Diagnosis) -> list[tuple[str, str, str, str]]:
    """Return the rows under ANSWER_HEADS: the named effects, then the functions of the residual."""
    rows = []
    for e in d.effects:
        names = listed(_shortened([label(name) for name in e.members]), "or")
        cost = centimetres(e.cost) if math.isfinite(e.cost) else ""
        how = f"{'sure' if e.sure else 'possible'}, {probability(e.probability)}"
        if any(p.at_bound for p in e.parameters.values()):
            how += "; as large as it can be"
        rows.append((names, how, cost, plain(e.remedy)))
    for one in d.residual.depends_on:
        if d.residual.material(one):
            low, high = one.displacement_ci95
            cost = f"{centimetres(one.displacement)} ({100 * low:.1f} to {100 * high:.1f})"
            rows.append(
                (
                    f"unknown, {axis(one)}: depends on {one.on}",
                    "repeats on held-out flights",
                    cost,
                    "landing-eval plan designs a more informative flight.",
                )
            )
    return rows


def possible_sentence(d: Diagnosis) -> str:
    """Return a sentence on the effects that are possible though not named; empty for none."""
    if not d.possible:
        return ""
    names = [f"{label(name)} ({probability(part)})" for name, part in d.possible.items()]
    return f"Not named, but possible: {listed(names, 'or')}."


def inconsistency(c: InconsistentFlights) -> list[str]:
    """Return sentences on inconsistent flights: which, in which effects, and a remedy."""
    these, n = listed(c.flights), len(c.others)
    if len(c.flights) == n:
        subject = f"Two groups of flights contradict each other: {these}; and {listed(c.others)}."
        apart = "diagnose the two groups apart"
    else:
        verb, them = ("contradicts", "it") if len(c.flights) == 1 else ("contradict", "them")
        subject = f"{these} {verb} the other {n} flights."
        apart = f"diagnose {these} apart, and the other {n} flights without {them}"
    return [
        subject,
        *(_difference_sentence(c, one) for one in c.differences),
        f"Another vehicle, or another day's calibration? What is said below mixes the two: {apart} "
        "(landing-eval gap with the logs of each). Where all flights agree, such a thing is said by chance "
        f"in {100 * c.false_alarms:g} % of diagnoses.",
    ]


def _difference_sentence(c: InconsistentFlights, one: Difference) -> str:
    """Return a sentence on one effect by which groups of flights differ."""
    effect = LIBRARY[one.effect]
    if len(c.flights) == len(c.others):
        there, model = "the first group", "the second"
    else:
        there, model = c.flights[0] if len(c.flights) == 1 else "these flights", "the others"
    if one.swapped:
        there, model = model, there
    values = {
        name: rounded(x, one.ci95[name], effect.parameter(name).unit)
        if name in one.ci95
        else quantity(x, effect.parameter(name).unit)
        for name, x in one.values.items()
    }
    ends = [
        f"{label(name) + ' ' if len(one.ci95) > 1 else ''}{interval(x, effect.parameter(name).unit)}"
        for name, x in one.ci95.items()
    ]
    lines = f"Beside a model of {model}, in {there} {effect.says.format(**values)}"
    lines += f" (95 % interval{'s' * (len(ends) > 1)}: {', '.join(ends)})."
    others = [label(name) for name in one.confounded_with]
    return f"{lines} What differs may as well be {listed(others, 'or')}." if others else lines


def set_rows(d: Diagnosis) -> list[tuple[str, float, str, bool]]:
    """Return (effects, probability, sizes, whether most probable) of the most probable sets."""
    rows = [
        (" + ".join(map(label, one.effects)) or "nothing", one.probability, _sizes(one), k == 0)
        for k, one in enumerate(d.sets[:SETS])
    ]
    rest = 1.0 - sum(one.probability for one in d.sets[:SETS])
    return [*rows, ("all other sets", rest, "", False)] if rows and rest > 0.005 else rows


def _sizes(one: ScoredSet) -> str:
    """Return the parameter values of a set as text."""
    parts = []
    for name, values in one.values.items():
        effect = LIBRARY[name]
        lines = [f"{label(p)} {quantity(x, effect.parameter(p).unit)}" for p, x in values.items()]
        parts.append(", ".join(lines))
    return "; ".join(parts)


NOISE_HEADS = ("channel", "noise", "disturbance", "95 % interval", "correlation time", "95 % interval")


def noise_rows(disturbance: Mapping[str, Disturbance]) -> list[tuple[str, ...]]:
    """Return the noise and disturbance of every channel under NOISE_HEADS."""
    rows: list[tuple[str, ...]] = []
    for channel, q in disturbance.items():
        size, time = ("none", ""), ("", "")
        if q.size_ci95[1] > 0.0:
            size = rounded(q.size, q.size_ci95, q.unit), interval(q.size_ci95, q.unit)
            if not any(digit in size[0].split()[0] for digit in "123456789"):
                size = "none", size[1]
        if q.size_ci95[0] > 0.0:  # else its correlation time is not identifiable
            time = quantity(q.time, "s"), interval(q.time_ci95, "s")
        rows.append((channel, quantity(q.noise, "m" if channel in "xyz" else "rad"), *size, *time))
    return rows


def axis(d: Dependence) -> str:
    """Return the direction of a residual function as part of a sentence."""
    return {"forward": "along the heading", "left": "across the heading"}.get(d.channel, f"in {d.channel}")


def dependence_sentence(d: Dependence) -> str:
    """Return a sentence on a function of the residual."""
    cost = f"it displaces the vehicle by {centimetres(d.displacement)} within a second"
    most = max(d.regimes, key=d.regimes.__getitem__, default="")
    where = ""
    if most:
        where = f", most in {REGIMES.get(most, label(most))} ({quantity(d.regimes[most], d.unit)})"
    return f"{quantity(d.size, d.unit)} {axis(d)} depends on {d.on}{where}; {cost}, on held-out flights."


def gap(plant: str, g: PlantGap) -> str:
    """Return a sentence on the gap before and after in one plant."""
    before, after = centimetres(g.before), centimetres(g.after)
    worth_closing = math.isfinite(g.closed) and g.before > 1.2 * g.floor and before != after
    closed = f" ({share(g.closed)} of the gap closed)" if worth_closing else ""
    change = f"goes from {before} to {after}{closed}" if before != after else f"is {before}"
    return (
        f"{g.horizon:g} s ahead, on held-out flights, the position error in "
        f"{PLANTS[plant]} {change}; "
        f"the measurement noise alone makes {centimetres(g.floor)}."
    )


def centimetres(metres: float) -> str:
    """Return a length as `6.2 cm`."""
    return f"{100 * metres:.1f} cm" if abs(metres) < 0.1 else f"{100 * metres:.0f} cm"


def share(part: float) -> str:
    """Return a share in percent."""
    whole = 0.0995 <= part < 0.995 or part in (0.0, 1.0)
    return f"{100 * part:.0f} %" if whole else f"{100 * part:.1f} %"


def manoeuvre(d: Diagnosis) -> str:
    """Return the sentences on the discriminating manoeuvre, repetitions removed."""
    parts = re.split(r"(?<=[.!?])\s+", plain(d.separating_manoeuvre or ""))
    return " ".join(dict.fromkeys(parts))


def sentences(d: Diagnosis) -> list[str]:
    """Return the first sentences of the report, after the headline and its table."""
    lines = []
    for effect in d.effects:
        lines += [s for s in (sentence(effect), confounding_sentence(effect), plain(effect.note)) if s]
    if d.separating_manoeuvre:
        lines.append(f"To discriminate: {manoeuvre(d)}")
    if d.estimated:
        lines.append(
            "Beside that all constants of the identified vehicle were estimated again, as these flights show "
            "other sides of them; the vehicle file has them."
        )
    lines += [gap(plant, g) for plant, g in d.gap.items()]
    return lines + residual_sentences(d)


def plan_command(d: Diagnosis, report: Path) -> str:
    """Return the command that plans the flight to tell sets apart; "" where none is in doubt or none tells.

    report: the folder that holds the diagnosis.
    """
    apart: dict[tuple[str, ...], float] = {}  # touchdown effects need landings, which are not planned
    for one in d.sets:
        free = tuple(n for n in one.effects if not LIBRARY[n].contact)
        apart[free] = apart.get(free, 0.0) + one.probability
    doubt = bool(apart) and max(apart.values()) < thresholds.DECIDED
    weighed = (d.separating_manoeuvre or "").startswith("No flight")
    if d.verdict != "unknown" and (weighed or not doubt):
        return ""
    return f"landing-eval plan {report} --out {report.with_name(report.name + '-flight')}"


def residual_sentences(d: Diagnosis) -> list[str]:
    """Return sentences on possible effects and on the residual's functions, large and small."""
    residual, lines = d.residual, [possible_sentence(d)] if d.possible else []
    lines += [dependence_sentence(one) for one in residual.depends_on if residual.material(one)]
    small = [one for one in residual.depends_on if not residual.material(one) and one.displacement > 0.0]
    if small:
        most = max(small, key=lambda one: one.displacement)
        lines.append(
            f"{len(small)} smaller dependence{'s are' if len(small) > 1 else ' is'} significant too, at most "
            f"{centimetres(most.displacement)} within a second ({axis(most)}, on {most.on})"
            + (f", of a remaining {centimetres(residual.error)}." if math.isfinite(residual.error) else ".")
        )
    if not (residual.depends_on or d.inconsistent_flights):
        cause = "sensor noise and air disturbances"
        lines.append(f"The remaining error is unrelated to any logged signal: {cause}.")
    return lines


def plain(text: str) -> str:
    """Return a sentence of the diagnosis with displayed names of effects and units."""
    for name in LIBRARY:
        text = text.replace(name, label(name))
    text = text.replace("m/s2", "m/s²")
    return text if not text or text.endswith((".", "!", "?")) else text + "."
