"""Vehicles of different size in one plant, and the files that describe them."""

import numpy as np
import pytest

from inclined_landing.models import geometry
from inclined_landing.models.attitude import Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle, vehicle_names, write_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.models.scene import compile_scene

V = load_vehicle()
NAMES = vehicle_names()
FLEET = [load_vehicle(name) for name in NAMES]
PLANTS = "analytic", "mujoco", "hybrid"


def test_the_clearance_of_each_is_that_of_its_own_shapes():
    plant = make_plant("hybrid", len(FLEET), V, pool=FLEET, threads=1)
    ids = np.arange(len(FLEET))
    plant.assign(ids, 1 + ids)
    plant.set_platform(ids, V.platform_inclination)
    state = np.zeros((len(ids), 13))
    state[:, 0], state[:, Z] = 0.3, 1.55
    found = plant.clearance(ids, state)
    position, _ = geometry.platform_poses(plant.inclination, plant.present, V)
    for k, vehicle in enumerate(FLEET):
        shapes = geometry.shapes_of(compile_scene(vehicle))
        alone = geometry.clearances(state[k : k + 1], plant.inclination[:1], position[:1], shapes)
        assert found[k] == alone[0, :2].min()
    plant.set_platform(ids, V.platform_inclination, False)
    assert (plant.clearance(ids, state) > 50.0).all()  # parked far below


@pytest.mark.parametrize("name", NAMES)
def test_shipped_vehicles_are_possible_ones(name):
    """They hover within their commands, with a thrust to weight that quadrotors have."""
    vehicle = load_vehicle(name)
    low, high = vehicle.command_pwm_range
    assert low < vehicle.hover_pwm < high
    assert 1.5 < high / vehicle.hover_pwm < 4.0
    # Platform, arena and commands are one: a policy meets the same task.
    for field, value in vars(vehicle).items():
        if field.startswith(("platform_", "arena_", "command_", "environment_")):
            assert value == getattr(V, field), field


def test_a_file_that_is_based_on_the_shipped_one_holds_only_what_differs(tmp_path):
    path = tmp_path / "light.toml"
    mass = 'mass = { value = 0.03, unit = "kg", source = "scales", uncertainty = 0.001 }'
    path.write_text(f'based_on = "crazyflie-2.1"\n[body]\n{mass}\n', "utf-8")
    assert load_vehicle(path) == V.changed(body_mass=0.03)
    path.write_text(f"[body]\n{mass}\n", "utf-8")
    with pytest.raises(UserError, match=r'lacks entries: .*begins with based_on = "crazyflie-2.1"'):
        load_vehicle(path)
    path.write_text(f'based_on = "hummingbird"\n[body]\n{mass}\n', "utf-8")
    assert load_vehicle(path) == load_vehicle("hummingbird").changed(body_mass=0.03)
    for wrong in ('"sparrow"', "1", '["crazyflie-2.1"]'):
        path.write_text(f"based_on = {wrong}\n[body]\n{mass}\n", "utf-8")
        with pytest.raises(UserError, match=r"based_on must be one of crazyflie-2\.0, .*, not "):
            load_vehicle(path)


def test_a_brief_file_is_the_same_vehicle(tmp_path):
    brushless = load_vehicle("crazyflie-2.1-brushless")
    for base, vehicle in (
        ("crazyflie-2.1", V.changed(body_mass=0.03)),
        ("crazyflie-2.1-brushless", brushless),
    ):
        path = tmp_path / "brief.toml"
        write_vehicle(path, vehicle.changed(attitude_gain=0.7), base=base, brief=True)
        assert load_vehicle(path) == vehicle.changed(attitude_gain=0.7)
        assert path.read_text("utf-8").count("value") == 1 + (base == "crazyflie-2.1")


def test_shipped_vehicles_are_found_by_name():
    assert load_vehicle("crazyflie-2.1") == V
    assert set(NAMES) >= {"crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird"}
    with pytest.raises(UserError, match="vehicle file crazyflie-3 does not exist"):
        load_vehicle("crazyflie-3")
