"""Pictures: geometry to the pixel, layers, shadows, and what happens without OpenGL."""

import subprocess
import sys

import numpy as np
import pytest

from inclined_landing.envs.rendering import Ghost, Pose, look_at, make_renderer, ray
from inclined_landing.envs.rendering import gl as gl_backend
from inclined_landing.envs.rendering.overlay import caption_height
from inclined_landing.envs.rendering.pose import qpos_of_state
from inclined_landing.envs.rendering.ray import RayRenderer
from inclined_landing.envs.tasks import TASKS, make_task
from inclined_landing.envs.tasks import frozen as starts
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import shapes_of
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.scene import build_spec

W, H = 320, 240


def hovering(x=0.9, z=1.7, pitch=0.2):
    state = np.zeros(13)
    state[[0, 2, 7]] = x, z, pitch
    return state


def changed(a, b):
    """Pixels that differ, (h, w) bool."""
    return (a.astype(int) != b.astype(int)).any(axis=2)


@pytest.fixture(scope="module")
def hero():
    return make_renderer(W, H, "hero", "ray")


@pytest.fixture(scope="module")
def side():
    return make_renderer(W, H, "side", "ray", scale=1.0)


def test_kept_background_equals_a_fresh_picture_bit_for_bit(hero):
    trail = np.stack([hovering(x=1.2 - 0.02 * k) for k in range(20)])
    goal = Ghost(qpos_of_state(hovering(0.0, 1.2, -0.4)))
    for k in (3, 10, 19):
        kept = hero.render(trail[k], trail=trail[: k + 1], ghosts=[goal], caption="x")
        fresh = RayRenderer(width=W, height=H, camera="hero").render(
            trail[k], trail=trail[: k + 1], ghosts=[goal], caption="x"
        )
        np.testing.assert_array_equal(kept, fresh)


@pytest.mark.parametrize("camera", ["hero", "side", "onboard"])
def test_no_ray_is_left_out_that_meets_the_vehicle(camera, monkeypatch):
    """Pictures equal those for which every ray of the vehicle's box is cast, with both projections."""
    states = [hovering(), hovering(2.9, 2.9, -0.6), hovering(-0.4, 1.0, 1.5)]
    goal = Ghost(qpos_of_state(hovering(0.0, 1.2, -0.4)), shadow=True)
    few, all_of_them = [], []
    with make_renderer(W, H, camera) as renderer:
        for pictures in (few, all_of_them):
            pictures += [renderer.render(state, ghosts=[goal]) for state in states]
            monkeypatch.setattr(ray, "covered", lambda shape, *_: np.ones(shape, bool))
            renderer._cached_background = (None, None)
    np.testing.assert_array_equal(few, all_of_them)


def test_several_renderers_draw_what_one_does(hero):
    """The second one shares the background, but neither the vehicle nor the platform."""
    one, other = hero.several(2)
    tilted = one.render(hovering(), inclination=-0.8)
    for _ in range(2):
        np.testing.assert_array_equal(other.render(hovering()), hero.several(1)[0].render(hovering()))
        np.testing.assert_array_equal(one.render(hovering(), inclination=-0.8), tilted)


def test_side_camera_shows_metres_exactly():
    """The markers' centres appear where the orthographic projection puts them.

    A marker covers about 0.6 pixels here, so the vehicle is drawn 8x; the centroid of a disc of
    radius 2.4 pixels, sampled at pixel centres, is within 0.25 pixels of its centre.
    """
    with make_renderer(W, H, "side", "ray", scale=8.0) as renderer:
        state = hovering(0.3, 1.5, 0.0)
        view = renderer.view(state)
        scene = renderer._scene
        assert view.orthographic
        pixel_per_metre = H / view.extent
        column, row = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        rays = view.rays(column.ravel(), row.ravel())
        geom, _, _ = scene.cast(view.eye, rays, 2)
        for k in range(3):
            marker = scene.model.geom(f"marker_{k}").id
            seen = (geom == marker).reshape(H, W)
            x, _, z = scene.data.geom_xpos[marker]
            expected = (0.5 * W + x * pixel_per_metre, 0.5 * H - (z - view.origin[2]) * pixel_per_metre)
            assert seen.sum() >= 8
            assert abs(column[seen].mean() - expected[0]) < 0.25
            assert abs(row[seen].mean() - expected[1]) < 0.25


def test_rays_meet_the_points_they_are_cast_at(hero, side):
    for renderer in (hero, side):
        view = renderer.view(hovering())
        points = np.array([[0.3, 0.0, 1.5], [-1.0, 0.0, 0.7], [0.5, 0.0, 2.0]])
        pixel, depth = view.project(points)
        rays = view.rays(pixel[:, 0], pixel[:, 1])
        np.testing.assert_allclose(view.eye + depth[:, None] * rays, points, atol=1e-6)


def test_shadow_falls_where_the_light_says():
    """Above the floor, beside the platform: the shadow's centre is the vehicle's along the light."""
    view = look_at([1.6, 0.0, 6.0], [1.6, 0.001, 0.0], W, H, extent=3.0)
    with make_renderer(W, H, view, "ray", scale=1.0) as renderer:
        state = hovering(1.6, 1.0, 0.0)
        empty = renderer.render(state, show_vehicle=False)
        ghost = Ghost(qpos_of_state(state), alpha=0.0, shadow=True)
        assert not changed(empty, renderer.render(state, show_vehicle=False, ghosts=[ghost])).any()
        mask = changed(empty, renderer.render(state))
        sun = renderer._scene.sun[2]
        foot = state[:3] - state[2] / sun[2] * sun
        place = view.project(foot[None])[0][0]
        body = view.project(state[None, :3])[0][0]
        rows, columns = np.nonzero(mask)
        apart = np.hypot(columns + 0.5 - body[0], rows + 0.5 - body[1]) > 12
        assert apart.sum() > 20
        # the vehicle is 11 pixels wide; its shadow's centroid lies within one pixel
        middle = np.array([columns[apart].mean() + 0.5, rows[apart].mean() + 0.5])
        assert np.hypot(*(middle - place)) < 1.0


@pytest.mark.parametrize("width, height", [(640, 480), (960, 540), (480, 640), (1000, 200)])
def test_the_default_camera_sees_every_start(width, height):
    """All of the vehicle as it is drawn, above the caption: the frozen grid, random starts of all tasks."""
    with make_renderer(width, height, backend="ray") as renderer:
        reach = renderer.scale * shapes_of(build_spec().compile()).reach
        view = renderer.view(hovering())
        corners = reach * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        positions = [starts.grid()[:, [0, 0, 1]] * [1, 0, 1]]
        rng = np.random.default_rng(width)
        positions += [make_task(name).sample(rng, 500).state[:, :3] for name in TASKS]
        pixels, depth = view.project(np.concatenate([p + corner for p in positions for corner in corners]))
    assert (depth > 0).all()
    assert (pixels >= 0).all() and (pixels <= [width, height - caption_height(height)]).all()


def test_trail_is_hidden_behind_the_platform():
    points = np.array([[-0.6, 0.6, 0.6], [0.6, 0.6, 0.6]])  # behind the base, seen from y < 0
    with make_renderer(W, H, "side", "ray") as renderer:
        empty = renderer.render(hovering(), show_vehicle=False)
        mask = changed(empty, renderer.render(hovering(), show_vehicle=False, trail=points))
        view = renderer.view(hovering())
        v = load_vehicle()
        half = v.slab_half_length * np.cos(v.platform_inclination)
        edges = view.project(np.array([[-half, 0, 0.6], [half, 0, 0.6]]))[0][:, 0]
        columns = np.nonzero(mask)[1]
        assert columns.min() < edges[0] - 10 and columns.max() > edges[1] + 10
        # the base is drawn 2 mm narrower than the slab, the line is 2 pixels wide
        assert not ((columns > edges[0] + 2) & (columns < edges[1] - 3)).any()


def test_platform_pose_of_every_source():
    """Qpos and state give the same picture; inclination and absence change it."""
    state = hovering()
    with make_renderer(W, H, "hero", "ray") as renderer:
        from_state = renderer.render(state)
        np.testing.assert_array_equal(renderer.render(qpos_of_state(state)), from_state)
        steep = renderer.render(state, inclination=-0.8)
        absent = Pose(qpos_of_state(state), np.array([0, 0, -100.0]), np.array([1.0, 0, 0, 0]))
        gone = renderer.render(absent)
        assert changed(steep, from_state).sum() > 500
        assert changed(gone, from_state).sum() > 500
        np.testing.assert_array_equal(renderer.render(state), from_state)


def test_wrong_arguments_are_sentences():
    with pytest.raises(UserError, match="width must be a whole number from 16 to 4096, not 4"):
        make_renderer(4, 4, backend="ray")
    with pytest.raises(UserError, match=r"qpos \(7,\) or a state \(13,\), not \(5,\)"):
        make_renderer(W, H, backend="ray").render(np.zeros(5))


def test_missing_opengl_is_one_sentence_with_the_remedy(monkeypatch):
    monkeypatch.setattr(gl_backend, "_loads", lambda *names: False)
    for _ in range(2):  # MuJoCo's own second attempt would abort the process
        with pytest.raises(UserError) as caught:
            make_renderer(W, H, backend="gl")
        message = str(caught.value)
        assert "libEGL and libGL and libOSMesa is missing" in message
        assert "apt-get install libegl1 libgl1" in message and "\n" not in message


def test_import_touches_neither_opengl_nor_learning():
    code = (
        "import os, sys; import inclined_landing.envs.rendering as r; r.make_renderer(64, 48, "
        "backend='ray'); bad = [m for m in ('OpenGL', 'torch', 'mujoco.egl') if m in sys.modules];"
        "assert not bad, bad; assert 'MUJOCO_GL' not in os.environ"
    )
    environment = {"PATH": "/usr/bin:/bin", "HOME": "/tmp"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


GL = """
import numpy as np
from inclined_landing.envs.rendering import make_renderer
state = np.zeros(13)
state[[0, 2, 7]] = 0.3, 1.6, 0.2
frames = []
for backend in ("gl", "ray"):
    with make_renderer(640, 480, "hero", backend) as r:
        bare = r.render(state, show_vehicle=False).astype(int)
        full = r.render(state, trail=[state, state], ghosts=[], caption="").astype(int)
        frames.append(np.abs(full - bare).sum(axis=2)[:320] > 60)
gl, ray = frames
print((gl & ray).sum() / (gl | ray).sum())
"""


@pytest.mark.gl
def test_opengl_shows_the_vehicle_at_the_same_pixels():
    try:
        gl_backend._kind()
    except UserError:
        pytest.skip("no OpenGL on this machine")
    done = subprocess.run([sys.executable, "-c", GL], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    # shadows differ (soft, hard) and translucent discs too; the vehicle dominates
    assert float(done.stdout.split()[-1]) > 0.5
