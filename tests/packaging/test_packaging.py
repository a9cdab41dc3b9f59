"""What an installation must hold: plugins found, constants in step, imports light."""

import dataclasses
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib

import pytest

from inclined_landing.envs.ids import IDS
from inclined_landing.envs.tasks import TASKS
from inclined_landing.eval.cli import COMMANDS
from inclined_landing.models import plugins
from inclined_landing.models.parameters import load_vehicle
from tests import ROOT


def python(code: str) -> str:
    """Output of `code` in a fresh interpreter, away from the repository."""
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", code],
        capture_output=True, text=True, cwd="/",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def installed_by(extra: str) -> set[str]:
    """Modules of the packages that an extra installs; extra: a regular expression."""
    wanted = {re.match("[A-Za-z0-9_.-]+", r).group() for r in importlib.metadata.requires("inclined-landing")
              if re.search(f"extra == .{extra}\\b", r)} - {"inclined-landing"}  # fmt: skip
    found = importlib.metadata.packages_distributions()
    return {name for name, owners in found.items() if {o.replace("_", "-").lower() for o in owners} & wanted}


def without(names: set[str], code: str) -> str:
    """Output of `code` where these modules are not found."""
    return python(
        "import sys\n"
        "class Hidden:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if any(f'{{name}}.'.startswith(f'{{hidden}}.') for hidden in {sorted(names)!r}):\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        f"sys.meta_path.insert(0, Hidden())\n{code}"
    )


def without_extras(code: str) -> str:
    """Output of `code` where nothing is found that an extra installs."""
    names = installed_by(".*")
    assert {"torch", "stable_baselines3", "tyro", "rich", "scipy", "matplotlib", "PIL"} <= names
    return without(names, code)


def test_gymnasium_knows_the_tasks_whichever_is_imported_first():
    known = "print(*(n for n in gymnasium.registry if str(gymnasium.spec(n).entry_point).startswith('incl')))"
    for order in ("import inclined_landing, gymnasium", "import mujoco, gymnasium, inclined_landing"):
        assert tuple(python(f"{order}; {known}").split()) == IDS
    forms = (
        "(gymnasium.make(m + 'Setpoint-v0').spec.id for m in ('inclined_landing.envs:', 'inclined_landing:'))"
    )
    assert python(f"import gymnasium; print(*{forms}); {known}").split() == ["Setpoint-v0"] * 2 + [*IDS]


def test_ids_are_those_of_the_tasks():
    assert IDS == tuple(f"{kind.__name__}-v0" for kind in TASKS.values())
    assert all(name == kind.name for name, kind in TASKS.items())


def test_the_base_flies_with_five_packages():
    needed = {re.match("[a-z]+", r).group() for r in importlib.metadata.requires("inclined-landing")
              if "extra ==" not in r}  # fmt: skip
    assert needed == {"mujoco", "numpy", "numba", "gymnasium", "msgspec"}
    code = (
        "import gymnasium, inclined_landing.models.effects, inclined_landing.models.scene\n"
        "env, policy = inclined_landing.make_for('landing', disable_env_checker=True)\n"
        "seen, _ = env.reset(seed=0)\n"
        "for _ in range(3): seen, *_ = env.step(policy.predict(seen))\n"
        "from inclined_landing.envs.rendering import make_renderer, pose_from_state\n"
        "pose = pose_from_state(env.unwrapped.batch.plant.state[0], None)\n"
        "print(make_renderer(64, 48, backend='ray').render(pose).shape)"
    )
    assert without_extras(code) == "(48, 64, 3)\n"


def test_what_an_extra_installs_is_named_with_the_remedy():
    code = (
        "import contextlib\n"
        "from inclined_landing.eval import cli\n"
        "from inclined_landing.train.cli import main as train\n"
        "with contextlib.redirect_stderr(sys.stdout):\n"
        "    codes = {cli.main([name]) for name in cli.COMMANDS}\n"
        "    print(codes, train(['landing']))\n"
        "try: import inclined_landing.envs.sb3\n"
        "except ImportError as error: print(error)\n"
        "assert cli.main(['--help']) == 0"
    )
    missing = "is not installed; pip install 'inclined-landing"
    *said, codes, sb3 = without_extras(code).split("usage:")[0].splitlines()
    assert codes == "{2} 2" and len(said) == len(COMMANDS) + 1
    library = r"[a-z0-9_]+"  # whichever is imported first
    *evaluations, training = said
    for words in evaluations:
        assert re.fullmatch(rf"landing-eval: {library} {missing}\[[a-z]+\]'", words), words
    assert re.fullmatch(rf"landing-train: {library} {missing}\[train\]'", training)
    assert re.fullmatch(rf"{library} {missing}\[train\]'", sb3)


@pytest.mark.slow
def test_training_needs_nothing_of_evaluation(tmp_path):
    evaluation = installed_by("eval") - installed_by("train")
    assert {"matplotlib", "pandas", "scipy", "rosbags", "PIL"} <= evaluation
    tiny = "--steps 128 --environments 4 --rollout 16 --batch-size 64 --evaluate-every 1 --threads 1".split()
    words = ["setpoint", *tiny, "--out", str(tmp_path / "run")]
    code = (
        "import contextlib\n"
        "from inclined_landing.train.cli import main\n"
        "with contextlib.redirect_stderr(sys.stdout):\n"
        f"    print('code', main({words!r}))\n"
        f"    print('code', main([*{words!r}, '--resume']))\n"
        f"    print('code', main(['sweep', 'landing', '--out', {str(tmp_path / 'sweep')!r}]))\n"
    )
    remedy = r"\w+ is not installed; pip install 'inclined-landing\[eval\]'"
    said = without(evaluation, code).splitlines()
    told = f"landing-train: no report, because {remedy}; after that, the same command with --resume writes it"
    assert [line for line in said if re.fullmatch(told, line)], said
    assert [line for line in said if line.startswith("code")] == ["code 0", "code 0", "code 2"]
    assert re.search(remedy, said[-2]) and not (tmp_path / "sweep").exists()
    assert {"final.zip", "learning.csv", "metrics.json"} <= {p.name for p in (tmp_path / "run").iterdir()}
    # Nor of its modules, which come with the package.
    alone = [*words[:-1], str(tmp_path / "alone"), "--no-report"]
    without({"inclined_landing.eval"}, f"from inclined_landing.train.cli import main; main({alone!r})")
    assert (tmp_path / "alone" / "final.zip").exists()


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
    names = python(f"import {order}; p.load(); p.load(); print(*p.loaded()[0])")
    assert names.split() == list(plugins.NAMES)


def test_loader_imports_nothing_heavy():
    heavy = ("torch", "numba", "gymnasium", "stable_baselines3", "matplotlib", "numpy", "mujoco")
    code = "import inclined_landing.models.plugins, sys; print(*sys.modules)"
    assert not set(heavy) & set(python(code).split())


def test_version_mismatch_is_an_import_error_naming_both(monkeypatch):
    library, build = plugins._find()
    monkeypatch.setattr(plugins, "_handle", None)
    monkeypatch.setattr(plugins, "_find", lambda: (library, build | {"mujoco": "3.9.1"}))
    with pytest.raises(ImportError, match=r"built for MuJoCo 3\.9\.1, but MuJoCo 4\.0\.0 .*reinst"):
        plugins.load()


def test_defaults_of_the_build_are_the_vehicle_files():
    vehicle = dataclasses.asdict(load_vehicle())
    wanted = {plugin: {a: vehicle[f] for a, f in table.items()} for plugin, table in plugins.fields().items()}
    _, _, build = plugins.loaded()
    assert {name: build[name] for name in wanted} == json.loads(json.dumps(wanted)), (
        "models/crazyflie.toml has changed since the plugins were built: " + plugins._REMEDY
    )


def test_the_page_has_the_layers_of_the_contracts():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    packages, rooms = (one["layers"] for one in project["tool"]["importlinter"]["contracts"][:2])
    blocks = re.findall(r"```text\n(.*?)\n```", (ROOT / "docs/architecture.md").read_text("utf-8"), re.DOTALL)
    assert blocks[0] == "\n".join(packages).replace("inclined_landing.", "")
    assert blocks[1] == "\n".join(rooms[1:]).replace("(", "").replace(")", "")
