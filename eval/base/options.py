"""Options shared by several commands: types of individual options, and groups of options.

A group is a dataclass that is one argument of a command, `flown: Flat[Flown] = Flown()`; on the command line
its fields are ordinary options. Options shared with training are in `envs.shared.options`.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tyro
from msgspec import Meta

from inclined_landing.envs.shared.options import (  # noqa: F401
    Flag,
    NewFolder,
    Only,
    RunFolder,
    Seed,
    only_with,
    only_without,
)
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.base.schema import Pixels

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy


T = TypeVar("T")
Flat = Annotated[T, tyro.conf.OmitArgPrefixes]
PolicyFile = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
PolicyName = Annotated[str, tyro.conf.arg(metavar="POLICY")]
PlantName = Annotated[str, tyro.conf.arg(metavar="{mujoco,hybrid,analytic}")]
TaskName = Annotated[str | None, tyro.conf.arg(metavar="TASK")]
Degrees = Annotated[float | None, tyro.conf.arg(metavar="DEG")]
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
VehicleFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Starts = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Z")]
Drawn = Annotated[int, Meta(ge=0, le=100), tyro.conf.arg(metavar="N")]
ThrustScale = Annotated[float, Meta(gt=0, le=3)]
Until = Literal["rest", "goal"]  # end of the flight of a landing
FITTED = "flight"  # the camera that sees a whole flight from as near as it can
MOST_COMPARED = 10  # more cannot be distinguished in a table or figure
LogFiles = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]


@dataclasses.dataclass(frozen=True)
class Flown:
    """How and where the policy flies.

    Args:
        task: task of the policy. Only needed for a plain Stable-Baselines3 file and for a custom task, which
            is written module:Class or file.py:Class and imported.
        plant: simulated physics.
        inclination: platform inclination in degrees (default: that of the training); negative rises towards
            +x.
        azimuth: direction that the platform faces, in degrees from +x, for policies that fly in 3D.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
    """

    task: TaskName = None
    plant: PlantName = "mujoco"
    inclination: Degrees = None
    azimuth: Degrees = None
    vehicle: VehicleFile = None

    def load(self, policy: str) -> Policy:
        """Return the policy for this vehicle and platform.

        Raises UserError if any of them is unknown or wrong.
        """
        from inclined_landing.envs.policy import load_policy
        from inclined_landing.envs.tasks import import_task, is_path
        from inclined_landing.models.parameters import load_vehicle
        from inclined_landing.models.plants import check_plant

        check_plant(self.plant)
        angle = None if self.inclination is None else math.radians(self.inclination)
        if angle is not None:
            load_vehicle(self.vehicle).check_inclination(angle)
        task = import_task(self.task).name if self.task and is_path(self.task) else self.task
        turn = None if self.azimuth is None else math.radians(self.azimuth)
        return load_policy(policy, task, vehicle=self.vehicle, inclination=angle, azimuth=turn)


@dataclasses.dataclass(frozen=True)
class Look:
    """Camera, size and renderer of a picture.

    Args:
        camera: viewpoint. video and picture also know flight, which frames the entire flight.
        width: width of the picture in pixels.
        height: height of the picture in pixels.
        backend: ray casts rays on the processor, gl is OpenGL.
    """

    camera: Annotated[str, tyro.conf.arg(metavar="{arena,side,hero,pad,track,chase,closeup,onboard}")] = (
        "hero"
    )
    width: Pixels = 1280
    height: Pixels = 720
    backend: Annotated[str, tyro.conf.arg(metavar="{ray,gl}")] = "ray"


@dataclasses.dataclass(frozen=True)
class Reading:
    """Options for logs whose column names are not sufficient.

    Args:
        mapping: shipped mapping or mapping file (TOML), if the column names do not identify the format.
        unit: unit of a column that states none, for example roll=deg; repeatable.
        where: which rows to read, in a file with several vehicles, for example name=cf1; repeatable.
    """

    mapping: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    unit: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="COLUMN=UNIT")] = ()
    where: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="COLUMN=VALUE")] = ()

    def options(self) -> dict[str, Any]:
        """Return the arguments for `read_log`. Raises UserError for invalid options."""
        units = _pairs(self.unit, "--unit", "COLUMN=UNIT, as in roll=deg")
        where = _pairs(self.where, "--where", "COLUMN=VALUE, as in name=cf1")
        return {"mapping": self.mapping, "units": units, "where": where}


def _pairs(options: tuple[str, ...], option: str, expected: str) -> dict[str, str]:
    pairs = [text.partition("=") for text in options]
    for text, (left, _, right) in zip(options, pairs):
        if not (left and right):
            raise UserError(f"{option} {shown(text)!r}: expected {expected}")
    return {left: right for left, _, right in pairs}


@dataclasses.dataclass(frozen=True, kw_only=True)
class LogSource(Reading):
    """The logs, and how to read them.

    Args:
        files: CSV (.csv, .csv.gz), Crazyflie micro-SD binary or ROS bag; several files of one flight as A+B.
    """

    files: LogFiles

    def __post_init__(self):
        if not self.files:
            raise UserError("name at least one log")


@dataclasses.dataclass(frozen=True, kw_only=True)
class FlightSource(LogSource):
    """The flights, how to read them, and the model that they are compared with.

    Args:
        files: flights to fit: CSV (.csv, .csv.gz), Crazyflie micro-SD binary or ROS bag; several files of
            one flight as A+B.
        heldout: flights that are not fitted, but whose errors decide: in gap the verdict and which names
            are sure, in identify which constants are left unchanged (default: the errors of each flight,
            left out of the fit in turn).
        vehicle: vehicle file (TOML) of the model (default: the shipped Crazyflie 2.1).
        platform: the platform in the vehicle file was present in the flights (detected automatically in logs
            with contacts).
    """

    heldout: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = ()
    vehicle: VehicleFile = None
    platform: Flag = False

    @property
    def count(self) -> int:
        """Return the number of logs."""
        return len(self.files) + len(self.heldout)
