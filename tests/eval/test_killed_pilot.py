"""A pilot's process is killed in flight: the vehicle, a process of its own, must come down by itself.

In real time, by cflib over UDP. A machine that is too busy for that flies nothing: such a run is skipped.
"""

import re
import socket
import subprocess
import sys
import time

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["least", "fly"])
def test_motors_stop_and_the_vehicle_comes_down(kind, tmp_path):
    port, poses = free_port(), free_port()
    words = ("crazyflie", f"--port={port}", f"--poses=127.0.0.1:{poses}", "--seconds=60")
    uri = f"udp://127.0.0.1:{port}"
    fly = ("fly", f"--uri={uri}", f"--mocap=poses:127.0.0.1:{poses}", "--yes", f"--out={tmp_path / 'out'}")
    pilots = {"least": (sys.executable, "-c", LEAST, uri), "fly": (*EVAL, *fly)}
    vehicle = subprocess.Popen([*EVAL, *words], stdout=subprocess.PIPE, text=True)
    pilot = None
    try:
        assert uri in vehicle.stdout.readline()
        pilot = subprocess.Popen(pilots[kind], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        awaited(vehicle, "supervisor: flying")
        time.sleep(2.0)
        if pilot.poll() is not None:
            pytest.skip("this machine is too busy to fly in real time")
        pilot.kill()
        pilot.wait()
        # By the vehicle's clock: 0.5 s after the last set-point it levels out, 1 s after the last notice its
        # motors stop; both come within a control period, and the supervisor looks every 0.04 s.
        levels, off = awaited(vehicle, "supervisor: level out"), awaited(vehicle, "motors off")
        assert 0.4 < off - levels < 0.6
        assert awaited(vehicle, "supervisor: locked") - off < 0.1
        assert awaited(vehicle, "at rest on the (floor|platform)") - off < 3.0
    finally:
        for process in (pilot, vehicle):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
