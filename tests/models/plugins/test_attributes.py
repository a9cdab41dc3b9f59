"""Every attribute of `attributes.toml`: read, flown by both plants alike, refused when wrong, documented."""

import dataclasses
import importlib.util

import mujoco
import numpy as np
import pytest

from inclined_landing.models import plugins
from inclined_landing.models.attitude import LAG, ROLL, VX, WX, X
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant, MujocoPlant
from inclined_landing.models.scene import build_spec
from inclined_landing.models.vehicle import Vehicle
from tests import ROOT

PLUGIN = ROOT / "models" / "plugin"
# Every effect is on, so that every attribute has something to act on.
V = dataclasses.replace(
    load_vehicle(),
    effects_thrust_bias=0.01,
    effects_thrust_fade=0.05,
    effects_battery_sag=0.1,
    effects_voltage_sensitivity=0.2,
    effects_voltage_discharge=0.05,
    effects_spin_down=0.3,
    effects_body_drag=0.005,
    effects_translational_lift=0.02,
    effects_axial_inflow=0.02,
    effects_ground_effect=2.0,
    effects_ground_fading=2.0,
    effects_rotor_loss=(0.02, 0.05, 0.01, 0.1),
    effects_attitude_integral=1.0,
    effects_attitude_hold=1.5,
    attitude_integral_limit=0.005,
    effects_attitude_saturation=1.0,
    effects_attitude_trim=(0.02, -0.01),
    effects_estimator_lean=0.02,
    effects_yaw_drift=0.1,
)
ATTRIBUTES = [(plugin, name) for plugin, fields in plugins.fields().items() for name in fields]


def changed(plugin: str, name: str) -> Vehicle:
    """V with another value of one attribute: a tenth more, motors one more."""
    field = plugins.fields()[plugin][name]
    value = getattr(V, field)
    if isinstance(value, tuple):
        return dataclasses.replace(V, **{field: tuple(1.1 * x for x in value)})
    return dataclasses.replace(V, **{field: value + 1.0 if field == "motor_count" else 1.1 * value})


def flown(plant) -> np.ndarray:
    """State (13,) after 0.2 s of manoeuvres just above the slab, speed and thrust first falling."""
    state = np.zeros((1, 13))
    state[0, X], state[0, 2] = 0.05, V.platform_surface_height + 0.16
    state[0, VX : VX + 3], state[0, ROLL : ROLL + 3] = (0.6, -0.4, 0.8), (0.1, -0.2, 0.3)
    state[0, WX : WX + 3], state[0, LAG] = (0.5, -0.5, 0.2), 1.2 * V.hover_lag
    plant.reset(np.arange(1), state)
    for command in [(0.8, 0.2, -0.1, 1.0)] * 5 + [(1.2, -0.2, 0.2, -1.0)] * 5:
        plant.step(np.array([command]) * [V.hover_pwm, 1.0, 1.0, 1.0])
    assert not plant.contacts.touch.any()
    return plant.state[0]


@pytest.fixture(scope="module")
def unchanged() -> tuple[np.ndarray, np.ndarray]:
    return flown(MujocoPlant(1, V)), flown(AnalyticPlant(1, V, attitude="rate_loop", substeps=5))


@pytest.mark.parametrize("plugin, name", ATTRIBUTES, ids=lambda x: x)
def test_it_is_read_and_flies_differently_in_both_plants_alike(plugin, name, unchanged):
    vehicle = changed(plugin, name)
    spec = build_spec(vehicle, visuals=False)
    config = next(p.config for p in spec.plugins if p.name == plugin)
    np.testing.assert_array_equal(
        np.fromstring(config[name], sep=" "), np.atleast_1d(getattr(vehicle, plugins.fields()[plugin][name]))
    )
    plants = MujocoPlant(1, vehicle), AnalyticPlant(1, vehicle, attitude="rate_loop", substeps=5)
    engine, equations = (flown(plant) - before for plant, before in zip(plants, unchanged))
    scale = np.ones(13)
    scale[LAG] = V.hover_lag
    assert (np.abs(equations) / scale).max() > 1e-7  # some hundred times what rounding does in 0.2 s
    # The plants differ by 1e-4 of what they do (`docs`: equivalence), and so do their answers to a change.
    np.testing.assert_allclose(engine / scale, equations / scale, atol=2e-2 * np.abs(equations / scale).max())


@pytest.mark.parametrize("plugin, name", ATTRIBUTES, ids=lambda x: x)
def test_wrong_numbers_are_refused(build, plugin, name):
    count = np.size(getattr(V, plugins.fields()[plugin][name]))
    for text in ("fast", "nan", " ".join(["1"] * (count + 1))):
        with pytest.raises(ValueError, match=rf"{plugin}: attribute '{name}' must be {count} finite number"):
            build(**{plugin: {name: text}})


@pytest.mark.parametrize("plugin, name", ATTRIBUTES, ids=lambda x: x)
def test_custom_numbers_stand_for_the_text(plugin, name):
    """The changed value by the numeric alone, and by the text alone, bit for bit; and unlike neither."""
    ends = []
    for vehicle, given in ((V, V), (V, changed(plugin, name)), (changed(plugin, name), None)):
        spec = build_spec(vehicle, visuals=False, pooled=None if given is None else 0.0)
        if given is not None:
            numbers = [np.atleast_1d(getattr(given, f)) for f in plugins.fields()[plugin].values()]
            spec.numeric(plugin).data = np.concatenate(numbers)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[:3] = 0.05, 0, V.platform_surface_height + 0.1
        data.qvel[:] = 0.3, -0.2, -0.5, 1, -1, 0.5
        data.act[0], data.ctrl[:] = 1.2 * V.hover_lag, (0.8 * V.hover_pwm, 0.2, -0.1, 1.0)
        mujoco.mj_step(model, data, nstep=10)
        ends.append(np.concatenate([data.qpos, data.qvel, data.act]))
    np.testing.assert_array_equal(ends[1], ends[2])
    assert (ends[0] != ends[1]).any()


@pytest.mark.parametrize("plugin", plugins.fields())
def test_wrong_custom_numbers_are_refused(build, plugin):
    count = sum(np.size(getattr(V, field)) for field in plugins.fields()[plugin].values())
    for numbers, sentence in (
        ([1.0] * (count - 1), f"'{plugin}' must hold the {count} numbers .* holds {count - 1}"),
        ([np.nan] * count, "must be finite"),
        ([-1.0] * count, "must be greater than 0"),
    ):
        text = f'<custom><numeric name="{plugin}" data="{" ".join(map(str, numbers))}"/></custom></mujoco>'
        with pytest.raises(ValueError, match=sentence):
            mujoco.MjModel.from_xml_string(build.xml().replace("</mujoco>", text))


def test_the_manual_is_current():
    spec = importlib.util.spec_from_file_location("generate", PLUGIN / "generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    text = (PLUGIN / "README.md").read_text("utf-8")
    assert generate.manual(text, generate.attributes()) == text, (
        "run `python models/plugin/generate.py manual`"
    )
    for plugin, name in ATTRIBUTES:
        assert f"| `{name}` |" in text, f"the manual has no table for {plugin}"
