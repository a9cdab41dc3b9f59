"""`landing-eval doctor`: checks of the installation, with a remedy for everything that is missing."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import re
import sys
from collections.abc import Callable

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Flag
from inclined_landing.models import plugins
from inclined_landing.models.base import storage

_BUILD = "run `make` in the repository, or reinstall the package in this environment"


@dataclasses.dataclass
class CheckResult:
    """The outcome of one check."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""  # when not ok


def examine() -> list[CheckResult]:
    """Run every check and return the results."""
    findings = [
        CheckResult("Python", True, f"{sys.version.split()[0]}, {sys.executable}"),
        _tried("packages", _packages, "run `make` in the repository, or pip install inclined-landing"),
        _tried("native plugins", _plugins, _BUILD),
    ]
    if all(finding.ok for finding in findings):
        findings += [
            _tried("simulation", _simulation, _BUILD),
            _tried("rendering", _rendering, "run `make test` for more"),
            _tried("video encoder", _video, "pip install imageio-ffmpeg"),
        ]
    return findings


def command(*, json: Flag = False) -> int:
    """Check the installation and suggest remedies.

    The exit code is 2 if something is missing.

    Args:
        json: print only JSON on standard output.
    """
    findings = examine()
    healthy = all(finding.ok for finding in findings)
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
    missing = []
    for requirement in importlib.metadata.requires("inclined-landing") or []:
        name, _, condition = requirement.partition(";")
        if "extra ==" in condition:
            continue
        name = re.split(r"[^A-Za-z0-9._-]", name.strip())[0]
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return False, f"missing: {', '.join(missing)}"
    return True, ", ".join(f"{name} {version}" for name, version in runs.packages().items() if version)


def _plugins() -> tuple[bool, str]:
    plugins.load()
    loaded, library, build = plugins.loaded()
    names = ", ".join(name.removeprefix("inclined_landing.") for name in loaded)
    return set(loaded) == set(plugins.NAMES), f"{names} for MuJoCo {build['mujoco']}, {library}"


def _simulation() -> tuple[bool, str]:
    """Return whether a hovering vehicle stays at its position for a second."""
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
    """Return how pictures are rendered; ray casting needs only MuJoCo."""
    import numpy as np

    from inclined_landing.envs.rendering import make_renderer, pose_from_state
    from inclined_landing.models.attitude import STATE_SIZE

    with make_renderer(64, 48) as renderer:
        renderer.render(pose_from_state(np.zeros(STATE_SIZE), None))
    return True, "ray casting on the processor"


def _video() -> tuple[bool, str]:
    import imageio_ffmpeg

    return True, imageio_ffmpeg.get_ffmpeg_exe()


def _show(findings: list[CheckResult]) -> None:
    from rich.text import Text

    from inclined_landing.envs.shared.tables import new_table, say, show_table

    table = new_table(None, "", "", "", labels=3)
    table.show_header = False
    for finding in findings:
        state = Text("ok", "green") if finding.ok else Text("missing", "red")
        table.add_row(state, finding.name, Text(finding.detail, overflow="fold"))
    show_table(table)
    versions = runs.versions()
    say(f"{versions['cpu']}, {versions['cores']} cores, {versions['system']}")
    say(*(f"{finding.name}: {finding.remedy}" for finding in findings if not finding.ok))
    lacking = ", ".join(finding.name for finding in findings if not finding.ok)
    say(f"These are missing or broken: {lacking}." if lacking else "All requirements are met.")
