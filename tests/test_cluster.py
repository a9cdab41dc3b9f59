"""A Ray cluster of two nodes, one of which is killed: nothing is lost, and no bit differs.

Both are on this machine, at two addresses of its loopback. They are started as the documentation says, with a
token.
"""

import collections
import contextlib
import ipaddress
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import pytest
import tomlkit

from tests.eval.landings.test_run import STUDY as SMALL
from tests.training import assert_same_policy

pytestmark = pytest.mark.slow
if not hasattr(pytest.importorskip("ray", reason="Ray is not installed (extra `ray`)"), "init"):
    pytest.skip("a folder named ray is no Ray (extra `ray`)", allow_module_level=True)

HEAD, OTHER = "127.0.0.2", "127.0.0.3"
PATIENCE = 240.0  # s for anything
STUDY = SMALL.replace("samples = 24", "samples = 5000")
VEHICLE = """\
based_on = "crazyflie-2.1"
[body]
mass = { value = 0.03, unit = "kg", source = "relative to the folder of the command", uncertainty = 0.001 }
"""
SMALL_RUN = "--environments 8 --rollout 64 --batch-size 256 --checkpoint-every 2 --vehicle light.toml"
RECIPE = {
    "title": "Tiny",
    "question": "Is a training lost?",
    "seeds": [1, 2, 3],
    "commands": [
        f"landing-train landing --steps 32768 {SMALL_RUN} --seed {{seed}} --out {{out}} --no-report",
        "landing-eval success {out}/final.zip --plant analytic --out {out}/s",
    ],
    "numbers": {"strict": {"title": "s", "file": "s/success.json", "row": {"starts": "frozen grid"}}},
}


def until(condition, what, process=None):
    """The first true value of a condition; process: what has to run until then."""
    end = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < end, f"not in {PATIENCE} s: {what}"
        time.sleep(0.1)
    return value


def program(words):
    """landing-train or landing-eval as this Python runs it."""
    return [sys.executable, "-P", "-m", words[0].replace("landing-", "inclined_landing."), *words[1:]]


class Machines:
    """A head and what is added to it, one core each; all processes inherit a mark."""

    def __init__(self, folder: Path):
        self.temp = Path(tempfile.mkdtemp(prefix="r"))  # short: sockets are in it
        self.folder, self.nodes = folder, []
        token = folder / "token"
        token.write_text(secrets.token_hex(32))
        token.chmod(0o600)
        self.mark = ("RAY_AUTH_TOKEN_PATH", str(token))
        self.environment = os.environ | dict([self.mark]) | {"RAY_TMPDIR": str(self.temp)}
        with socket.create_server((HEAD, 0)) as free:
            self.address = f"{HEAD}:{free.getsockname()[1]}"
        words = ["--head", "--port", self.address.split(":")[1], "--disable-usage-stats"]
        self.start(HEAD, *words, "--include-dashboard=false")

    def start(self, address, *words):
        """A node at an address, until its process ends."""
        log = self.folder / f"node-{len(self.nodes)}.log"
        place = ["--node-ip-address", address, "--temp-dir", str(self.temp), "--num-cpus", "1"]
        ray = [str(Path(sys.executable).with_name("ray")), "start", "--block", *place, *words]
        with log.open("wb") as output:
            node = subprocess.Popen(
                ray,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=self.environment | {"RAY_AUTH_MODE": "token"},  # which commands find out themselves
                start_new_session=True,  # no end of a node reaches the test
            )
        self.nodes.append(node)
        until(lambda: b"Ray runtime started" in log.read_bytes() or node.poll() is not None, "node")
        assert node.poll() is None, log.read_text()
        return node

    def add(self):
        """A second node."""
        return self.start(OTHER, "--address", self.address)

    def run(self, *words, cwd):
        """landing-train or landing-eval, begun."""
        return subprocess.Popen(
            program(words),
            cwd=cwd,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def left(self):
        """All processes with the mark that are no zombies."""
        return [process for process in psutil.process_iter() if self._marked(process)]

    def _marked(self, process):
        with contextlib.suppress(psutil.Error):
            return process.environ().get(self.mark[0]) == self.mark[1]
        return False

    def reached(self):
        """The addresses to which they are connected."""
        for process in self.left():
            with contextlib.suppress(psutil.Error):
                for connection in process.net_connections("inet"):
                    if connection.raddr:
                        yield ipaddress.ip_address(connection.raddr.ip)

    def end(self):
        for node in self.nodes:
            node.send_signal(signal.SIGTERM)
        for node in self.nodes:
            node.wait(PATIENCE)
        _, alive = psutil.wait_procs(self.left(), timeout=20)
        for process in alive:
            process.kill()
        shutil.rmtree(self.temp, ignore_errors=True)
        assert not alive


def loopback(address):
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def raylet(node):
    """The process that starts the workers of a node."""
    return next(p for p in psutil.Process(node.pid).children(recursive=True) if p.name() == "raylet")


def kill(node):
    """Kill -9 of a node and its workers, though not of what the workers have started."""
    first = raylet(node)
    workers = first.children()
    for process in (first, *workers):
        process.kill()
    node.wait(PATIENCE)


def busy(node, name):
    """The worker of a node that is at a task of this name."""
    with contextlib.suppress(psutil.Error):
        return next((p for p in raylet(node).children() if p.name().startswith(f"ray::{name}"[:15])), None)


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    made = Machines(tmp_path_factory.mktemp("cluster"))
    try:
        yield made
    finally:
        made.end()


def ended(process, code=0):
    """The output of a command that ends with the code."""
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, out + error
    return out, error


def here(*words, cwd):
    """The same command without a cluster."""
    subprocess.run(program(words), cwd=cwd, check=True, capture_output=True)


@pytest.fixture(scope="module")
def landings(tmp_path_factory):
    """The results of the study without a cluster."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "tiny.toml").write_text(STUDY)
    here("landing-eval", "landings", "tiny.toml", "--out", "here", cwd=folder)
    return (folder / "here" / "results.parquet").read_bytes()


def test_a_study_loses_a_node(machines, tmp_path, landings):
    (tmp_path / "tiny.toml").write_text(STUDY)
    node = machines.add()
    words = ("landing-eval", "landings", "tiny.toml", "--out", "ray", "--engine", "ray")
    process = machines.run(*words, "--address", machines.address, cwd=tmp_path)
    parts = tmp_path / "ray" / "parts"
    until(lambda: list(parts.glob("0*.parquet")) and busy(node, "run_chunk"), "chunks on both nodes", process)
    assert (reached := set(machines.reached())) and all(map(loopback, reached)), reached
    kill(node)
    assert process.poll() is None and len(list(parts.glob("0*.parquet"))) < 10
    ended(process)
    assert (tmp_path / "ray" / "results.parquet").read_bytes() == landings


def trainings(folder):
    """The commands that are at work in each run folder."""
    found = collections.defaultdict(list)
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = process.cmdline()
            if "inclined_landing.train" in words and str(folder) in " ".join(words):
                found[Path(words[words.index("--out") + 1]).relative_to(folder).parts[0]].append(process)
    numbers = {process.pid for group in found.values() for process in group}
    return {  # but for what they start themselves
        run: [p for p in group if p.ppid() not in numbers] for run, group in found.items()
    }


def test_a_sweep_loses_a_node(machines, tmp_path):
    (tmp_path / "tiny.toml").write_text(tomlkit.dumps(RECIPE))
    (tmp_path / "light.toml").write_text(VEHICLE)
    node, folder = machines.add(), tmp_path / "ray"
    words = ("landing-train", "sweep", "tiny.toml")
    on = ("--on", "ray", "--address", machines.address)
    process = machines.run(*words, "--out", "ray", *on, cwd=tmp_path)

    def under_way():
        worker = busy(node, "work")
        own = worker.children() if worker else []
        for run, group in trainings(folder).items():
            if own and own[0] in group and (folder / run / "checkpoint.pt").exists():
                return run, own[0]

    run, training = until(under_way, "a checkpoint on the second node", process)
    kill(node)
    assert process.poll() is None and not (folder / run / "metrics.json").exists()
    assert psutil.wait_procs([training], timeout=10)[0], "the training goes on without its node"
    resumed = False
    while process.poll() is None:
        now = trainings(folder)
        assert all(len(group) <= 1 for group in now.values()), "two processes in one run folder"
        with contextlib.suppress(psutil.Error):
            resumed |= any("--resume" in one.cmdline() for one in now.get(run, ()))
        time.sleep(0.1)
    ended(process)
    assert resumed
    here(*words, "--out", "here", "--jobs", "2", cwd=tmp_path)
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("ray", "here")]
    assert results[0]["measured"] == results[1]["measured"]
    for seed in RECIPE["seeds"]:
        assert_same_policy(*(tmp_path / name / f"seed-{seed}" / "final.zip" for name in ("ray", "here")))
