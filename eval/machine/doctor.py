"""`landing-eval doctor`: versions, plugins, rendering, and a remedy for everything that is missing."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import os
import re
import sys
from collections.abc import Callable

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.options import Flag
from inclined_landing.models import plugins, storage
from inclined_landing.models.errors import shown

_FOR_DEVELOPERS = {"all", "docs", "test", "test-all", "wheel"}  # extras that nothing of the program asks for
_BUILD = "run `make` in the repository, or reinstall the package in this environment"
_MISSING = {True: ("missing", "red"), False: ("-", "yellow")}  # by whether it is needed


@dataclasses.dataclass
class CheckResult:
    """The outcome of one check."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""  # when not ok
    needed: bool = True  # False: the package works without it


def examine() -> list[CheckResult]:
    """Run every check and return what each found."""
    findings = [
        CheckResult("Python", True, f"{sys.version.split()[0]}, {sys.executable}"),
        _tried("packages", _packages, "run `make` in the repository, or pip install inclined-landing"),
        _tried("native plugins", _plugins, _BUILD),
    ]
    if all(finding.ok for finding in findings):
        findings += [
            _tried("simulation", _simulation, _BUILD),
            _tried("rendering", _rendering, "run `make test` for more"),
            _opengl(),
        ]
        named = importlib.metadata.metadata("inclined-landing").get_all("Provides-Extra") or []
        for name in (name for name in named if name not in _FOR_DEVELOPERS):
            missing = ", ".join(_missing(name))
            remedy = f"pip install 'inclined-landing[{name}]'"
            detail = f"missing: {missing}" if missing else "complete"
            findings.append(CheckResult(f"extra {name}", not missing, detail, remedy, needed=False))
    return [*findings, _tried("video encoder", _video, "pip install imageio-ffmpeg")]


def command(*, json: Flag = False) -> int:
    """Check the installation and suggest remedies.

    The exit code is 2 if something required is missing.

    Args:
        json: print only JSON on standard output.
    """
    findings = examine()
    healthy = all(finding.ok or not finding.needed for finding in findings)
    if json:
        report = {
            "command": "doctor",
            "healthy": healthy,
            "versions": runs.versions(),
            "checks": [dataclasses.asdict(finding) for finding in findings],
        }
        print(storage.to_json(report))
    else:
        _show(findings)
    return 0 if healthy else 2


def _tried(name: str, check: Callable[[], tuple[bool, str]], remedy: str) -> CheckResult:
    """Return the text, verdict and details of a check; any exception is a failed check."""
    try:
        return CheckResult(name, *check(), remedy)
    except Exception as error:  # missing GL, say, shows as various errors
        return CheckResult(name, False, (str(error) or type(error).__name__).splitlines()[0], remedy)


def _packages() -> tuple[bool, str]:
    """Return whether the distribution's own requirements are installed, and their versions."""
    if missing := _missing(""):
        return False, f"missing: {', '.join(missing)}"
    return True, ", ".join(f"{name} {version}" for name, version in runs.packages().items() if version)


def _missing(extra: str) -> list[str]:
    """Return packages that an extra ("": the base) asks for and that are not installed."""
    missing = []
    for requirement in importlib.metadata.requires("inclined-landing") or []:
        name, _, condition = requirement.partition(";")
        wanted = re.search(r"extra == ['\"]([\w-]+)", condition)
        if (wanted.group(1) if wanted else "") != extra:
            continue
        name = re.split(r"[^A-Za-z0-9._-]", name.strip())[0]
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    return missing


def _plugins() -> tuple[bool, str]:
    plugins.load()
    status = plugins.loaded()
    names = ", ".join(name.removeprefix("inclined_landing.") for name in status.names)
    complete = set(status.names) == set(plugins.NAMES)
    return complete, f"{names} for MuJoCo {status.built_for}, {status.library}"


def _simulation() -> tuple[bool, str]:
    """Return whether a hovering vehicle stays where it is for a second."""
    import numpy as np

    from inclined_landing.envs.tasks.base import hover_states
    from inclined_landing.models.plants import MujocoPlant

    plant = MujocoPlant(1, threads=1)
    start = hover_states(np.array([[0.0, 0.0, 2.0]]), plant.vehicle)
    plant.reset(np.arange(1), start)
    for _ in range(round(1.0 / plant.control_period)):
        plant.step(np.array([[plant.vehicle.hover_pwm, 0.0, 0.0, 0.0]]))
    drift = float(np.linalg.norm(plant.state[0, :3] - start[0, :3]))
    return drift < 1e-6, f"hovering 1 s drifts {drift:.1e} m"


def _rendering() -> tuple[bool, str]:
    """Return how pictures are rendered; ray casting only needs MuJoCo."""
    from inclined_landing.envs.rendering import make_renderer
    from inclined_landing.envs.rendering.gl import probe

    if probe().hardware:
        return True, "backend auto: OpenGL on hardware"
    with make_renderer(64, 48, backend="ray") as renderer:
        renderer.render(None)
    return True, "backend auto: ray casting on the processor"


def _opengl() -> CheckResult:
    """Return which OpenGL there is; that of MUJOCO_GL, where it is set, must load."""
    import mujoco

    from inclined_landing.envs.rendering.gl import probe

    found, remedy = probe(), "apt install libegl1 libgl1 (or libosmesa6) for --backend gl"
    asked = [name for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM") if os.environ.get(name)]
    ok, detail = True, f"{found.kind}, {'hardware' if found.hardware else 'software'}"
    if not found.kind:
        ok, detail = False, f"none, {found.missing} is missing; pictures are ray-cast"
    if getattr(getattr(mujoco, "GLContext", None), "__name__", "") == "_MissingGLContext":
        named = ", ".join(f"{name}={shown(os.environ[name], 40)}" for name in asked)
        ok, detail = False, f"{named} does not load; {'without it ' * bool(found.kind)}{detail}"
    if asked:
        remedy = f"unset {' and '.join(asked)}, or {remedy}"
    return CheckResult("OpenGL", ok, detail, remedy, needed=False)


def _video() -> tuple[bool, str]:
    import imageio_ffmpeg

    return True, imageio_ffmpeg.get_ffmpeg_exe()


def _show(findings: list[CheckResult]) -> None:
    from rich.text import Text

    table = new_table(None, "", "", "", labels=3)
    table.show_header = False
    for finding in findings:
        state = Text("ok", "green") if finding.ok else Text(*_MISSING[finding.needed])
        table.add_row(state, finding.name, Text(finding.detail, overflow="fold"))
    show_table(table)
    versions = runs.versions()
    say(f"{versions['cpu']}, {versions['cores']} cores, {versions['system']}")
    say(*(f"{finding.name}: {finding.remedy}" for finding in findings if not finding.ok))
    lacking, without = ([f.name for f in findings if not f.ok and f.needed is x] for x in (True, False))
    optional = f" Optional and not installed: {', '.join(without)}." if without else ""
    if lacking:
        say(f"These requirements are missing or broken: {', '.join(lacking)}.{optional}")
    else:
        say(f"All requirements are met.{optional}")
