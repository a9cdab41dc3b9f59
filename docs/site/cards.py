"""The shipped policies: a list, `envs/shipped/README.md`, and a card for each, `docs/evidence/policies.md`.

    python docs/site/cards.py                # writes both pages
    python docs/site/cards.py --fly [NAME]   # flies all policies, or the one named, before (ten minutes)

Nothing is copied by hand. What a policy was trained on is in its file. What it reaches was flown with the
commands of `cards.toml` and lies in `cards.json`, with the hash of the file that flew. Results of three seeds
are those of `train/recipes`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from generated import table  # in this folder
from recipes import recorded

from inclined_landing.envs.history import input_names
from inclined_landing.envs.ids import SHIPPED
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.train.sweep.recipe import filled, read_recipe, shipped

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FOLDER = ROOT / "envs" / "shipped"
LIST, PAGE = FOLDER / "README.md", ROOT / "docs" / "evidence" / "policies.md"
DESCRIBED, FLOWN = HERE / "cards.toml", HERE / "cards.json"
ENOUGH = 0.95  # share of flights below which a condition is listed as one that it fails in
GONE = "--video-every"  # an option that `landing-train` had, in a recorded command
OF_THE_RUN = ("--seed", "--out", "--threads", GONE, "--evaluate-every", "--no-report")


class Stale(Exception):
    """The record of a policy does not match the policy."""


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fly", nargs="*", metavar="NAME", help="policies to fly first (default: all)")
    names = parser.parse_args().fly
    if names is not None:
        described, flown = _described(), json.loads(FLOWN.read_text("utf-8")) if FLOWN.is_file() else {}
        for name in names or SHIPPED:
            flown[name] = {
                "sha256": digest(name),
                "judged": [fly(name, w) for w in described[name]["judged"]],
            }
            FLOWN.write_text(_recorded(flown), "utf-8")
    PAGE.write_text(page(), "utf-8")
    LIST.write_text(overview(), "utf-8")


# --- flights -------------------------------------------------------------------------------------


def fly(name: str, words: str) -> dict:
    """Return what a policy reaches: the rows of one command, with the versions that flew."""
    line = _line(name, words)
    print(line, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        _, command, *options = shlex.split(line)
        program = [sys.executable, "-P", "-m", "inclined_landing.eval", command, *options]
        program += ["--out", str(out)]
        subprocess.run(program, check=True, stdout=subprocess.DEVNULL)
        report = json.loads((out / f"{command}.json").read_text("utf-8"))
    versions = {key: report["versions"][key] for key in ("mujoco", "inclined-landing")}
    return {"command": words, "versions": versions, "rows": list(ROWS[words.split()[0]](report["rows"]))}


Rows = list[dict]


def _row(what: str, found: dict, group: str = "", measure: str = "strict") -> dict:
    """Return a share with its interval; of rows of one group only those below ENOUGH are shown."""
    row = {"what": what, "measure": measure, "count": found["count"], "of": found["flights"]}
    return row | {"interval": _rounded([found["low"], found["high"]])} | ({"group": group} if group else {})


def _value(what: str, value: float, unit: str, interval=None) -> dict:
    return {"what": what, "value": _rounded(value), "unit": unit, "interval": interval and _rounded(interval)}


def _rounded(value):
    """Six digits."""
    return [_rounded(each) for each in value] if isinstance(value, list) else float(f"{value:.6g}")


def _with(rows: Rows, measure: str, *labels: str, **values: object) -> Iterator[dict]:
    """Yield the rows of a measure that have all of `labels`, and the given values."""
    for row in rows:
        if row["measure"] == measure and all(row[label] is not None for label in labels):
            if all(row[label] == value for label, value in values.items()):
                yield row


def _success(rows: Rows) -> Iterator[dict]:
    starts = {"frozen grid": "frozen grid", "frozen set": "frozen starts over all slopes"}
    for measure in ("mean_error", "within", "strict", "at_rest_on_feet"):
        for row in _with(rows, measure, "thrust_scale"):
            at = "" if row["thrust_scale"] == 1 else f", thrust x {row['thrust_scale']:g}"
            if measure == "mean_error":
                ends = [100 * row["low"], 100 * row["high"]]
                yield _value(f"mean error after 3 s{at}", 100 * row["value"], "cm", ends)
            elif measure == "within":
                yield _row(f"within 5 cm after 3 s{at}", row, measure="")
            elif measure == "strict" and row["starts"] in starts:
                yield _row(starts[row["starts"]] + at, row)
            elif measure == "at_rest_on_feet" and not at:
                yield _row("at rest 2 s after the motors are cut in the goal box", row, measure="")


def _slopes(rows: Rows) -> Iterator[dict]:
    for row in _with(rows, "strict", "slopes"):
        yield _row(f"slopes: {row['slopes']}", row)
    for row in _with(rows, "strict", "inclination"):
        yield _row(f"about {row['inclination']:.3g} deg", row, "ranges of slopes")


def _vehicles(rows: Rows) -> Iterator[dict]:
    for row in _with(rows, "strict", "vehicle"):
        drawn = "drawn" in row["vehicle"]
        yield _row(f"{row['vehicle']} from the range" if drawn else f"`{row['vehicle']}`, frozen grid", row)


SIZES = {"weak": "at half a plausible size", "medium": "at a plausible size", "strong": "at twice that size"}


def _touchdown(rows: Rows) -> Iterator[dict]:
    rows = [row for row in rows if row["motors"] == "touchdown policy"]
    (rest,) = _with(rows, "at_rest", contact="all")
    (speed,) = _with(rows, "normal_speed", contact="all")
    yield _row("at rest, all frictions and restitutions", rest, measure="")
    yield _value("speed into the slope at the first touch, median", speed["value"], "m/s")
    for row in _with(rows, "at_rest", "effect"):
        yield _row(f"at rest with `{row['effect']}` {SIZES['medium']}", row, measure="")
    for row in _with(rows, "at_rest", "friction", "restitution"):
        title = f"friction {row['friction']:g}, restitution {row['restitution']:g}"
        yield _row(title, row, "frictions and restitutions", "at rest")


def _moving(rows: Rows) -> Iterator[dict]:
    (everything,) = _with(rows, "at_rest", "together")
    yield _row("at rest, all flights of the benchmark", everything, measure="")
    for row in _with(rows, "at_rest", "scenario"):
        yield _row(f"`{row['scenario']}`", row, "scenarios", "at rest")


def _robustness(rows: Rows) -> Iterator[dict]:
    for row in _with(rows, "strict", "thrust_scale"):
        yield _row(f"thrust x {row['thrust_scale']:g}", row, "thrusts")
    for row in _with(rows, "strict", "effect"):
        if row["size"]:
            yield _row(row["effect"], row, f"effects {SIZES[row['size']]}")


ROWS: dict[str, Callable[[Rows], Iterator[dict]]] = {
    "success": _success,
    "slopes": _slopes,
    "vehicles": _vehicles,
    "touchdown": _touchdown,
    "moving": _moving,
    "robustness": _robustness,
}


def _recorded(flown: dict) -> str:
    """JSON with every row on a line of its own."""
    text = json.dumps(flown, indent=1, sort_keys=True, ensure_ascii=False)
    for pattern in (r"\{[^{}]*\}", r"\[[^][{}]*\]"):
        text = re.sub(pattern, lambda match: re.sub(r"\n *", " ", match[0]), text)
    return text + "\n"


# --- the page --------------------------------------------------------------------------------------


INTRODUCTION = """\
# Evidence: shipped policies

<!-- Made by `python docs/site/cards.py`. -->

A card for each policy of [the list](../../envs/shipped/README.md): how it was trained, what it reaches,
where it fails. Each is the *final* policy of its run. *Strict* is reaching the goal box within 300 steps
without touching the platform before. Intervals are 95 % intervals, of shares Wilson's. A policy fails
under a condition if it reaches less than {enough:.0f} %. *Plausible size* is the size that the library
gives an effect.
"""

LISTED = """\
# Shipped policies

<!-- Made by `python docs/site/cards.py`. -->

Every command that takes a policy takes these by name, and so does `load_policy("landing")` in Python.
They are policy files, which Stable-Baselines3 reads too; `inclined_landing.json` in the zip holds task,
options, training command, versions. The name links to the policy's card with all conditions, failures and
the commands that measured them.
"""

END = """\
*Strict*: the goal box is reached within 300 steps, and nothing is touched before. All figures are from
simulation.

`robust.toml` and `vehicles.toml` are the ranges of `landing-train --randomise robust` and `--randomise
vehicles`.

To add a policy, put `TASK-NAME.zip` into `envs/shipped`, describe it in `docs/site/cards.toml`, and run
`python docs/site/cards.py --fly TASK-NAME`, which flies it and writes these pages.
"""


def overview() -> str:
    """Markdown of the list of policies."""
    described, flown = _described(), json.loads(FLOWN.read_text("utf-8"))
    rows = []
    for name in SHIPPED:
        rows_of_first = flown[name]["judged"][0]["rows"]
        first = max(rows_of_first, key=lambda row: row.get("of", 0))  # what most flights show
        card = f"[`{name}`](../../docs/evidence/policies.md#{name})"
        result = re.sub(r" \[.*?\]", "", _shown(first))  # the card has the interval
        rows.append([card, described[name]["about"], f"{result} ({_what(first)})"])
    return "\n".join([LISTED, table(["policy", "purpose", "result"], rows), END])


def page() -> str:
    """Markdown of all cards; raises Stale where a policy is not the one that was flown."""
    described, flown = _described(), json.loads(FLOWN.read_text("utf-8"))
    if not set(SHIPPED) == set(described) == set(flown):
        raise Stale(
            f"cards.toml, cards.json and envs/shipped do not have the same policies: {', '.join(SHIPPED)}"
        )
    for name in SHIPPED:
        if (
            flown[name]["sha256"] != digest(name)
            or [done["command"] for done in flown[name]["judged"]] != described[name]["judged"]
        ):
            raise Stale(f"{name} is not what was flown: run `python docs/site/cards.py --fly {name}`")
    cards = [card(name, described[name], flown[name]["judged"]) for name in SHIPPED]
    return "\n".join([INTRODUCTION.format(enough=100 * ENOUGH), *cards])


def card(name: str, described: dict, judged: list[dict]) -> str:
    """The section of one policy."""
    policy = load_policy(name)
    facts = {
        "Task": _task(policy),
        "Observes": _observes(policy),
        "Commands": f"{', '.join(policy.task.action_names)}; PWM {_pwm(policy)}",
        "Network": f"{'-'.join(str(n) for n in _layers(policy))}, {policy.activation}",
        "Trained by": f"`{made_by(policy.metadata)}`",
        "Training": _training(policy.metadata),
        "Varied vehicles": _randomised(policy.metadata),
        "With": ", ".join(f"{k} {v}" for k, v in policy.metadata["versions"].items() if k in _VERSIONS),
        "File": f"`{policy.path.name}`, {policy.path.stat().st_size // 1000} kB, SHA-256 `{digest(name)}`",
        "Licence": LICENCE,
    }
    parts = [
        f"## {name}\n",
        described["about"] + "\n",
        table(["property", "value"], [list(pair) for pair in facts.items()]),
    ]
    shown = [row for done in judged for row in done["rows"] if "group" not in row]
    rows = [[_what(row), _shown(row), str(row.get("of", ""))] for row in shown]
    parts.append(table(["condition", "result", "flights"], rows))
    failed = [line for done in judged for line in _fails(done["rows"])]
    parts.append("Where it fails:\n")
    parts += [f"- {line}" for line in (*failed, *described.get("notes", ()))] or [
        "- under none of the conditions flown"
    ]
    commands = "\n".join(_line(name, done["command"]) for done in judged)
    versions = {", ".join(f"{k} {v}" for k, v in done["versions"].items()) for done in judged}
    parts.append(f"\nFlown with {' and '.join(sorted(versions))}:\n\n```sh\n{commands}\n```\n")
    found = recipe_of(policy.metadata)
    return "\n".join([*parts, *([_recipe(*found)] if found else [])])


_VERSIONS = ("mujoco", "stable-baselines3", "torch", "inclined-landing", "git revision")
LICENCE = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["license"]


def digest(name: str) -> str:
    """SHA-256 of a policy's file."""
    return hashlib.sha256((FOLDER / f"{name}.zip").read_bytes()).hexdigest()


def _described() -> dict:
    return tomllib.loads(DESCRIBED.read_text("utf-8"))


def _line(name: str, words: str) -> str:
    command, _, options = words.partition(" ")
    over = f" --over {command}" if command in ("slopes", "vehicles", "moving") else ""
    return f"landing-eval {'robustness' if over else command} {name} {options}".rstrip() + over


# What a policy was trained on, from its own file.


def _task(policy: Policy) -> str:
    options = policy.metadata["task_options"]
    words = [f"`{policy.metadata['task']}`" + (", in space" if options.get("dimensions") == 3 else "")]
    if "steepest" in options:
        any_way = ", facing any way" if options.get("dimensions") == 3 else " in both directions"
        words.append(f"slopes up to {np.degrees(options['steepest']):.3g} deg{any_way}")
    elif "inclination" in options:
        words.append(f"a slope of {np.degrees(options['inclination']):.3g} deg")
    if "angle_limit" in options:
        words.append(f"attitudes up to {np.degrees(options['angle_limit']):.3g} deg")
    if "fastest" in options:
        words.append(f"platforms that travel at up to {options['fastest']:g} m/s")
    if options.get("swell"):
        words.append(f"swell {options['swell']:g}")
    return ", ".join(words)


def _observes(policy: Policy) -> str:
    names = [name for name in input_names(policy.task) if "[-" not in name]
    past = policy.task.history
    return ", ".join(names) + (f"; the same and the commands of the last {past} steps" if past else "")


def _pwm(policy: Policy) -> str:
    about = "each vehicle's hover" if policy.task.per_vehicle_hover else f"{policy.task.pwm_centre:.0f}"
    return f"{about} ± {policy.task.pwm_span:.0f}"


def _layers(policy: Policy) -> list[int]:
    return [len(policy.centre), *(bias.size for bias in policy.biases)]


def _training(metadata: dict) -> str:
    algorithm = metadata.get("algorithm", "PPO")  # early files do not say
    plant = {"mujoco": "MuJoCo", "hybrid": "the hybrid plant", "analytic": "the equations"}[metadata["plant"]]
    steps = f"{metadata['steps']:,}".replace(",", " ")
    seed, curriculum = metadata["seed"], metadata["curriculum"]
    return f"{algorithm}, {steps} steps in {plant}, seed {seed}, curriculum `{curriculum}`"


def _contains(whole: object, part: object) -> bool:
    """Return whether tables, and those within them, have all entries of others."""
    if isinstance(whole, dict) and isinstance(part, dict):
        return all(key in whole and _contains(whole[key], value) for key, value in part.items())
    return whole == part


def _randomised(metadata: dict) -> str:
    ranges = metadata.get("ranges")
    if not ranges:
        return "no: every episode has the nominal vehicle"
    for file in sorted(FOLDER.glob("*.toml")):
        present = tomllib.loads(file.read_text("utf-8"))
        if _contains(present, ranges):  # it may say more by now
            named = f"[`{file.name}`](../../envs/shipped/{file.name}), "
            break
    else:
        named = ""
    vehicles = ranges.get("vehicles", [])
    rows = f"; between {' and '.join((vehicles[0], vehicles[-1]))}" if vehicles else ""
    return f"{named}{len(ranges['effects'])} effects of the library{rows}"


# What it reaches.


def _what(row: dict) -> str:
    return f"{row['measure']}, {row['what']}" if row.get("measure") else row["what"]


def _shown(row: dict) -> str:
    if "value" in row:
        ends = f" [{', '.join(f'{x:.3g}' for x in row['interval'])}]" if row["interval"] else ""
        return f"{row['value']:.3g}{ends} {row['unit']}"
    low, high = row["interval"]
    return f"{_percent(row['count'] / row['of'])} % [{_percent(low)}, {_percent(high)}]"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


def _fails(rows: list[dict]) -> Iterator[str]:
    """One line for each group of conditions in which some are below ENOUGH."""
    groups: dict[str, list[dict]] = {}
    for row in rows:
        if "count" in row:
            groups.setdefault(row.get("group", ""), []).append(row)
    for group, members in groups.items():
        low = [row for row in members if row["count"] / row["of"] < ENOUGH]
        low.sort(key=lambda row: row["count"] / row["of"])
        if low and group:
            said = "; ".join(f"{row['what']}: {_shown(row)}" for row in low)
            yield f"{len(low)} of {len(members)} {group} ({low[0]['measure']}): {said}"
        else:
            yield from (f"{_what(row)}: {_shown(row)}" for row in low)


# Three seeds of its recipe.


def made_by(metadata: dict) -> str:
    """The command that trained a policy, without an option that was removed."""
    return metadata["command"].replace(f"{GONE} 0 ", "")


def recipe_of(metadata: dict) -> tuple[str, str] | None:
    """The name of the recipe, and its variant, one of whose trainings made a policy."""
    made = _words(shlex.split(metadata["command"])[1:])
    for name, file in shipped().items():
        recipe = read_recipe(file)
        for variant, options in recipe.variants.items():
            program, *words = shlex.split(filled(recipe.commands[0], {"options": options}))
            if program == "landing-train" and metadata["seed"] in recipe.seeds and _words(words) == made:
                return name, variant
    return None


ONCE_DEFAULT = {("--nominal",), ("--history", "0")}  # said since the landing draws vehicles unless told


def _words(words: list[str]) -> set[tuple[str, ...]]:
    """Options with their values, in no order, without those of a run alone."""
    groups: list[tuple[str, ...]] = []
    for word in words:
        if word.startswith("--") or not groups:
            groups.append((word,))
        else:
            groups[-1] += (word,)
    return {group for group in groups if group[0] not in OF_THE_RUN and group not in ONCE_DEFAULT}


def _recipe(name: str, variant: str) -> str:
    recipe = read_recipe(shipped()[name])
    result = recorded(recipe, name)
    rows = []
    for found in result.measured:
        if found.variant == variant:
            number = recipe.numbers[found.number]
            unit = "" if number.unit == "1" else f" {number.unit}"
            each = ", ".join("never" if value is None else f"{value:.4g}" for value in found.values)
            rows.append([number.title, f"{found.mean_words()}{unit}", each])
    seeds = ", ".join(map(str, recipe.seeds))
    return f"The same training with the seeds {seeds} (`{result.command}`):\n\n" + table(
        ["number", "all seeds", "by seed"], rows
    )


if __name__ == "__main__":
    main()
