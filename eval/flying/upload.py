"""`landing-eval upload`: send a policy by radio to the app of a C export, in place of the one there."""

from __future__ import annotations

import collections
import logging
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.models.errors import UserError, not_installed

if TYPE_CHECKING:
    from inclined_landing.eval.flying.interfaces import Clock

_BEGIN, _CHUNK, _STATUS, _COMMIT = 1, 2, 3, 4  # commands of c/landing_policy_file.h.j2
_KEY = 16  # bytes of the hash that name the file
WINDOW = 8  # chunks between two questions: the firmware's queue holds ten packets
PATIENCE = 0.2  # s for a reply: the app looks every 20 ms, a round trip takes 4 to 10 ms
ATTEMPTS = 15  # of a question, or without any progress
_TURN = 0.002  # s between two looks for a reply


def command(policy: AnyPolicy, /, *, uri: Annotated[str, tyro.conf.arg(metavar="URI")]) -> None:
    """Send a policy to the app of a C export on a Crazyflie, in place of the one there.

    The vehicle takes it when it fits what the app was compiled for and passes its self test on the vehicle;
    otherwise it keeps the one it had. The upload is lost when the vehicle is switched off. POLICY may also be
    the policy.bin of an export.

    Args:
        uri: URI of the vehicle in cflib's form, like radio://0/80/2M/E7E7E7E7E7 or udp://127.0.0.1:19850.
    """
    from inclined_landing.eval.flying.link import check_uri, find_radio

    check_uri(uri)
    file = policy_bytes(policy)
    try:
        import cflib.crtp
        from cflib.crazyflie import Crazyflie
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error)) from error
    from rich.console import Console
    from rich.progress import Progress

    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.flying.interfaces import RealClock
    from inclined_landing.eval.flying.vehicle import Radio

    find_radio(uri)
    cflib.crtp.init_drivers()
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # what it logs is said in a sentence
    clock, screen = RealClock(), Console(stderr=True)
    radio = Radio(Crazyflie(), clock, 0.0, dry=True)
    radio.open(uri)
    try:
        began = clock.now()
        with Progress(console=screen, transient=True, disable=not screen.is_terminal) as progress:
            bar = progress.add_task("", total=len(file))
            upload(radio.crazyflie, clock, file, lambda received: progress.update(bar, completed=received))
        seconds = clock.now() - began
    finally:
        radio.close()
    say(
        f"The vehicle accepted {policy}: {len(file)} bytes in {seconds:.1f} s, "
        f"SHA-256 {file[-32:].hex()[:16]}...; it flies it until it is switched off."
    )


def policy_bytes(name: str) -> bytes:
    """Return the policy file of a policy, or of the policy.bin of an export. Raises UserError without one."""
    from inclined_landing.eval.export import contract, policy_file, vectors
    from inclined_landing.eval.export.network import Network
    from inclined_landing.models import storage

    if Path(name).suffix == ".bin":
        file = storage.read_bytes(Path(name), "policy file", 2**24)
        policy_file.check(file, name)
        return file
    policy = contract.load(name).with_fixed_vehicle()
    network = Network.from_policy(policy)
    terms = contract.describe(policy, network)
    return policy_file.encode(terms, policy.task.vehicle, network, vectors.record(policy))


def upload(crazyflie: Any, clock: Clock, file: bytes, tell: Callable[[int], object]) -> None:
    """Send a policy file to a connected vehicle, and have it loaded.

    tell: called with the bytes received so far. Raises UserError where the vehicle refuses, or is silent.
    """
    from inclined_landing.eval.export.c_source import CHUNK

    link = _Link(crazyflie, clock, file)
    received = link.ask(struct.pack("<BI", _BEGIN, len(file)) + link.key)
    stalled = 0
    while received < len(file):
        first = received // CHUNK
        for number in range(first, min(first + WINDOW, -(-len(file) // CHUNK))):
            part = file[number * CHUNK : (number + 1) * CHUNK]
            link.send(struct.pack("<B2sH", _CHUNK, link.key[:2], number) + part)
        before, received = received, link.ask(struct.pack("<B2s", _STATUS, link.key[:2]))
        stalled = 0 if received > before else stalled + 1
        if stalled == ATTEMPTS:
            raise UserError(f"the upload makes no progress at byte {received}; come nearer and try again")
        tell(received)
    link.ask(struct.pack("<B", _COMMIT) + link.key)


class _Link:
    """Questions to the app, and its replies."""

    def __init__(self, crazyflie: Any, clock: Clock, file: bytes):
        from inclined_landing.eval.export.policy_file import HASH

        self.key = file[-HASH:][:_KEY]
        self._clock, self._channel = clock, crazyflie.appchannel
        self._replies: collections.deque[bytes] = collections.deque()
        self._channel.packet_received.add_callback(lambda data: self._replies.append(bytes(data)))

    def send(self, packet: bytes) -> None:
        self._channel.send_packet(packet)

    def ask(self, packet: bytes) -> int:
        """Return the bytes received so far, as the reply to a packet says."""
        from inclined_landing.eval.export.policy_file import WORDS, Answer

        for _ in range(ATTEMPTS):
            self._replies.clear()
            self.send(packet)
            end = self._clock.now() + PATIENCE
            while self._clock.now() < end:
                while self._replies:
                    reply = self._replies.popleft()
                    if len(reply) != 16 or reply[0] != packet[0] or reply[2:4] != self.key[:2]:
                        continue
                    answer, received = reply[1], int.from_bytes(reply[4:8], "little")
                    if answer == Answer.OK:
                        return received
                    words = WORDS[Answer(answer)] if answer in set(Answer) else f"answer {answer}"
                    raise UserError(
                        f"the vehicle refuses the policy: {words}; "
                        f"there the one with SHA-256 {reply[8:].hex()}... acts"
                    )
                self._clock.wait_until(self._clock.now() + _TURN)
        raise UserError(
            "no app for policies answers on the vehicle; build its firmware with a C export of this version"
        )
