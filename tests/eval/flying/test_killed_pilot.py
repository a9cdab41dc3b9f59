"""A pilot's process is killed in flight: the vehicle, a process of its own, must come down without it.

In real time, by cflib over UDP. A machine that is too busy for that flies nothing: such a run is skipped.
"""

import contextlib
import re
import shutil
import socket
import subprocess
import sys
import time

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from inclined_landing.eval.flying.simulated.crazyflie import fly_simulated
from inclined_landing.eval.flying.watchdog import DeadManSwitch
from inclined_landing.eval.logs import read_log
from inclined_landing.models.errors import UserError

# Stop, emergency stop and that of older firmware: port, channel and two bits that are set in a byte, data.
STOP = {b"\x7c\x00", b"\x9d\x03", b"\x6d\x03"}
EVAL = (sys.executable, "-m", "inclined_landing.eval")
# The least pilot: rises, feeds the emergency watchdog, looks at nothing.
LEAST = """
import sys, time
import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
cflib.crtp.init_drivers()
with SyncCrazyflie(sys.argv[1], cf=Crazyflie()) as connected:
    for k in range(100000):
        connected.cf.commander.send_setpoint(0, 0, 0, 0 if k < 25 else 34500)
        connected.cf.supervisor.send_emergency_stop_watchdog()
        time.sleep(0.02)
"""


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def awaited(vehicle, pattern):
    """When, by the vehicle's clock [s], it printed the first line with the pattern."""
    for line in vehicle.stdout:
        if re.search(pattern, line):
            return float(line.split()[0])
    pytest.skip("this machine is too busy to fly in real time")


@contextlib.contextmanager
def killed_in_flight(kind, folder):
    """A vehicle whose pilot was killed; and when, by the vehicle's clock [s]."""
    port, poses = free_port(), free_port()
    words = ("crazyflie", f"--port={port}", f"--poses=127.0.0.1:{poses}", "--seconds=60")
    uri = f"udp://127.0.0.1:{port}"
    fly = ("fly", f"--uri={uri}", f"--mocap=poses:127.0.0.1:{poses}", "--yes", f"--out={folder / 'out'}")
    pilots = {"least": (sys.executable, "-c", LEAST, uri), "fly": (*EVAL, *fly)}
    vehicle = subprocess.Popen([*EVAL, *words], stdout=subprocess.PIPE, text=True)
    pilot = None
    try:
        assert uri in vehicle.stdout.readline()
        pilot = subprocess.Popen(pilots[kind], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        clock = awaited(vehicle, "supervisor: flying") - time.monotonic()
        time.sleep(2.0)
        if pilot.poll() is not None:
            pytest.skip("this machine is too busy to fly in real time")
        pilot.kill()
        killed = clock + time.monotonic()
        pilot.wait()
        yield vehicle, killed
    finally:
        for process in (pilot, vehicle):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()


@pytest.mark.slow
def test_the_firmware_stops_the_motors_a_second_after_any_pilot(tmp_path):
    with killed_in_flight("least", tmp_path) as (vehicle, _):
        # By the vehicle's clock: 0.5 s after the last set-point it levels out, 1 s after the last notice its
        # motors stop; both come within a control period, and the supervisor looks every 0.04 s.
        levels, off = awaited(vehicle, "supervisor: level out"), awaited(vehicle, "motors off")
        assert 0.4 < off - levels < 0.6
        assert awaited(vehicle, "supervisor: locked") - off < 0.1
        assert awaited(vehicle, "at rest on the (floor|platform)") - off < 3.0


@pytest.mark.slow
def test_the_dead_man_s_switch_stops_them_at_once_and_a_log_is_left(tmp_path):
    with killed_in_flight("fly", tmp_path) as (vehicle, killed):
        off = awaited(vehicle, "motors off")
        if off < killed:
            pytest.skip("this machine is too busy to fly in real time: the pilot has ended the flight")
        # A process wakes up, a packet flies, the supervisor looks: half of the firmware's first limit.
        assert off - killed < 0.25
        assert awaited(vehicle, "supervisor: locked") - off < 0.1
        assert awaited(vehicle, "at rest on the (floor|platform)") - off < 3.0
    assert read_log(tmp_path / "out" / "flight_01.unfinished.csv").duration > 1.0


class Listener:
    """A socket in the place of a vehicle."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.uri = f"udp://127.0.0.1:{self.socket.getsockname()[1]}"

    def heard(self, seconds):
        """Every packet until that many seconds are silent."""
        self.socket.settimeout(seconds)
        packets = set()
        with contextlib.suppress(TimeoutError):
            while True:
                packets.add(self.socket.recv(64))
        return packets


HOLDER = """
import os, sys
from inclined_landing.eval.flying.watchdog import DeadManSwitch
with DeadManSwitch(sys.argv[1]):
    if sys.argv[2] == "dies":
        os.kill(os.getpid(), 9)
"""


@pytest.mark.parametrize("end", ["dies", "returns"])
def test_the_switch_sends_the_stop_when_its_process_dies_and_only_then(end):
    listener = Listener()
    done = subprocess.run([sys.executable, "-c", HOLDER, listener.uri, end], capture_output=True, timeout=60)
    assert done.returncode == (-9 if end == "dies" else 0), done.stderr
    assert listener.heard(0.1) == (STOP if end == "dies" else set())
    listener.socket.close()


def test_what_the_switch_sends_stops_a_vehicle_in_the_air():
    flight = fly_simulated(seed=1)
    flight.crazyflie.open_link(flight.uri)
    for k in range(40):
        flight.crazyflie.commander.send_setpoint(0, 0, 0, 0 if k < 5 else 45000)
        flight.clock.wait_until(flight.clock.now() + 0.02)
    assert flight.world.thrust > 0.0
    for packet in STOP:
        flight.world.send((packet[0], packet[1:]))
    flight.clock.wait_until(flight.clock.now() + 0.1)
    assert flight.world.thrust == 0.0 and flight.crazyflie.supervisor.is_locked


def test_no_flight_without_the_switch(monkeypatch):
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    with pytest.raises(UserError, match="has not started"), DeadManSwitch("udp://127.0.0.1:1"):
        pytest.fail("entered")
