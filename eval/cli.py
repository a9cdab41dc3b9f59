"""`landing-eval`: the command line of the evaluation floor.

Each command is a function here: its signature and docstring are the options and the help, its body
imports what it needs, so that `--help` stays fast. To add one, write it and list it in COMMANDS.
Wrong input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import io
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.models.errors import UserError

PolicyFile = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
PlantName = Annotated[str, tyro.conf.arg(metavar="{mujoco,analytic}")]
TaskName = Annotated[str | None, tyro.conf.arg(metavar="{landing,setpoint,touchdown}")]
Degrees = Annotated[float | None, tyro.conf.arg(metavar="DEG")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
OutFolder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
OutFile = Annotated[Path, tyro.conf.arg(metavar="FILE")]
Starts = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Z")]
Camera = Annotated[str, tyro.conf.arg(metavar="{side,hero,pad,track,chase,closeup,onboard}")]
Backend = Annotated[str, tyro.conf.arg(metavar="{auto,ray,gl}")]
LogFiles = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
EffectNames = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")]
Mapping = Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")]
Units = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="COLUMN=UNIT")]
Flag = tyro.conf.FlagCreatePairsOff[bool]
Scales = Annotated[
    tuple[tuple[float, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]


def success(
    policy: PolicyFile,
    /,
    task: TaskName = None,
    plant: PlantName = "mujoco",
    thrust_scale: Scales = (),
    inclination: Degrees = None,
    vehicle: File = None,
    effects: Flag = False,
    seed: int = 0,
    json: Flag = False,
    out: Folder = None,
) -> None:
    """Success table of a policy: how often, how fast and how hard it reaches its goal.

    Args:
        policy: policy file, or the name of a shipped policy (landing, setpoint, touchdown).
        task: the task the policy must be for; needed for a plain Stable-Baselines3 file.
        plant: the physics to fly in.
        thrust_scale: total thrust times this, one row for each value (default: 1).
        inclination: of the platform in degrees, where it differs from the training's.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        effects: one row for every physical effect of the library at a plausible size, which the policy
            knows nothing of; from the frozen grid only (four minutes).
        seed: of the random starts.
        json: print JSON, and nothing else, on standard output.
        out: new folder for success.json and (without effects) flights.csv.
    """
    from inclined_landing.eval.policies import success

    success.run(
        policy,
        task=task,
        plant=plant,
        thrust_scale=tuple(itertools.chain(*thrust_scale)) or (1.0,),
        inclination=inclination,
        vehicle=vehicle,
        effects=effects,
        seed=seed,
        json=json,
        out=out,
    )


def touchdown(
    policy: PolicyFile,
    /,
    baseline: Annotated[str, tyro.conf.arg(metavar="POLICY")] = "landing",
    friction: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MU [MU ...]")] = (0.55, 0.6, 0.8, 1.2),
    restitution: Annotated[tuple[float, ...], tyro.conf.arg(metavar="E [E ...]")] = (0.0, 0.25, 0.5),
    json: Flag = False,
    out: Folder = None,
) -> None:
    """Touchdown policy against a landing policy whose motors are cut in the goal box (a minute or two).

    Args:
        policy: touchdown policy file, or the shipped one (touchdown).
        baseline: landing policy file, or the shipped one (landing).
        friction: between feet and slope.
        restitution: of the feet on the slope, 0 to 0.6.
        json: print JSON, and nothing else, on standard output.
        out: new folder for touchdown.json.
    """
    from inclined_landing.eval.policies import touchdown

    touchdown.run(policy, baseline, friction=friction, restitution=restitution, json=json, out=out)


def doctor(json: Flag = False) -> int:
    """What is installed, what is missing, and what to do about it (exit code 2 if it matters).

    Args:
        json: print JSON, and nothing else, on standard output.
    """
    from inclined_landing.eval.machine import doctor

    return doctor.run(json=json)


def benchmark(
    policy: Annotated[str | None, tyro.conf.arg(metavar="POLICY")] = None,
    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DIR [DIR ...]")] = (),
    quick: Flag = False,
    training: bool = True,
    seed: int = 0,
    json: Flag = False,
    out: Folder = None,
) -> None:
    """What a step, an action, a picture and a training cost on this machine (a few minutes).

    Args:
        policy: landing policy for the latency (default: an untrained one of the usual size).
        runs: finished landing-train folders, for the time to 99 % success.
        quick: fewer repeats, under a minute.
        training: measure training speed against SB3's defaults on one plain environment.
        seed: of actions and trainings.
        json: print JSON, and nothing else, on standard output.
        out: new folder for benchmark.json.
    """
    from inclined_landing.eval.machine import benchmark

    benchmark.run(
        policy=policy,
        finished=runs,
        quick=quick,
        training=training,
        seed=seed,
        json=json,
        out=out,
    )


def figure(
    policy: PolicyFile,
    /,
    out: OutFolder,
    start: Starts = (),
    task: TaskName = None,
    plant: PlantName = "mujoco",
    inclination: Degrees = None,
) -> None:
    """Stroboscopic trajectory with PWM and pitch over time, as PNG and PDF.

    Args:
        policy: policy file, or the name of a shipped policy (landing, setpoint, touchdown).
        out: folder for the files.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z; repeat the option for
            more figures. Default: the paper's two cases, 1.5,1.8 and 0,2.
        task: the task the policy must be for; needed for a plain Stable-Baselines3 file.
        plant: the physics to fly in.
        inclination: of the platform in degrees, where it differs from the training's.
    """
    from inclined_landing.eval.pictures import commands as pictures

    files = pictures.figure(policy, out, start, task=task, plant=plant, inclination=inclination)
    print(*files, sep="\n")


def video(
    policy: PolicyFile,
    /,
    out: OutFile,
    start: Starts = (),
    camera: Camera = "hero",
    gif: Flag = False,
    width: int = 960,
    height: int = 540,
    backend: Backend = "auto",
    slow: float = 1.0,
    forces: Flag = False,
    task: TaskName = None,
    plant: PlantName = "mujoco",
    inclination: Degrees = None,
) -> None:
    """Video of flights, one after the other.

    Args:
        policy: policy file, or the name of a shipped policy (landing, setpoint, touchdown).
        out: .mp4 or .gif file.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z; repeat the option for
            more flights.
        camera: where to look from.
        gif: write a .gif beside the .mp4.
        width: of the video, pixels.
        height: of the video, pixels.
        backend: OpenGL, ray casting, or OpenGL only where it runs on hardware.
        slow: 2 plays at half speed.
        forces: film the touchdowns only, at the engine's steps, with the contact forces as arrows. A landing
            policy's motors are cut in the goal box. Goes with --slow 16 and --camera touch, a fixed look at
            the touchdown from nearby.
        task: the task the policy must be for; needed for a plain Stable-Baselines3 file.
        plant: the physics to fly in.
        inclination: of the platform in degrees, where it differs from the training's.
    """
    from inclined_landing.eval.pictures import commands as pictures

    flown = {"task": task, "plant": plant, "inclination": inclination}
    look = {"camera": camera, "width": width, "height": height, "backend": backend}
    files = pictures.video(policy, out, start, gif=gif, slow=slow, forces=forces, **look, **flown)
    print(*files, sep="\n")


def picture(
    policy: PolicyFile,
    /,
    out: OutFile,
    start: Annotated[str | None, tyro.conf.arg(metavar="X,Z")] = None,
    camera: Camera = "hero",
    width: int = 1280,
    height: int = 720,
    backend: Backend = "auto",
    task: TaskName = None,
    plant: PlantName = "mujoco",
    inclination: Degrees = None,
) -> None:
    """One picture of a whole flight: copies of the vehicle along its way.

    Args:
        policy: policy file, or the name of a shipped policy (landing, setpoint, touchdown).
        out: .png file.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z.
        camera: where to look from.
        width: of the picture, pixels.
        height: of the picture, pixels.
        backend: OpenGL, ray casting, or OpenGL only where it runs on hardware.
        task: the task the policy must be for; needed for a plain Stable-Baselines3 file.
        plant: the physics to fly in.
        inclination: of the platform in degrees, where it differs from the training's.
    """
    from inclined_landing.eval.pictures import commands as pictures

    flown = {"task": task, "plant": plant, "inclination": inclination}
    look = {"camera": camera, "width": width, "height": height, "backend": backend}
    print(pictures.picture(policy, out, start, **look, **flown))


def curves(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR [DIR ...]")],
    /,
    out: OutFile,
) -> None:
    """Learning curves of training runs of one task, several seeds with median and range.

    Args:
        runs: run folders of landing-train.
        out: .png or .pdf file.
    """
    from inclined_landing.eval.pictures import commands as pictures

    print(pictures.curves(runs, out))


def contact(
    study: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY.toml")],
    /,
    out: OutFolder,
    engine: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    resume: Flag = False,
) -> None:
    """Landing study: thousands of touchdowns over friction, speeds, attitude ..., each classified.

    Args:
        study: study file, or the name of a shipped study (paper_landing, steep_landing).
        out: new folder for results (Parquet), summary (JSON), figures (PNG) and page (HTML).
        engine: run in this process, or on a Ray cluster.
        address: of a running Ray cluster; without it, Ray is started on this machine.
        resume: go on with the study that was interrupted in this folder.
    """
    from inclined_landing.eval.landings import run

    run.run(study, out, engine=engine, address=address, resume=resume)


def equivalence(
    out: OutFolder,
    policy: Annotated[str, tyro.conf.arg(metavar="POLICY")] = "landing",
    seed: int = 0,
    quick: Flag = False,
) -> int:
    """Is the MuJoCo vehicle the paper's model? One page of claims with tolerances (exit code 1 if one fails).

    Args:
        out: new folder for report.html, report.json and the figures.
        policy: landing policy for recorded commands and closed loops: a file, or a shipped one.
        seed: of commands and states.
        quick: fewer commands, states and starts.
    """
    from inclined_landing.eval.truth.equivalence import report

    return report.run(policy, out, seed=seed, quick=quick)


def contact_truth(
    out: OutFolder,
    flights: Folder = None,
    friction: float | None = None,
    restitution: float | None = None,
    contact_time: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
) -> None:
    """Can contact be believed? Rest, slip, drops, impulses, energy ... measured, as page and figures.

    Args:
        out: new folder for contact.html, contact.json and the figures.
        flights: folder of measured NanoBench flights (nb_*.csv.gz): their touchdowns are simulated and the
            contact setting is fitted.
        friction: of a setting of your own, measured besides the default.
        restitution: of your own setting, 0 to 0.6; together with the contact time.
        contact_time: of your own setting in seconds, 0.012 to 0.02.
    """
    from inclined_landing.eval.truth.contact_truth import report

    report.run(out, flights, friction=friction, restitution=restitution, contact_time=contact_time)


def logs(
    files: LogFiles,
    /,
    mapping: Mapping = None,
    unit: Units = (),
    json: Flag = False,
) -> None:
    """What flight logs hold and whether they can be believed, in words (exit code 2 where refused).

    Args:
        files: CSV (.csv, .csv.gz), Crazyflie micro-SD binary or ROS bag; several files of one flight
            as A+B.
        mapping: shipped mapping or mapping file (TOML), where the column names do not tell.
        unit: of a column that states none, roll=deg for example; repeat the option for more.
        json: print JSON, and nothing else, on standard output.
    """
    from inclined_landing.eval.logs import command

    command.run(files, mapping=mapping, units=unit, json=json)


def gap(
    files: LogFiles,
    /,
    out: OutFolder,
    heldout: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = (),
    vehicle: File = None,
    mapping: Mapping = None,
    unit: Units = (),
    platform: Flag = False,
) -> None:
    """Where simulation and flights disagree, which effect is missing, and the corrected model (seconds).

    Args:
        files: flights to fit: CSV (.csv, .csv.gz), Crazyflie micro-SD binary or ROS bag; several files of
            one flight as A+B.
        out: new folder for report.html, report.json, gap.png, vehicle.toml and landing.xml.
        heldout: flights only judged on; without them each flight is judged with the others fitted.
        vehicle: vehicle file (TOML), where the model differs from the shipped one.
        mapping: shipped mapping or mapping file (TOML), where the column names do not tell.
        unit: of a column that states none, roll=deg for example; repeat the option for more.
        platform: the slab of the vehicle file stood in the arena (known from logs with contacts).
    """
    from inclined_landing.eval.gap import command as cli

    cli.run(
        files,
        out,
        heldout=heldout,
        vehicle=vehicle,
        mapping=mapping,
        units=unit,
        platform=platform,
    )


def gap_blind(
    out: OutFolder,
    set: Annotated[str, tyro.conf.arg(metavar="{dev,fresh}")] = "dev",
    seed: int = 0,
    cases: int | None = None,
    method: Annotated[tuple[str, ...], tyro.conf.arg(metavar="{workflow,tuning,sparse}")] = ("workflow",),
    keep: Flag = False,
    processes: int = 2,
) -> None:
    """Hidden causes in flights of an independent simulator: what the gap workflow names, counted (minutes).

    Args:
        out: folder for results.json, table.md and report.html; an interrupted run goes on in it.
        set: development (thresholds are chosen on it) or fresh (scored once); they share no seed.
        seed: of the set.
        cases: at most so many, every stratum keeping its share (default: all).
        method: one or more of: the gap workflow, parameter tuning only, sparse regression (needs pysindy).
        keep: keep the flights, some 3 MB a case.
        processes: cases diagnosed at a time.
    """
    from inclined_landing.eval.proof.gap_blind import run

    run.run(set, seed, out, cases=cases, methods=method, keep=keep, processes=processes)


def identify(
    files: LogFiles,
    /,
    out: OutFolder,
    heldout: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = (),
    vehicle: File = None,
    mapping: Mapping = None,
    unit: Units = (),
    platform: Flag = False,
) -> None:
    """Thrust, lags, delays, attitude loops and drag from flights: a vehicle file with intervals (seconds).

    Args:
        files: flights to fit, as for gap.
        out: new folder for vehicle.toml, report.html and report.json.
        heldout: flights for the fit in percent; without them each is judged with the others fitted.
        vehicle: vehicle file (TOML) to start from, where it differs from the shipped one.
        mapping: shipped mapping or mapping file (TOML), where the column names do not tell.
        unit: of a column that states none, roll=deg for example; repeat the option for more.
        platform: the slab of the vehicle file stood in the arena.
    """
    from inclined_landing.eval.gap import command as cli

    cli.identify(files, out, heldout=heldout, vehicle=vehicle, mapping=mapping, units=unit, platform=platform)


def gap_example(out: OutFolder, seed: int = 0) -> None:
    """Twenty flights with hidden effects, from an independent simulator, to try `gap` on.

    Args:
        out: new folder for fit/*.csv and heldout/*.csv.
        seed: of paths and noise.
    """
    from inclined_landing.eval.proof import gap_example as example

    example.run(out, seed)


def gap_real(
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")],
    /,
    out: OutFolder,
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART [PART ...]")] = (),
    vehicle: File = None,
) -> None:
    """Measured flights of others: what is named, how much of the gap closes, how stable it is (minutes).

    Args:
        data: folder of the tidy data sets utias_fmpc, nanobench, crazypad and arp_sysid.
        out: new folder for tables.md, real.json and figures.
        only: some of utias_day1, utias_all, utias_given, nanobench, nanobench_motors, attitude, thrust,
            crazypad, arp_sysid.
        vehicle: vehicle file (TOML), where the model differs from the shipped one.
    """
    from inclined_landing.eval.proof.gap_real import run

    run.run(data, out, only=only, vehicle=vehicle)


def effects(names: EffectNames = (), /) -> None:
    """The physical effects that a model may lack: formula, size, where they show, what to do about them.

    Args:
        names: these in detail (default: all in one table).
    """
    from inclined_landing.eval.gap import effects as module

    module.show(names)


COMMANDS = {
    "success": success,
    "touchdown": touchdown,
    "doctor": doctor,
    "benchmark": benchmark,
    "figure": figure,
    "video": video,
    "picture": picture,
    "curves": curves,
    "equivalence": equivalence,
    "contact": contact,
    "contact-truth": contact_truth,
    "effects": effects,
    "logs": logs,
    "identify": identify,
    "gap": gap,
    "gap-example": gap_example,
    "gap-blind": gap_blind,
    "gap-real": gap_real,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names that are no UTF-8
    try:
        code = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="landing-eval",
            description="Evaluate policies and models: success, pictures, contact, measured flights.",
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
