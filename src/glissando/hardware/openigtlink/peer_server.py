"""The process that communicates with OpenIGTLink peers, so that none can delay an estimator.

`python -m glissando.hardware.openigtlink.peer_server PORT ADDRESS MODE` connects to the estimator
at PORT of this machine, sends the token that it reads from standard input, and then listens at
ADDRESS or connects to it, with retries. Messages of peers are passed on if MODE is "hear", and
discarded otherwise.
Each peer has a queue of a few updates; if it reads too slowly, the oldest are dropped. The data of
a peer are bounded in size and rate. The process ends with the estimator's side of the link.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import sys
import time
from collections import Counter, deque
from dataclasses import dataclass, field

from glissando.errors import DeviceError
from glissando.hardware.openigtlink.address import Address
from glissando.hardware.openigtlink.contents import StartTracking
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.link import ARRIVAL, Packet, PacketLink
from glissando.hardware.openigtlink.message import Framer, Message, encode

_PEERS = 16  # largest number of connected peers
_QUEUE = 4  # updates in the queue of a peer
_KERNEL = 1 << 17  # bytes that the system may buffer for a peer; buffered updates become stale
_WAITING = 2048  # messages queued for the estimator
_INPUT_LIMIT = 1 << 22  # bytes a second that a peer may send
_DISCARDED_LIMIT = 1 << 16  # the same if messages are discarded
_READ = 1 << 16
_STALL_LIMIT = 10.0  # s in which a peer accepts no byte before it is disconnected
_AGAIN = 0.5  # s between attempts to connect
_CALL = 2.0  # s allowed for an attempt
_REPORT = 0.25  # s between reports
_REST, _LOOK = 0.05, 0.001  # s of waiting for an event; while messages are to be passed on


@dataclass
class _Peer:
    """A connected peer, its queue of updates, and the bytes it may still send in this second."""

    socket: socket.socket
    framer: Framer = field(default_factory=Framer)
    waiting: deque[bytes] = field(default_factory=deque)
    going: memoryview = field(default_factory=lambda: memoryview(b""))
    sent: float = field(default_factory=time.monotonic)
    budget: int = 0

    def push(self) -> None:
        """Send as much as the peer accepts. Raises OSError if it has disconnected."""
        while self.going or self.waiting:
            self.going = self.going or memoryview(self.waiting.popleft())
            try:
                self.going = self.going[self.socket.send(self.going) :]
            except (BlockingIOError, InterruptedError):
                return
            self.sent = time.monotonic()
        self.sent = time.monotonic()


class PeerServer:
    """Connects peers at an address with the estimator's link.

    Args:
        address: Address of the peers.
        link: Link to the estimator.
        hears: Whether messages of peers are passed on.

    Raises:
        DeviceError: The address cannot be listened on.
    """

    def __init__(self, address: Address, link: PacketLink, *, hears: bool = True) -> None:
        self.address, self._link, self._hears = address, link, hears
        self._allowed = _INPUT_LIMIT if hears else _DISCARDED_LIMIT
        self.counts: Counter[str] = Counter()
        self._peers: dict[socket.socket, _Peer] = {}
        self._messages: deque[bytes] = deque(maxlen=_WAITING)
        self._selector = selectors.DefaultSelector()
        self._selector.register(link.socket, selectors.EVENT_READ)
        self._server: socket.socket | None = None
        self._calling: socket.socket | None = None
        self._failed = 0  # attempts: a host may have several addresses, which are tried in turn
        self._next_call = self._next_report = self._second = time.monotonic()
        self._reported = 0  # peers
        self.port = address.port
        if address.listens:
            self._listen()

    def _listen(self) -> None:
        where = self.address.host, self.address.port
        try:
            self._server = socket.create_server(where, backlog=_PEERS)
        except (OSError, OverflowError) as problem:
            raise DeviceError(
                f"Port {where[1]} of {where[0]} cannot be listened at ({problem}); close the "
                f"program that does, or give another port, or 0 for any."
            ) from None
        self._server.setblocking(False)
        self.port = self._server.getsockname()[1]
        self._selector.register(self._server, selectors.EVENT_READ)

    def run(self) -> None:
        """Serve peers until the estimator's side of the link is closed."""
        while not self._link.ended:
            self._call()
            for key, events in self._selector.select(_LOOK if self._messages else _REST):
                self._serve(key.fileobj, events)  # type: ignore[arg-type]
            self._check_peers()
            self._pass_on()

    def _serve(self, ready: socket.socket, events: int) -> None:
        if ready is self._link.socket:
            for kind, data in self._link.receive():
                if kind == Packet.BUNDLE:
                    self._broadcast(data)
        elif ready is self._server:
            with contextlib.suppress(OSError):
                self._add_peer(ready.accept()[0])
        elif ready is self._calling:
            self._answered(ready)
        elif ready in self._peers:
            if events & selectors.EVENT_READ:
                self._receive(self._peers[ready])
            if events & selectors.EVENT_WRITE and ready in self._peers:
                self._push(self._peers[ready])

    def _call(self) -> None:
        """Connect to the peer unless it is connected, or an attempt was made recently."""
        now = time.monotonic()
        if self.address.listens or self._peers or now < self._next_call:
            return
        if self._calling is not None:
            self._hang_up()
        self._next_call = now + _CALL
        with contextlib.suppress(OSError):
            found = socket.getaddrinfo(
                self.address.host, self.address.port, type=socket.SOCK_STREAM
            )
            family, kind, protocol, _, where = found[self._failed % len(found)]
            self._calling = socket.socket(family, kind, protocol)
            self._calling.setblocking(False)
            self._selector.register(self._calling, selectors.EVENT_WRITE)
            try:
                self._calling.connect(where)
            except BlockingIOError:
                pass
            except OSError:  # no route to the host: the attempt has failed
                self._hang_up()

    def _hang_up(self) -> None:
        assert self._calling is not None
        self._selector.unregister(self._calling)
        self._calling.close()
        self._calling, self._next_call = None, time.monotonic() + _AGAIN
        self._failed += 1

    def _answered(self, calling: socket.socket) -> None:
        if calling.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._hang_up()
            return
        self._selector.unregister(calling)
        self._calling = None
        peer = self._add_peer(calling)
        if peer and self.address.start:
            peer.waiting.append(encode(Message(StartTracking(self.address.start), "glissando")))
            self._push(peer)

    def _add_peer(self, connected: socket.socket) -> _Peer | None:
        if len(self._peers) >= _PEERS:
            self.counts["turned away"] += 1
            connected.close()
            return None
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL)
        peer = self._peers[connected] = _Peer(connected, budget=self._allowed)
        self._selector.register(connected, selectors.EVENT_READ)
        self.counts["connected"] += 1
        return peer

    def _broadcast(self, bundle: bytes) -> None:
        for peer in list(self._peers.values()):
            peer.waiting.append(bundle)
            if len(peer.waiting) > _QUEUE:
                peer.waiting.popleft()
                self.counts["updates dropped"] += 1
            self._push(peer)

    def _push(self, peer: _Peer) -> None:
        try:
            peer.push()
        except OSError:
            self._let_go(peer, "lost")
            return
        self._select_events(peer)

    def _select_events(self, peer: _Peer) -> None:
        """Select the events of a peer: writable with queued updates, readable within its budget."""
        busy = bool(peer.going or peer.waiting)
        events = selectors.EVENT_WRITE * busy | selectors.EVENT_READ * (peer.budget > 0)
        current = self._selector.get_map().get(peer.socket)
        if not events:
            if current:
                self._selector.unregister(peer.socket)
        elif current is None:
            self._selector.register(peer.socket, events)
        elif current.events != events:
            self._selector.modify(peer.socket, events)

    def _receive(self, peer: _Peer) -> None:
        arrival = time.monotonic()
        try:
            data = peer.socket.recv(min(_READ, peer.budget))
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self._let_go(peer, "lost")
            return
        peer.budget -= len(data)
        before = peer.framer.skipped
        try:
            messages = peer.framer.feed(data)
        except MessageError:
            self._let_go(peer, "refused")
            return
        self.counts["of unread types"] += peer.framer.skipped - before
        for message in messages if self._hears else ():
            if len(self._messages) == _WAITING:
                self.counts["messages dropped"] += 1
            self._messages.append(ARRIVAL.pack(arrival) + message)
        self._select_events(peer)

    def _let_go(self, peer: _Peer, why: str) -> None:
        self.counts[why] += 1
        with contextlib.suppress(KeyError):
            self._selector.unregister(peer.socket)
        del self._peers[peer.socket]
        peer.socket.close()
        self._next_call = time.monotonic() + _AGAIN

    def _check_peers(self) -> None:
        now = time.monotonic()
        fresh = now >= self._second
        if fresh:
            self._second = now + 1.0
        for peer in list(self._peers.values()):
            if fresh and peer.budget < self._allowed:
                peer.budget = self._allowed
                self._select_events(peer)
            if (peer.going or peer.waiting) and now - peer.sent > _STALL_LIMIT:
                self._let_go(peer, "silent")

    def _pass_on(self) -> None:
        """Pass on messages, and report at intervals and when the number of peers changes."""
        link = self._link
        while self._messages and link.send(Packet.MESSAGE, self._messages[0]):
            self._messages.popleft()
        now, peers = time.monotonic(), len(self._peers)
        if now >= self._next_report or peers != self._reported:
            report = {"peers": peers, "port": self.port, "counts": dict(self.counts)}
            if link.send(Packet.REPORT, json.dumps(report).encode()):
                self._next_report, self._reported = now + _REPORT, peers


def main(arguments: list[str]) -> None:
    """Connect to the estimator and serve peers; the arguments are its port, address and mode."""
    connected = socket.create_connection(("127.0.0.1", int(arguments[0])))
    connected.sendall(sys.stdin.buffer.read(16))
    link = PacketLink(connected)
    try:
        server = PeerServer(Address.parse(arguments[1]), link, hears=arguments[2] == "hear")
    except DeviceError as problem:
        link.send(Packet.FAILURE, str(problem).encode())
        return
    with contextlib.suppress(KeyboardInterrupt):
        server.run()


if __name__ == "__main__":
    main(sys.argv[1:])
