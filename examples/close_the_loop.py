"""From flights that disagree with the model to a policy that lands the vehicle as it is.

    python examples/close_the_loop.py DIR [--seed N] [--simulated]

Without --simulated the flights are the bundled ones, which a separate program made; with it, a simulated
Crazyflie is identified, changed, flown, diagnosed, flown by plan and landed again. Every step is a command as a
user types it. Policies are tested on the vehicle as it is, which no other step reads: DIR/flights/truth.toml or
DIR/changed.toml. Results are printed at the end and written to DIR/loop.json, the picture to DIR/loop.png.
Needs the extras train and, with --simulated, fly.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle, write_vehicle

# A Crazyflie that differs from the shipped model, and what happens to it afterwards: worn propellers, and a
# ground effect that the model lacks.
MINE = {"rotor_drag": {"lateral": 1.6, "axial": 1.0}, "attitude_time_constant": {"scale": 1.2}}
CHANGE = {"thrust_scale": {"scale": 0.85}, "ground_effect": {"strength": 6.0, "fading": 3.0}}
LANDINGS = 12  # of the simulated Crazyflie, before and after, from the paper's three starts in turn

POLICY = "landing-nominal"


def main() -> None:
    """Go around once, into a new folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="seed of the training and of the simulated flights")
    parser.add_argument("--simulated", action="store_true", help="fly a simulated Crazyflie")
    given = parser.parse_args()
    given.out.mkdir(parents=True)
    loop = Loop(given.out, given.seed)
    loop.fly_simulated() if given.simulated else loop.use_bundled_flights()
    loop.finish()


class Loop:
    """One loop: its folder and seed, and the commands and results so far."""

    def __init__(self, out: Path, seed: int):
        self.out, self.seed = out, seed
        self.steps: list[dict] = []
        self.results: dict = {}

    def use_bundled_flights(self) -> None:
        """Twenty flights of a separate simulator, in which three effects are hidden."""
        flights = self.out / "flights"
        self.run("landing-eval", "gap-example", "--out", flights)
        heldout = sorted((flights / "heldout").glob("*.csv"))
        self.run("landing-eval", "gap", *sorted((flights / "fit").glob("*.csv")), "--heldout", *heldout,
                 "--out", self.out / "report")  # fmt: skip
        self.teach(flights / "truth.toml")

    def fly_simulated(self) -> None:
        """Identify a simulated Crazyflie, change it, find the change in a landing and a planned flight."""
        out = self.out
        mine = apply(load_vehicle(), MINE)
        write_vehicle(out / "mine.toml", mine)
        write_vehicle(out / "changed.toml", apply(mine, CHANGE))
        # Seeds of the flights: another one for every command, and none that another run of this script uses.
        seed = 10 * self.seed
        self.fly(POLICY, "mine.toml", seed, "healthy", flights=6)
        self.run("landing-eval", "identify", *self.logs("healthy"), "--platform", "--out", out / "identified")
        reference = ("--vehicle", out / "identified" / "vehicle.toml", "--platform")
        self.fly(POLICY, "changed.toml", seed + 1, "first")
        self.run("landing-eval", "gap", *self.logs("first"), *reference, "--out", out / "first_report")
        self.run("landing-eval", "plan", out / "first_report", "--out", out / "plan")
        if (out / "plan" / "flight.csv").exists():  # otherwise no flight would help
            plan = ("--plan", out / "plan" / "flight.csv")
            self.fly(None, "changed.toml", seed + 2, "planned", *plan)
        self.run("landing-eval", "gap", *self.logs("first"), *self.logs("planned"), *reference,
                 "--out", out / "report")  # fmt: skip
        taught = self.teach(out / "changed.toml")
        before = self.fly(POLICY, "changed.toml", seed + 3, "before", flights=LANDINGS)
        after = self.fly(taught, "changed.toml", seed + 3, "after", flights=LANDINGS)
        self.results["landings"] = {"before": clean(before), "after": clean(after), "of": LANDINGS}
        first = json.loads((out / "first_report" / "report.json").read_text("utf-8"))
        self.results["named after one landing"] = named(first)

    def teach(self, truth: Path) -> Path:
        """Retrain the policy on the corrected vehicle; fly both policies on the vehicle as it is."""
        policy = self.out / "policy"
        self.run("landing-train", "landing", "--nominal", "--from", POLICY, "--no-report", "--seed", self.seed,
                 "--vehicle", self.out / "report" / "vehicle.toml", "--out", policy)  # fmt: skip
        self.run("landing-eval", "success", f"before={POLICY}", f"after={policy}", "--vehicle", truth,
                 "--plant", "hybrid", "--out", self.out / "success")  # fmt: skip
        return policy

    def fly(self, policy: Path | str | None, vehicle: str, seed: int, name: str, *more, flights: int = 1) -> list[dict]:
        """Fly the simulated Crazyflie; return the flights as in fly.json."""
        what = () if policy is None else (policy,)
        self.run("landing-eval", "fly", *what, *more, "--simulated", "--vehicle", self.out / vehicle,
                 "--flights", flights, "--seed", seed, "--out", self.out / name, may_fail=True)  # fmt: skip
        return json.loads((self.out / name / "fly.json").read_text("utf-8"))["flights"]

    def logs(self, name: str) -> list[Path]:
        """Return the logs in a folder of flights, if it exists."""
        return sorted((self.out / name).glob("flight_*.csv"))

    def run(self, *words: object, may_fail: bool = False) -> None:
        """Run a command of this installation, and keep it with its processor time."""
        typed = [str(word) for word in words]
        print("\n$ " + shlex.join(typed), flush=True)
        began = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([str(Path(sys.executable).parent / typed[0]), *typed[1:]], check=False)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = used.ru_utime - began.ru_utime + used.ru_stime - began.ru_stime
        self.steps.append({"command": shlex.join(typed), "cpu_seconds": round(seconds, 1)})
        if done.returncode and not may_fail:
            sys.exit(f"{typed[0]} {typed[1]} ended with {done.returncode}")

    def finish(self) -> None:
        """Print and write the results, and draw them."""
        report = json.loads((self.out / "report" / "report.json").read_text("utf-8"))
        error = report["gap"]["analytic"]
        success = next((self.out / "success").glob("success*.json"))
        print(success)


def clean(flights: list[dict]) -> int:
    """Return how many flights reached the goal box without touching the platform before."""
    return sum(flight["landed"] and not flight["touched"] for flight in flights)


def named(report: dict) -> dict:
    """Return the named effects with probability and sizes."""
    return {
        effect["name"]: {
            "probability": effect["probability"],
            **{key: [value["value"], *value["ci95"]] for key, value in effect["parameters"].items()},
        }
        for effect in report["effects"]
    }


if __name__ == "__main__":
    main()
