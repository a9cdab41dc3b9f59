"""From flights that disagree with the model to a policy that lands the true vehicle.

    python examples/close_the_loop.py DIR [--seed N] [--simulated]

Without --simulated the flights are the bundled ones from a separate simulator. With it, a simulated
Crazyflie is identified, flown with worn propellers, diagnosed and landed by the retrained policy; then a
planned flight determines what a landing does not show. Every step is a command that a user could type.
Policies are tested on the true vehicle, DIR/flights/truth.toml or DIR/truth.toml, which diagnosis and
training never read. Results are printed at the end and written to DIR/loop.json, the picture to DIR/loop.png.
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

from inclined_landing.eval.base import colours, style
from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle, write_vehicle

# A Crazyflie that differs from the shipped model, what wears it, and what another one carries.
MINE = {"rotor_drag": {"lateral": 1.6, "axial": 1.0}, "attitude_time_constant": {"scale": 1.2}}
WORN = {"thrust_scale": {"scale": 0.85}}
CARRIED = {"body_drag": {"coefficient": 0.006}}
LANDINGS = 6  # of the simulated Crazyflie, before and after, from the paper's three starts in turn

POLICY = "landing-nominal"


def main() -> None:
    """Run the loop once, in a new folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the training and of the simulated flights"
    )
    parser.add_argument("--simulated", action="store_true", help="fly a simulated Crazyflie")
    given = parser.parse_args()
    given.out.mkdir(parents=True)
    loop = Loop(given.out, given.seed)
    if given.simulated:
        loop.fly_simulated()
        loop.plan()
    else:
        loop.use_bundled_flights()
    loop.finish()


class Loop:
    """One loop: its folder and seed, and the commands and results so far."""

    def __init__(self, out: Path, seed: int):
        self.out, self.seed = out, seed
        self.steps: list[dict] = []
        self.results: dict = {}

    def use_bundled_flights(self) -> None:
        """Use twenty flights of a separate simulator, in which three effects are hidden."""
        flights = self.out / "flights"
        self.run("landing-eval", "gap-example", "--out", flights)
        heldout = sorted((flights / "heldout").glob("*.csv"))
        self.run("landing-eval", "gap", *sorted((flights / "fit").glob("*.csv")), "--heldout", *heldout,
                 "--out", self.out / "report")  # fmt: skip
        self.teach(flights / "truth.toml")

    def fly_simulated(self) -> None:
        """Identify a simulated Crazyflie, diagnose worn propellers from three landings, and retrain."""
        out, seed = self.out, 10 * self.seed  # the flights of every command have a seed of their own
        mine = apply(load_vehicle(), MINE)
        write_vehicle(out / "mine.toml", mine)
        write_vehicle(out / "truth.toml", apply(mine, WORN))
        self.fly(POLICY, "mine.toml", seed, "healthy", flights=6)
        self.run("landing-eval", "identify", *self.logs("healthy"), "--platform", "--out", out / "identified")
        self.fly(POLICY, "truth.toml", seed + 1, "worn", flights=3)
        self.diagnose("worn", out="report")
        taught = self.teach(out / "truth.toml")
        before = self.fly(POLICY, "truth.toml", seed + 2, "before", flights=LANDINGS)
        # The platform as identified, for which the policy was trained.
        arena = ("--arena", out / "report" / "vehicle.toml")
        after = self.fly(taught, "truth.toml", seed + 2, "after", *arena, flights=LANDINGS)
        self.results["landings"] = {"before": clean(before), "after": clean(after), "of": LANDINGS}

    def plan(self) -> None:
        """Fly a planned flight to confirm what is in doubt after one landing: the drag of a payload."""
        out, seed = self.out, 10 * self.seed
        write_vehicle(out / "carrying.toml", apply(apply(load_vehicle(), MINE), CARRIED))
        self.fly(POLICY, "carrying.toml", seed + 3, "first")
        self.diagnose("first", out="first_report")
        self.run("landing-eval", "plan", out / "first_report", "--out", out / "plan")
        plan = out / "plan" / "flight.csv"
        if plan.exists():  # otherwise no flight would help
            self.fly(None, "carrying.toml", seed + 4, "planned", "--plan", plan)
            self.diagnose("first", "planned", out="planned_report")
        for path in sorted(out.glob("*_report/report.json")):
            report = json.loads(path.read_text("utf-8"))
            sets = (one["probability"] for one in report["sets"] if "body_drag" in one["effects"])
            self.results[path.parent.name] = {"named": named(report), "probability of body_drag": sum(sets)}

    def diagnose(self, *names: str, out: str) -> None:
        """Name the effects in these flights that the identified vehicle lacks."""
        logs = [log for name in names for log in self.logs(name)]
        vehicle = self.out / "identified" / "vehicle.toml"
        self.run("landing-eval", "gap", *logs, "--vehicle", vehicle, "--platform", "--out", self.out / out)

    def teach(self, truth: Path) -> Path:
        """Retrain the policy on the corrected vehicle; fly both policies on the true vehicle."""
        policy = self.out / "policy"
        corrected = self.out / "report" / "vehicle.toml"
        self.run("landing-train", "landing", "--nominal", "--from", POLICY, "--vehicle", corrected,
                 "--seed", self.seed, "--no-report", "--out", policy)  # fmt: skip
        self.run("landing-eval", "success", f"before={POLICY}", f"after={policy}", "--vehicle", truth,
                 "--plant", "hybrid", "--out", self.out / "success")  # fmt: skip
        return policy

    def fly(
        self, policy: Path | str | None, vehicle: str, seed: int, name: str, *more, flights: int = 1
    ) -> list[dict]:
        """Fly the simulated Crazyflie; return the flights as in fly.json."""
        what = () if policy is None else (policy,)
        self.run("landing-eval", "fly", *what, *more, "--simulated", "--vehicle", self.out / vehicle,
                 "--flights", flights, "--seed", seed, "--out", self.out / name, may_fail=True)  # fmt: skip
        return json.loads((self.out / name / "fly.json").read_text("utf-8"))["flights"]

    def logs(self, name: str) -> list[Path]:
        """Return the logs in a folder of flights."""
        return sorted((self.out / name).glob("flight_*.csv"))

    def run(self, *words: object, may_fail: bool = False) -> None:
        """Run a command of this installation, and record it with its processor time."""
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
        """Print the results, write them to loop.json and draw them."""
        report = json.loads((self.out / "report" / "report.json").read_text("utf-8"))
        rows = json.loads((self.out / "success" / "success.json").read_text("utf-8"))["rows"]
        grid = [row for row in rows if (row["starts"], row["measure"]) == ("frozen grid", "strict")]
        success = {
            row["policy"]: {key: row[key] for key in ("count", "flights", "value", "low", "high")}
            for row in grid
        }
        error = {key: report["gap"]["analytic"][key] for key in ("before", "after", "floor")}
        seconds = sum(step["cpu_seconds"] for step in self.steps)
        self.results |= {"seed": self.seed, "named": named(report), "error": error, "success": success,
                         "cpu_seconds": round(seconds), "steps": self.steps}  # fmt: skip
        (self.out / "loop.json").write_text(json.dumps(self.results, indent=2) + "\n", "utf-8")
        draw(success, error, self.out / "loop.png")

        print()
        for name, effect in self.results["named"].items():
            sizes = (
                f"{key} {size:.3g} [{low:.3g}, {high:.3g}]"
                for key, (size, low, high) in effect["sizes"].items()
            )
            print(f"named: {name}, {'sure' if effect['sure'] else 'possible'} ({', '.join(sizes)})")
        print(
            f"position error one second ahead: {100 * error['before']:.1f} to {100 * error['after']:.1f} cm"
        )
        before, after = (f"{row['count']} of {row['flights']}" for row in success.values())
        print(f"goal box without a touch, on the true vehicle: {before} before, {after} after")
        if landings := self.results.get("landings"):
            counts = f"{landings['before']} before, {landings['after']} after, of {landings['of']}"
            print(f"the same in flights of the simulated Crazyflie: {counts}")
        for name in ("first_report", "planned_report"):
            if report := self.results.get(name):
                print(f"{name}: body drag {report['probability of body_drag']:.0%}")
        print(f"{seconds:.0f} s of processor time; the picture is {self.out / 'loop.png'}")


def draw(success: dict, error: dict, path: Path) -> None:
    """Draw success on the true vehicle, and the error of the model, before and after."""
    with plt.rc_context(style.STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(6.4, 2.6), layout="constrained")
        names, two = ("before", "after"), (colours.ORANGE, colours.BLUE)
        rows = [success[name] for name in names]
        share = [100 * row["value"] for row in rows]
        ends = [
            [100 * (row["value"] - row["low"]) for row in rows],
            [100 * (row["high"] - row["value"]) for row in rows],
        ]
        bars = left.bar(names, share, yerr=ends, color=two, width=0.55, capsize=4, ecolor=colours.INK)
        left.bar_label(
            bars, [f"{row['count']} of {row['flights']}" for row in rows], label_type="center", color="white"
        )
        left.set(
            ylabel="starts that reach the goal box [%]", ylim=(0, 105), title="Policy on the true vehicle"
        )
        lengths = [100 * error[name] for name in names]
        bars = right.bar(names, lengths, color=two, width=0.55)
        right.bar_label(bars, [f"{length:.1f} cm" for length in lengths], padding=2)
        right.axhline(100 * error["floor"], color=colours.MUTED, linewidth=1, linestyle="--")
        right.set(
            ylabel="position error after 1 s [cm]", ylim=(0, 1.15 * lengths[0]), title="Model on the flights"
        )
        figure.savefig(path, dpi=style.PNG_DPI)


def clean(flights: list[dict]) -> int:
    """Return how many flights reached the goal box without touching the platform before."""
    return sum(flight["landed"] and not flight["touched"] for flight in flights)


def named(report: dict) -> dict:
    """Return the named effects with their probabilities and sizes (value and 95 % interval)."""
    return {
        effect["name"]: {
            "probability": effect["probability"],
            "sure": effect["sure"],
            "sizes": {key: (size["value"], *size["ci95"]) for key, size in effect["parameters"].items()},
        }
        for effect in report["effects"]
    }


if __name__ == "__main__":
    main()
