"""From failing flights to landings: fly, read the logs, correct the model, train, export, fly again.

    python examples/close_the_loop.py DIR [--seed N]

A simulated Crazyflie takes the place of a real one. Its gap is in DIR/hidden.toml, which only `fly` reads;
the other steps only see the flight logs. Every step is a command as a user types it. Results are printed at
the end and written to DIR/loop.json; docs/evidence/teaching.md has those of three seeds. Needs the extras
train and fly.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from pathlib import Path

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle, write_vehicle

# The thrust of worn propellers, and commands that arrive 50 ms late: the shipped policy fails with them.
HIDDEN = {"thrust_scale": {"scale": 0.85}, "attitude_delay": {"delay": 0.05}}
BEFORE, AFTER = 12, 30  # flights, from the paper's three starts in turn


def main() -> None:
    """Run all steps into a new folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    out: Path = given.out
    out.mkdir(parents=True)
    hidden, seed = out / "hidden.toml", given.seed
    write_vehicle(hidden, apply(load_vehicle(), HIDDEN))
    simulated = ("--simulated", "--vehicle", str(hidden))
    policy = str(out / "policy" / "final.zip")
    steps: list[tuple[str, float]] = []

    def run(*words: str, may_fail: bool = False) -> None:
        print("\n$ " + shlex.join(words), flush=True)
        began = time.monotonic()
        done = subprocess.run([str(Path(sys.executable).parent / words[0]), *words[1:]], check=False)
        steps.append((shlex.join(words), time.monotonic() - began))
        if done.returncode and not may_fail:
            sys.exit(f"{words[0]} {words[1]} ended with {done.returncode}")

    def fly(name: str, what: str, flights: int, number: int) -> list[dict]:
        folder = out / name
        run(
            *("landing-eval", "fly", what, *simulated, "--flights", str(flights)),
            *("--seed", str(number), "--out", str(folder)),
            may_fail=True,
        )
        return json.loads((folder / "fly.json").read_text("utf-8"))["flights"]

    before = fly("before", "landing-nominal", BEFORE, seed)
    logs = sorted(map(str, (out / "before").glob("flight_*.csv")))
    run("landing-eval", "gap", *logs, "--platform", "--out", str(out / "report"))
    corrected = str(out / "report" / "vehicle.toml")
    run(
        *("landing-train", "landing", "--vehicle", corrected, "--nominal", "--from", "landing-nominal"),
        *("--seed", str(seed), "--out", str(out / "policy"), "--no-report"),
    )
    run("landing-eval", "export", policy, "--format", "c", "--out", str(out / "export"))
    again = fly("again", "landing-nominal", AFTER, seed + 1)
    after = fly("after", policy, AFTER, seed + 1)

    diagnosis = json.loads((out / "report" / "report.json").read_text("utf-8"))
    result = {
        "hidden": HIDDEN,
        "named": {effect["name"]: effect["probability"] for effect in diagnosis["effects"]},
        "steps": [{"command": command, "seconds": seconds} for command, seconds in steps],
        "flown for the logs": shares(before),
        "shipped policy, new seeds": shares(again),
        "trained policy, the same seeds": shares(after),
    }
    (out / "loop.json").write_text(json.dumps(result, indent=2) + "\n", "utf-8")
    print("\nnamed: " + ", ".join(f"{name} ({p:.0%})" for name, p in result["named"].items()))
    for words in ("flown for the logs", "shipped policy, new seeds", "trained policy, the same seeds"):
        cells = (f"{what} {row['count']} of {row['of']}" for what, row in result[words].items())
        print(f"{words}: {', '.join(cells)}")
    print(f"{sum(seconds for _, seconds in steps):.0f} s in total")


def shares(flights: list[dict]) -> dict[str, dict]:
    """Return the shares in the goal box, without an early touch, and at rest, of flights as in fly.json."""
    goal = [flight["landed"] for flight in flights]
    return {
        "in the goal box": proportion(sum(goal), len(flights)),
        "without an early touch": proportion(
            sum(landed and not flight["touched"] for landed, flight in zip(goal, flights)), len(flights)
        ),
        "at rest on the slope": proportion(sum(bool(flight["rests"]) for flight in flights), len(flights)),
    }


if __name__ == "__main__":
    main()
