"""`landing-eval`: the command line of the evaluation floor.

Each command is a function here: its signature and docstring are the options and the help, its body
imports what it needs, so that `--help` stays fast. To add one, write it and list it in COMMANDS.
Wrong input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.models.errors import UserError

PolicyFile = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
Plant = Annotated[str, tyro.conf.arg(metavar="{mujoco,analytic}")]
TaskName = Annotated[str | None, tyro.conf.arg(metavar="{landing,setpoint}")]


def success(
    policy: PolicyFile,
    /,
    task: TaskName = None,
    plant: Plant = "mujoco",
    thrust_scale: tyro.conf.UseAppendAction[tuple[float, ...]] = (),
    inclination: float | None = None,
    vehicle: Path | None = None,
    seed: int = 0,
    json: bool = False,
    out: Path | None = None,
) -> None:
    """Success table of a policy: how often, how fast and how hard it reaches its goal.

    Args:
        policy: policy file, or the name of a shipped policy (landing, setpoint).
        task: the task the policy must be for; needed for a plain Stable-Baselines3 file.
        plant: the physics to fly in.
        thrust_scale: total thrust times this; repeat the option for one row each (default 1).
        inclination: of the platform in degrees, where it differs from the training's.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        seed: of the random starts.
        json: print JSON, and nothing else, on standard output.
        out: new folder for success.json and flights.csv.
    """
    from inclined_landing.eval import success

    success.run(
        policy,
        task=task,
        plant=plant,
        thrust_scale=thrust_scale or (1.0,),
        inclination=inclination,
        vehicle=vehicle,
        seed=seed,
        json=json,
        out=out,
    )


COMMANDS = {"success": success}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    try:
        code = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="landing-eval",
            description="Evaluate policies: success tables, pictures, benchmarks.",
            args=arguments,
        )
    except UserError as error:
        return _fail(str(error), 2)
    except ImportError as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    return code or 0


def _fail(sentence: str, code: int) -> int:
    print(f"landing-eval: {sentence}", file=sys.stderr)
    return code
