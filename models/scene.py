"""The MuJoCo scene: shapes from `mjcf/`, numbers from the vehicle file.

The XML files describe the shipped vehicle. `build_spec` adapts them to any other through MjSpec: it sets
every number of the vehicle file and moves everything at a motor along with it. The result compiles in plain
MuJoCo if this package is installed (its plugins load with `import mujoco`).
"""

from __future__ import annotations

import functools
import math
import re
from importlib import resources
from typing import Annotated

import mujoco
import numpy as np
from msgspec import Meta

from inclined_landing.models import geometry, plugins
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.plausible import ENGINE_STEP
from inclined_landing.models.vehicle import SOLID_BELOW, Vehicle

INTEGRATORS = {
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
}
Zone = Annotated[float, Meta(ge=0, le=1)]  # m, around the platform
Period = Annotated[float, Meta(ge=1e-5, le=1)]  # s
_VISUAL_GROUPS = (1, 2)
_AT_A_MOTOR = re.compile(r"(?P<kind>[a-z]+)_(?P<x>front|rear)_(?P<y>left|right)(_\d)?")
_WALL_HALF_HEIGHT = 0.8  # m; reaches below the floor at every inclination
_WALL_HALF_THICKNESS = 0.045  # m; out of a touch that is less deep, the engine pushes to the outside
# The inertia of a moving platform's joints [kg, kg m2] is so large that a touchdown of 0.1 N s changes its
# speed by 1e-6 m/s, for one control period. The contact solver's tolerance is relative to the scene's
# inertia, and is therefore smaller in proportion.
_JOINT_INERTIA = 1e5
_SOLVER_TOLERANCE = 1e-15
# A slung load: the share of its moment of inertia that its own size adds, the least moment that the engine
# accepts [kg m2], and the mass [kg] of a load that is not there (3e-9 of a Crazyflie's). It is drawn with the
# density of sand.
_POINT, _LEAST_INERTIA, _NO_LOAD = 1e-7, 1e-13, 1e-10
_LOAD_DENSITY = 2000.0  # kg/m3, drawn
_STRING_RADIUS = 0.0015  # m, drawn
_SLIDES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
_HINGES = {
    "yaw": (0, 0, 1),
    "roll": (1, 0, 0),
    "pitch": (0, 1, 0),
}  # attitude Rz(yaw) Rx(roll) Ry(pitch)


def build_spec(
    vehicle: Vehicle | None = None,
    *,
    visuals: bool = True,
    keep_out: Zone = 0.0,
    timestep: Period = ENGINE_STEP,
    integrator: str = "RK4",
    pooled: float | None = None,
    moving: bool = False,
    loaded: bool | None = None,
    contacts: bool = True,
) -> mujoco.MjSpec:
    """Return the scene as an MjSpec.

    visuals: keep the purely visual geoms (they cost time in simulation and change no physics).
    keep_out: zone around slab and base [m] in which contacts are reported without force.
    pooled: for a batch in which every simulation has its own vehicle, the longest delay of commands among
        them [s]. Such scenes differ only in numbers and compile ten times as fast: textures have one pixel.
    moving: the platform has joints instead of being posed, so that it has a velocity, which friction
        transmits; it has no base.
    loaded: for a batch in which some vehicles have a slung load, whether there is a body for it, with almost
        no mass if a vehicle has none. None: only if the vehicle has one.
    contacts: whether the engine looks for contacts, which takes a quarter of a step in free flight.

    Raises UserError for an unknown integrator or a negative zone or time step.
    """
    v = as_vehicle(vehicle)
    plugins.load()
    if not isinstance(integrator, str) or integrator not in INTEGRATORS:
        raise UserError(
            f"unknown integrator {shown(repr(integrator), 40)}; choose from {', '.join(INTEGRATORS)}"
        )
    schema.check({"timestep": timestep, "keep_out": keep_out}, schema.kinds_of(build_spec))
    spec = _as_drawn(visuals).copy()
    spec.option.timestep = timestep
    spec.option.integrator = INTEGRATORS[integrator]
    spec.option.gravity = [0, 0, -v.environment_gravity]
    spec.option.wind = [*v.effects_wind, 0]
    if not contacts:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    _fill_vehicle(spec, v)
    _place_rotors(spec, v)
    if loaded if loaded is not None else v.effects_load_mass > 0.0:
        _hang_load(spec, v, visuals)
    _fill_delays(spec, v, pooled)
    if pooled is not None:
        _add_numbers(spec, v)
        for texture in spec.textures:
            texture.width = texture.height = 1
    _fill_platform(spec, v, keep_out)
    if moving:
        _release_platform(spec)
    for geom in list(spec.geoms):
        if geom.contype or geom.conaffinity:
            geom.friction[0] = v.contact_friction
            geom.solref[:2] = v.contact_solref
    return spec


@functools.cache
def _as_drawn(visuals: bool) -> mujoco.MjSpec:
    """Return the spec of the XML files, with or without the purely visual geoms; copy it before use."""
    with resources.as_file(resources.files("inclined_landing.models") / "mjcf") as folder:
        spec = mujoco.MjSpec.from_file(str(folder / "landing.xml"))
    for geom in [] if visuals else list(spec.geoms):
        if not (geom.contype or geom.conaffinity) and geom.group in _VISUAL_GROUPS:
            spec.delete(geom)
    for skin in [] if visuals else list(spec.skins):
        spec.delete(skin)
    return spec


def _fill_vehicle(spec: mujoco.MjSpec, v: Vehicle) -> None:
    body = spec.body("crazyflie")
    body.explicitinertial = True
    body.mass = v.body_mass
    body.ipos = [0, 0, 0]
    body.inertia = v.body_inertia
    for plugin in spec.plugins:
        plugin.config = {
            name: _text(getattr(v, field)) for name, field in plugins.fields()[plugin.name].items()
        }
    spec.body("feet").pos[2] -= v.effects_foot_height
    x, y = v.effects_com_offset
    spec.site("thrust").pos = [-x, -y, 0]
    ranges = {
        "thrust": (0.0, v.command_pwm_range[1]),
        "roll": (-v.command_angle_limit, v.command_angle_limit),
        "pitch": (-v.command_angle_limit, v.command_angle_limit),
        "yaw_rate": (-v.command_yaw_rate_limit, v.command_yaw_rate_limit),
    }
    for name, limits in ranges.items():
        actuator = spec.actuator(name)
        actuator.ctrllimited = True
        actuator.ctrlrange = limits
        if name != "thrust":
            limit = v.attitude_yaw_torque_limit if name == "yaw_rate" else v.attitude_torque_limit
            actuator.forcelimited = True
            actuator.forcerange = (-limit, limit)
    for key in spec.keys:
        if key.name == "hover":
            key.act = [v.hover_lag, 0, 0]
            key.ctrl = [v.hover_pwm, 0, 0, 0]


def _place_rotors(spec: mujoco.MjSpec, v: Vehicle) -> None:
    """Move everything at a motor to the position in the vehicle file.

    Everything there moves with the arm; rotors and motors also move with the height. Blades and discs are
    scaled to the rotors, and the board's arms to the length of the vehicle's.
    """
    reference = spec.geom("rotor_front_left")
    arm, _, height = reference.pos
    grown, wider = v.rotor_radius / reference.size[0], v.rotor_arm / arm
    foot = spec.geom("foot_front_left")
    if v.rotor_height - reference.size[1] <= foot.pos[2] - foot.size[0]:
        raise UserError(
            f"the rotors are below the feet: rotor.height of {v.rotor_height:g} m must be more than "
            f"{foot.pos[2] - foot.size[0] + reference.size[1]:g} m"
        )
    for element in [*spec.sites, *spec.geoms]:
        at = _AT_A_MOTOR.fullmatch(element.name)
        if element.name.startswith("arm_"):
            element.size[0] *= wider
        if not at:
            continue
        side = np.array([1.0 if at["x"] == "front" else -1.0, 1.0 if at["y"] == "left" else -1.0, 0.0])
        shift = side * (v.rotor_arm - arm)
        if at["kind"] == "led":  # on the board's arms
            element.pos[:2] *= wider
            continue
        if at["kind"] in ("rotor", "motor", "hub", "blade", "disc"):
            shift[2] = v.rotor_height - height
        if at["kind"] == "leg":
            element.fromto += np.tile(shift, 2)
            continue
        if at["kind"] == "blade":
            shift += (element.pos - side * arm - [0, 0, height]) * (grown - 1.0)
            element.size[:2] *= grown
        element.pos += shift
        if at["kind"] == "disc" or (at["kind"] == "rotor" and isinstance(element, mujoco.MjsGeom)):
            element.size[0] = v.rotor_radius


def _hang_load(spec: mujoco.MjSpec, v: Vehicle, visuals: bool) -> None:
    """Add a body for the slung load, on a ball joint at the centre of mass, without contacts."""
    mass, length = max(v.effects_load_mass, _NO_LOAD), v.effects_load_length
    body = spec.body("crazyflie").add_body(name="load")
    body.add_joint(name="load", type=mujoco.mjtJoint.mjJNT_BALL)
    body.explicitinertial = True
    body.mass, body.ipos = mass, [0, 0, -length]
    # The load is nearly a point: it adds this share to the moment of inertia m_l L^2 about the joint.
    body.inertia = [max(_POINT * mass * length**2, _LEAST_INERTIA)] * 3
    if not visuals:
        return
    radius = (0.75 * mass / (math.pi * _LOAD_DENSITY)) ** (1.0 / 3.0)
    shown: dict = {"contype": 0, "conaffinity": 0, "group": _VISUAL_GROUPS[1], "mass": 0.0}
    body.add_geom(
        name="string",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0, 0, 0, 0, 0, radius - length],
        size=[_STRING_RADIUS, 0, 0],
        material="header",
        **shown,
    )
    body.add_geom(
        name="load",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        pos=[0, 0, -length],
        size=[radius, 0, 0],
        material="motor",
        **shown,
    )


def _add_numbers(spec: mujoco.MjSpec, v: Vehicle) -> None:
    """Add the attributes of the plugins as custom numerics, which unlike text may differ within a batch."""
    for plugin in spec.plugins:
        values = [getattr(v, field) for field in plugins.fields()[plugin.name].values()]
        numbers = [float(x) for value in values for x in (value if isinstance(value, tuple) else (value,))]
        spec.add_numeric(name=plugin.name, data=numbers, size=len(numbers))


def _fill_delays(spec: mujoco.MjSpec, v: Vehicle, pooled: float | None) -> None:
    """Set the delays of the commands in the engine.

    The plugins take a delayed command as held over the step (`plugin/README.md`).
    """
    delays = dict.fromkeys(("roll", "pitch", "yaw_rate"), v.effects_attitude_delay)
    for name, delay in {"thrust": v.effects_thrust_delay, **delays}.items():
        longest = delay if pooled is None else pooled
        if longest > 0:
            spec.actuator(name).delay = delay
            spec.actuator(name).nsample = max(1, math.ceil(longest / spec.option.timestep - 1e-9))


def _fill_platform(spec: mujoco.MjSpec, v: Vehicle, keep_out: float) -> None:
    """Set the sizes of slab, walls and core, and their poses at the vehicle file's inclination.

    In the frames of their mocap bodies the slab's top surface, the drawn base's upper edges and the
    core's top pass through the origin, which is what `geometry.platform_poses` poses.
    """
    half_depth = 0.5 * v.platform_depth
    narrowest = v.slab_half_length * math.cos(v.platform_max_inclination)
    # From an upper edge the slab falls by 2 t tan(a) over a wall, whose top is T/cos(a) + SOLID_BELOW lower.
    steepest = max(v.platform_max_inclination, 0.01)
    hidden = (v.platform_thickness + SOLID_BELOW * math.cos(steepest)) / math.sin(steepest)
    thickness = min(_WALL_HALF_THICKNESS, 0.5 * hidden, 0.4 * narrowest)
    for name, depth in {"slab": v.slab_depth, "slab_drawn": v.platform_thickness}.items():
        if slab := spec.geom(name):  # the drawn one may have been left out
            slab.size = [v.slab_half_length, half_depth, 0.5 * depth]
            slab.pos = [0, 0, -slab.size[2]]
    for name, side in (("wall_left", 1), ("wall_right", -1)):
        wall = spec.geom(name)
        wall.size = [thickness, half_depth, _WALL_HALF_HEIGHT]
        wall.pos = [side * thickness, 0, -_WALL_HALF_HEIGHT - SOLID_BELOW]
    core = spec.geom("core")
    core.size = [narrowest - 2 * thickness, half_depth, _WALL_HALF_HEIGHT]
    core.pos = [0, 0, -_WALL_HALF_HEIGHT]
    for skin in spec.skins:  # its corners in the frames of the walls' bodies
        corners = np.sign(np.reshape(skin.vert, (-1, 3)))
        skin.vert = (corners * [0, half_depth, 2 * _WALL_HALF_HEIGHT]).ravel()
    positions, quaternions = geometry.platform_poses([v.platform_inclination], [True], v)
    for k, (body, geom) in enumerate(zip(geometry.PLATFORM_BODIES, geometry.PLATFORM_GEOMS)):
        spec.body(body).pos = positions[0, k]
        spec.body(body).alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        spec.body(body).quat = quaternions[0, k]
        spec.geom(geom).gap = keep_out


def _release_platform(spec: mujoco.MjSpec) -> None:
    """Replace the posed platform by a body with joints, too heavy to be moved by contacts.

    Its qpos is then its pose in the world. The base's bodies are parked below the floor.
    """
    spec.option.tolerance = _SOLVER_TOLERANCE
    body = spec.body("platform")
    body.mocap = False
    body.pos, body.quat = [0, 0, 0], [1, 0, 0, 0]
    body.explicitinertial = True
    body.ipos, body.mass, body.inertia = [0, 0, 0], 1e-6, [1e-6] * 3  # next to nothing beside the joints'
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for kind, axes in zip(kinds, (_SLIDES, _HINGES)):
        for name, axis in axes.items():
            body.add_joint(name=f"platform_{name}", type=kind, axis=axis, armature=_JOINT_INERTIA)
    for name in geometry.PLATFORM_BODIES[1:]:
        spec.body(name).pos = [0, 0, geometry.PARKED]


def _text(value) -> str:
    values = value if isinstance(value, tuple) else (value,)
    return " ".join(repr(float(x)) for x in values)


@functools.lru_cache(maxsize=128)
def compile_scene(vehicle: Vehicle, **options) -> mujoco.MjModel:
    """Return the compiled scene for simulation, without visual geoms; options as of `build_spec`."""
    return build_spec(vehicle, visuals=False, **options).compile()
