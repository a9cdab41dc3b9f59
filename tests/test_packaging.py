"""What an installation must hold: plugins found, constants in step, imports light."""

import dataclasses
import importlib.metadata
import json
import subprocess
import sys
from importlib import resources

import pytest

from inclined_landing.models import plugins
from inclined_landing.models.parameters import load_vehicle


def python(code: str) -> str:
    """Output of `code` in a fresh interpreter, away from the repository."""
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", code],
        capture_output=True, text=True, cwd="/",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_mujoco_registers_the_plugins():
    xml = (
        '<mujoco><extension><plugin plugin="inclined_landing.rotors"><instance name="i"/></plugin>'
        '</extension><worldbody><body><freejoint/><geom size="1"/><site name="s"/></body>'
        '</worldbody><actuator><plugin site="s" gear="0 0 1 0 0 0" instance="i" actdim="1" '
        'plugin="inclined_landing.rotors"/></actuator></mujoco>'
    )
    assert python(f"import mujoco; print(mujoco.MjModel.from_xml_string({xml!r}).na)") == "1\n"


@pytest.mark.parametrize("order", ["mujoco, inclined_landing.models.plugins as p"] + [
    "inclined_landing.models.plugins as p, mujoco"
])  # fmt: skip
def test_either_import_order_loads_once(order):
    names = python(f"import {order}; p.load(); p.load(); print(*p.loaded().names)")
    assert names.split() == list(plugins.NAMES)


def test_loader_imports_nothing_heavy():
    heavy = ("torch", "numba", "gymnasium", "stable_baselines3", "matplotlib", "numpy", "mujoco")
    code = "import inclined_landing.models.plugins, sys; print(*sys.modules)"
    assert not set(heavy) & set(python(code).split())


def test_import_mujoco_stays_light():
    heavy = {"torch", "numba", "gymnasium", "stable_baselines3", "matplotlib"}
    assert not heavy & set(python("import mujoco, sys; print(*sys.modules)").split())


def test_version_mismatch_is_an_import_error_naming_both(monkeypatch):
    library, build = plugins._find()
    monkeypatch.setattr(plugins, "_handle", None)
    monkeypatch.setattr(plugins, "_find", lambda: (library, build | {"mujoco": "3.9.1"}))
    with pytest.raises(ImportError, match=r"built for MuJoCo 3\.9\.1, but MuJoCo 4\.0\.0 .*reinst"):
        plugins.load()


def test_missing_library_is_an_import_error(monkeypatch):
    monkeypatch.setattr(plugins, "_handle", None)
    monkeypatch.setattr(plugins, "_find", lambda: (None, {}))
    with pytest.raises(ImportError, match=r"are not built .*compiler.*reinstall"):
        plugins.load()
    assert plugins.loaded() == plugins.PluginStatus((), None, None, {})


def test_defaults_of_the_build_are_the_vehicle_files():
    vehicle = dataclasses.asdict(load_vehicle())
    wanted = {plugin: {a: vehicle[f] for a, f in table.items()} for plugin, table in plugins.fields().items()}
    assert plugins.loaded().defaults == json.loads(json.dumps(wanted)), (
        "models/crazyflie.toml has changed since the plugins were built: " + plugins._REMEDY
    )


def test_build_record_lies_beside_the_library():
    status = plugins.loaded()
    record = json.loads((status.library.parent / "_build.json").read_text("utf-8"))
    assert record["mujoco"] == status.built_for == importlib.metadata.version("mujoco")


@pytest.mark.parametrize("name", ["crazyflie.toml", "mjcf/crazyflie.xml", "mjcf/landing.xml"])
def test_data_files_are_found(name):
    assert (resources.files("inclined_landing.models") / name).is_file()


def test_version_is_the_distributions():
    import inclined_landing

    assert inclined_landing.__version__ == importlib.metadata.version("inclined-landing")
