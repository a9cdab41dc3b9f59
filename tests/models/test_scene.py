"""The XML files as they stand, and what the scene builder makes of them for other vehicles."""

import dataclasses
import math
from importlib import resources

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inclined_landing.models import geometry
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.scene import build_spec

MJCF = resources.files("inclined_landing.models") / "mjcf"
V = load_vehicle()
CORNERS = {"front_left": (1, 1), "front_right": (1, -1), "rear_left": (-1, 1), "rear_right": (-1, -1)}


def numbers(of) -> dict[str, np.ndarray]:
    """Every numeric field of an MjModel, or of its options."""
    fields = {name: getattr(of, name) for name in dir(of) if not name.startswith("_")}
    return {n: np.asarray(x) for n, x in fields.items() if isinstance(x, (int, float, np.ndarray))}


def test_the_xml_is_the_shipped_vehicle():
    """A number that a file has and the vehicle file has otherwise shows here by its field of MjModel."""
    drawn, built = mujoco.MjModel.from_xml_path(str(MJCF / "landing.xml")), build_spec(V).compile()
    text = {"nplugin", "npluginattr", "plugin_attr", "plugin_attradr", "nbuffer"}  # defaults are built in
    for a, b in ((drawn, built), (drawn.opt, built.opt)):
        a, b = numbers(a), numbers(b)
        for name in a.keys() - text:
            # pi/180 and the like in other orders: some roundings
            np.testing.assert_allclose(a[name], b[name], rtol=1e-12, atol=1e-14, err_msg=name)


@pytest.mark.parametrize("name", ["crazyflie.xml", "landing.xml"])
def test_a_file_flies_as_it_stands(name):
    model = mujoco.MjModel.from_xml_path(str(MJCF / name))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("hover").id)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 250)
    # Weight and thrust cancel to some roundings of g; half to one second of that is 1e-14 m.
    np.testing.assert_allclose(data.qpos, start, atol=1e-12)
    data.ctrl[0] = 0.0
    mujoco.mj_step(model, data, 100)
    assert data.qpos[2] < start[2] - 0.1


def test_vehicles_attach_to_another_scene_and_fly_there():
    """Two of them, one hovering and rolling, one falling onto its feet."""
    scene = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><geom name="ground" type="plane" size="5 5 0.1"/></worldbody></mujoco>'
    )
    for k, prefix in enumerate(("a_", "b_")):
        vehicle = mujoco.MjSpec.from_file(str(MJCF / "crazyflie.xml"))
        scene.attach(vehicle, prefix=prefix, frame=scene.worldbody.add_frame(pos=[k, 0, 0]))
    model = scene.compile()
    data = mujoco.MjData(model)
    data.joint("a_crazyflie").qpos[:3] = 0, 0, 1.0
    data.joint("b_crazyflie").qpos[:3] = 1, 0, 0.1
    data.act[model.actuator("a_thrust").actadr] = V.hover_lag
    data.actuator("a_thrust").ctrl[0] = V.hover_pwm
    data.actuator("a_roll").ctrl[0] = 0.1
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    w, x, *_ = data.joint("a_crazyflie").qpos[3:]
    # Ten time constants after the command, e^-10 of it is missing.
    assert 2 * math.atan2(x, w) == pytest.approx(0.1 * V.attitude_gain, rel=1e-3)
    assert data.joint("b_crazyflie").qpos[2] == pytest.approx(0.018, abs=1e-3)  # feet, and how deep they sink
    assert abs(data.joint("b_crazyflie").qpos[3]) > math.cos(0.02)


@given(arm=st.floats(0.006, 1.0), share=st.floats(0.1, 1.0), height=st.floats(-0.01, 0.4))
@settings(max_examples=15, deadline=None)
def test_everything_at_a_motor_stands_where_the_vehicle_file_has_it(arm, share, height):
    radius = max(0.002, share * arm)  # the least that a vehicle file may have
    vehicle = dataclasses.replace(V, rotor_arm=arm, rotor_radius=radius, rotor_height=height)
    spec = build_spec(vehicle)
    rotors = next(p.config for p in spec.plugins if p.name == "rotors")
    forces = [float(rotors[k]) for k in ("arm", "disc_height", "disc_radius")]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = data.body("crazyflie")

    def local(element):
        return body.xmat.reshape(3, 3).T @ (element.xpos - body.xpos)

    def close(position, wanted):
        np.testing.assert_allclose(position, wanted, atol=1e-12)

    for corner, (x, y) in CORNERS.items():
        disc = [x * arm, y * arm, height]
        assert [x * disc[0], y * disc[1], disc[2]] == forces[:1] * 2 + forces[1:2]
        close(local(data.geom(f"rotor_{corner}")), disc)
        close(local(data.geom(f"disc_{corner}")), disc)
        close(local(data.site(f"rotor_{corner}")), disc)
        for part in ("rotor", "disc"):
            assert model.geom(f"{part}_{corner}").size[0] == forces[2] == radius
        for part in ("foot", "mount", "leg", "motor", "hub"):
            close(local(data.geom(f"{part}_{corner}"))[:2], disc[:2])
        for blade in ("blade_{}_0", "blade_{}_1"):
            name = blade.format(corner)
            out = np.linalg.norm(local(data.geom(name)) - disc) + model.geom(name).size[0]
            assert 0.9 * radius < out < 1.05 * radius  # it ends about where the disc does
    for board in ("arm_a", "arm_b"):  # its ends are under the mounts
        assert model.geom(board).size[0] == pytest.approx(math.sqrt(2) * arm, rel=0.02)
    shapes = geometry.shapes_of(model)  # what the analytic plant and the start filters see
    feet = shapes.centres[0, shapes.parts == geometry.PARTS.index("feet")]
    close(np.abs(feet[:, :2]), np.full((4, 2), arm))
    rotors = shapes.parts == geometry.PARTS.index("rotors")
    rims = np.abs(shapes.centres[0, rotors]) + shapes.radii[0, rotors, None]
    close(rims[:, :2].max(), arm + radius)
    close(shapes.centres[0, rotors, 2], height)


def test_rotors_below_the_feet_are_refused():
    with pytest.raises(
        UserError, match=r"below the feet: rotor\.height of -0\.02 m must be more than -0\.0165"
    ):
        build_spec(dataclasses.replace(V, rotor_height=-0.02))


def run_of(model: mujoco.MjModel, start, **platform) -> tuple[np.ndarray, set]:
    """States of one second from a height that ends on platform or base, and which geoms touched."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("hover").id)
    for joint, value in platform.items():
        data.joint(f"platform_{joint}").qpos = value
    data.joint("crazyflie").qpos[:3] = start
    data.actuator("thrust").ctrl[:] = 0.6 * V.hover_pwm
    states, pairs = [], set()
    for _ in range(250):
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
        names = [sorted(model.geom(k).name for k in pair) for pair in data.contact.geom]
        pairs |= {tuple(pair) for pair in names}
    return np.array(states), pairs


@pytest.mark.parametrize("start", [(0.1, 0.0, 1.5), (-0.41, 0.0, 1.2)])  # onto the slab, onto its lower edge
@pytest.mark.parametrize("slope", [-25.7, 0.0, 45.0])
def test_what_is_drawn_changes_no_physics(slope, start):
    vehicle = dataclasses.replace(V, platform_inclination=math.radians(slope))
    drawn, bare = build_spec(vehicle).compile(), build_spec(vehicle, visuals=False).compile()
    assert (drawn.nskin, bare.nskin) == (1, 0)
    for size in ("nq", "nv", "nu", "na", "nbody", "nmocap", "nsensordata"):
        assert getattr(drawn, size) == getattr(bare, size)
    (states, pairs), (expected, others) = run_of(drawn, start), run_of(bare, start)
    np.testing.assert_array_equal(states, expected)
    assert pairs == others and pairs


def test_what_is_drawn_changes_no_physics_of_a_moving_platform():
    models = [build_spec(V, visuals=visuals, moving=True).compile() for visuals in (True, False)]
    (states, pairs), (expected, others) = [run_of(m, (0.05, 0, 1.3), z=1.1, pitch=0.3) for m in models]
    np.testing.assert_array_equal(states, expected)
    assert pairs == others and pairs
