"""`landing-eval demo`: fly the shipped landing policy, count successes, and make a video and a picture."""

from __future__ import annotations

import contextlib
import io
import sys
import time
from pathlib import Path

import numpy as np

from inclined_landing.eval.base.options import Look, RunFolder, Seed
from inclined_landing.eval.pictures import picture, video
from inclined_landing.eval.replay import command as replay

POLICY = "landing"
STARTS = 50  # random ones
LOOK = Look(width=640, height=360)

_NEXT = """\
What to do next:
  landing-eval success landing    the whole success table (seconds)
  landing-eval --help             contact studies, flight logs, figures ...
  landing-train landing           train a policy in a minute; needs
                                  pip install 'inclined-landing[train]'
In Python:
  import gymnasium, inclined_landing
  env = gymnasium.make("InclinedLanding-v0")"""


def command(out: RunFolder = Path("landing-demo"), seed: Seed = 0) -> None:
    """Fly the shipped landing policy: success table, video, picture and 3D page (half a minute).

    The shipped policy flies in MuJoCo from the paper's three starts and from random ones.

    Args:
        out: new folder for landing.mp4, landing.gif, landing.png, and landing.html, an interactive 3D page.
        seed: seed for the random starts.
    """
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.measures import STRICT, count_words
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.envs.tasks import hover_states
    from inclined_landing.envs.tasks.frozen import PAPER_STARTS
    from inclined_landing.eval.study.engine import Study, View, evaluate
    from inclined_landing.eval.study.flights import table_of
    from inclined_landing.eval.study.show import show

    began = time.monotonic()
    policy = load_policy(POLICY)
    task = policy.task
    drawn = task.sample(np.random.default_rng(seed), STARTS).state
    states = np.concatenate([hover_states(PAPER_STARTS, task.vehicle), drawn])
    print(f"flying the policy '{POLICY}' from {len(states)} starts ...", file=sys.stderr)
    flights = record_flights(policy, "mujoco", states, steps=task.judged_steps)
    table = table_of(task, flights)
    names = np.where(np.arange(len(flights)) < len(PAPER_STARTS), "the paper's three", f"random, seed {seed}")
    views = [View(("starts",), task.measures, "success"), View((), task.measures)]
    study = Study(name="demo", title=f"Policy {POLICY}", cases=(), views=views)
    results = evaluate(study, table.assign(starts=names))
    show([results])
    print("filming the paper's three starts ...", file=sys.stderr)
    points = tuple(",".join(f"{axis:g}" for axis in point) for point in PAPER_STARTS)
    with runs.staged_run(out) as folder:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            video.command(POLICY, out=folder / "landing.mp4", start=points, look=LOOK, gif=True)
            picture.command(POLICY, out=folder / "landing.png", start=points[0], look=LOOK)
            replay.command((POLICY,), out=folder / "landing.html", start=points)
        names = sorted(path.name for path in folder.iterdir())
    seconds = time.monotonic() - began
    print(f"{out}: {', '.join(names)}, written in {seconds:.0f} s\n\n{_NEXT}\n")
    landed = count_words(results.one(STRICT, starts=None))
    say(f"The policy {STRICT.said} in {landed}; open {out / 'landing.html'} in a browser.")
