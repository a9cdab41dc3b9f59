"""A simulated Crazyflie as a process of its own: CRTP over UDP for cflib's `UdpDriver`, in real time.

One datagram is one packet, its header and its data. A pilot connects to `udp://HOST:PORT`; poses go out as
the datagrams of `positions.py`. If the pilot is killed, the vehicle continues by the firmware's rules.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable

import numpy as np

from inclined_landing.eval.flying import positions
from inclined_landing.eval.flying.interfaces import MeasuredPose
from inclined_landing.eval.flying.simulated.body import FLOOR
from inclined_landing.eval.flying.simulated.crtp import LARGEST, Packet
from inclined_landing.eval.flying.simulated.firmware import State
from inclined_landing.eval.flying.simulated.world import World
from inclined_landing.models.attitude import VX, VZ
from inclined_landing.models.errors import UserError
from inclined_landing.models.storage import reason

_PROBE = b"\xff"  # cflib's scan: any answer will do
_TURN = 0.002  # s between two looks at the clock
_BEHIND = 0.2  # s that the simulation may lag behind the clock before it lets that time go
_STILL = 0.02  # m/s
_QUIET = 1.0  # s after a peer in which no other is named: many may take turns
# The firmware calls it so, also on the console, whether the vehicle is in the air or on the ground.
_NAMES = {State.FREE_FALL: 'motors stopped (state "free fall")'}


class SimulatorServer:
    """Serves one world on a UDP port and streams its poses to an address.

    say: called with every line of what happens. Raises UserError where the port is taken.
    """

    def __init__(
        self, world: World, port: int, poses_to: tuple[str, int], say: Callable[[str], None] = print
    ):
        self.world, self._say, self._poses_to = world, say, poses_to
        self._peer: tuple[str, int] | None = None
        self._radio = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._poses = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._radio.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self.close()
            raise UserError(f"port {port} cannot be used: {reason(error)}") from error
        self._radio.setblocking(False)
        self.port, self._quiet = self._radio.getsockname()[1], 0.0
        world.on_packet, world.on_pose = self._send, self._show
        world.on_message = self._tell
        self._mode, self._thrust, self._places = world.firmware.state, 0.0, "on the floor"

    def run(self, seconds: float = float("inf")) -> None:
        """Run for that many seconds of real time."""
        world, begin = self.world, time.monotonic() - self.world.time
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            if now - begin - world.time > _BEHIND:
                self._tell(f"this machine is too slow; skipped {now - begin - world.time:.2f} s")
                begin = now - world.time
            if select.select([self._radio], [], [], _TURN)[0]:
                self._receive(time.monotonic() - begin)
            world.advance(time.monotonic() - begin)
            self._watch()

    def close(self) -> None:
        """Close the sockets."""
        self._radio.close()
        self._poses.close()

    def _receive(self, now: float) -> None:
        try:
            data, peer = self._radio.recvfrom(LARGEST + 2)
        except OSError:  # a datagram that was damaged on its way
            return
        if data == _PROBE:
            self._datagram(self._radio, _PROBE, peer)
        elif data:
            if peer != self._peer and now >= self._quiet:
                self._tell(f"connected from {peer[0]}:{peer[1]}")
                self._quiet = now + _QUIET
            self._peer = peer
            self.world.advance(now)
            self.world.send((data[0], data[1:]))

    def _send(self, packet: Packet) -> None:
        if self._peer is not None:
            self._datagram(self._radio, bytes([packet[0]]) + packet[1], self._peer)

    def _show(self, pose: MeasuredPose) -> None:
        self._datagram(self._poses, positions.encode(pose, self.world.time), self._poses_to)

    @staticmethod
    def _datagram(sender: socket.socket, data: bytes, to: tuple[str, int]) -> None:
        try:
            sender.sendto(data, to)
        except OSError:  # nobody is there, or the network is: as on the air, it is lost
            pass

    def _watch(self) -> None:
        world = self.world
        if world.firmware.state is not self._mode:
            self._mode = world.firmware.state
            self._tell(f"supervisor: {_NAMES.get(self._mode) or self._mode.name.lower().replace('_', ' ')}")
        if (world.thrust > 0.0) != (self._thrust > 0.0):
            x, y, z = world.body.state[:3]
            self._tell(f"motors {'on' if world.thrust > 0.0 else 'off'} at {x:.2f}, {y:.2f}, {z:.2f} m")
            self._thrust = world.thrust
        where = "on the floor" if world.body.touching[FLOOR] else "on the platform"
        speed = float(np.linalg.norm(world.body.state[VX : VZ + 1]))
        places = where if world.body.touching.any() and speed < _STILL else ""
        if places and places != self._places:
            x, y, z = world.body.state[:3]
            self._tell(f"at rest {places} at {x:.2f}, {y:.2f}, {z:.2f} m")
        if places or not world.body.touching.any():
            self._places = places

    def _tell(self, line: str) -> None:
        self._say(f"{self.world.time:9.3f} s  {line}")
