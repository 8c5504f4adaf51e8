"""An OpenIGTLink peer of ours: sends updates to all who listen, and reads what they send.

The work is done by `exchange` in a process of its own. Nothing here waits for a peer.
"""

from __future__ import annotations

import json
import secrets
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Self

from glissando.errors import DeviceError
from glissando.hardware.openigtlink.address import Address, WireFrame
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.link import ARRIVAL, Packet, PacketLink
from glissando.hardware.openigtlink.message import Message, decode

_START, _END = 60.0, 5.0  # s that the process may take to begin and to end
_MOST = 256  # messages that one look takes, so that a flood cannot hold the caller up
_LOOKS = 8  # that take all that waits: as many messages as the process keeps


class Endpoint:
    """A client or a server, at an address as `Address.parse` reads it; a context manager.

    Args:
        address: igtl://host:port calls there, again and again until somebody answers;
            igtl-server://host:port listens there, on 127.0.0.1 unless a host is given.
        hears: Whether messages of peers are received, and not just thrown away.

    Attributes:
        address: The address in parts, its port the one that is listened at.
        peers: How many peers are connected.
        counts: Events: peers 'connected', 'lost', 'silent', 'refused' for what they sent, 'turned
            away'; 'updates dropped' for slow peers; 'messages dropped', 'malformed' or 'of unread
            types'; 'not sent', because the process had not taken the update before.

    Raises:
        DeviceError: The address is wrong, or cannot be listened at; in any method, the process
            that speaks with peers has ended.
    """

    def __init__(self, address: str, *, hears: bool = True) -> None:
        self.text, self.address = address, Address.parse(address)
        self._mode = "hear" if hears else "tell"
        self.peers, self._started = 0, False
        self._own, self._theirs = Counter[str](), Counter[str]()
        self._link: PacketLink | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._early: list[tuple[float, Message]] = []

    @property
    def counts(self) -> Counter[str]:
        """How often something happened, by its name."""
        return self._own + self._theirs

    def __enter__(self) -> Self:
        with socket.create_server(("127.0.0.1", 0)) as door:
            port, token = door.getsockname()[1], secrets.token_bytes(16)
            command = [sys.executable, "-m", "glissando.hardware.openigtlink.peer_server"]
            # A session of its own: Ctrl-C at the terminal is for the estimator alone.
            self._process = subprocess.Popen(
                [*command, str(port), self.text, self._mode],
                stdin=subprocess.PIPE,
                start_new_session=True,
            )
            try:
                assert self._process.stdin is not None
                self._process.stdin.write(token)
                self._process.stdin.close()
                self._link = PacketLink(_met(door, token))
                deadline = time.monotonic() + _START
                while not self._started and time.monotonic() < deadline:
                    self._early = self.receive()  # all that has come so far
                    time.sleep(0.005)
            except BaseException:
                self.close()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the link, with which the process ends."""
        if self._link is not None:
            self._link.close()
        if self._process is not None:
            try:
                self._process.wait(_END)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._link = None

    def send(self, messages: Sequence[bytes]) -> bool:
        """Send encoded messages, as one update that each peer gets whole or not at all.

        Returns:
            Whether the process took them; it never waits for it.
        """
        sent = self._open().send(Packet.BUNDLE, b"".join(messages))
        self._own["not sent"] += not sent
        self._require_alive()
        return sent

    def receive(self) -> list[tuple[float, Message]]:
        """Messages that came since the last call, 256 at most, with their arrivals.

        Returns:
            Seconds of time.monotonic() at which each came, and the message.
        """
        out, self._early = self._early, []
        link = self._open()
        link.flush()
        for kind, data in link.receive(_MOST):
            if kind == Packet.MESSAGE:
                try:
                    out.append((ARRIVAL.unpack_from(data)[0], decode(data[ARRIVAL.size :])))
                except MessageError:
                    self._own["malformed"] += 1
            elif kind == Packet.REPORT:
                report = json.loads(data)
                self.peers, self._started = report["peers"], True
                self._theirs = Counter(report["counts"])
                self.address = Address(**{**vars(self.address), "port": report["port"]})
            elif kind == Packet.FAILURE:
                raise DeviceError(data.decode())
        self._require_alive()
        return out

    def receive_all(self) -> list[tuple[float, Message]]:
        """What `receive` gives until nothing waits: the newest is among it, and a flood ends."""
        out: list[tuple[float, Message]] = []
        for _ in range(_LOOKS):
            if not (came := self.receive()):
                break
            out += came
        return out

    def _open(self) -> PacketLink:
        if self._link is None:
            raise DeviceError("The endpoint is closed; use it as `with Endpoint(…) as endpoint:`.")
        return self._link

    def _require_alive(self) -> None:
        if self._open().ended:
            raise DeviceError(f"The process that serves {self.text} has ended; start again.")


class EndpointUser:
    """What speaks with peers through an endpoint of its own; a context manager.

    Args:
        address: As `Endpoint` takes it.
        hears: Whether messages of peers are received, and not just thrown away.
    """

    def __init__(self, address: str, *, hears: bool = True) -> None:
        self._endpoint = Endpoint(address, hears=hears)
        self._frame = WireFrame.of(self._endpoint.address)
        self._own = Counter[str]()

    def __enter__(self) -> Self:
        self._endpoint.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._endpoint.close()

    @property
    def port(self) -> int:
        """The port that is called or listened at."""
        return self._endpoint.address.port

    @property
    def counts(self) -> Counter[str]:
        """What was left out, and what happened to the peers."""
        return self._own + self._endpoint.counts


def _met(door: socket.socket, token: bytes) -> socket.socket:
    """The connection of the process that states the token. Raises DeviceError."""
    deadline = time.monotonic() + _START
    while (left := deadline - time.monotonic()) > 0.0:
        door.settimeout(left)
        try:
            connected, _ = door.accept()
        except TimeoutError:
            break
        connected.settimeout(_END)
        with suppress(OSError):
            if secrets.compare_digest(connected.recv(16, socket.MSG_WAITALL), token):
                return connected
        connected.close()  # somebody else found the port
    raise DeviceError("The process that speaks with peers did not start; start it again.")
