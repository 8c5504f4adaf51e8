"""Peers get whole updates; a slow, dead or malicious one costs nobody else anything."""

import json
import os
import signal
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.openigtlink import Endpoint, Message, decode, encode
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink import endpoint as endpoint_module
from glissando.hardware.openigtlink import peer_server as peer_server_module
from glissando.hardware.openigtlink.address import Address
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.link import Packet, PacketLink
from glissando.hardware.openigtlink.message import Framer
from glissando.hardware.openigtlink.peer_server import PeerServer
from igtl_messages import random_messages
from waiting import until


def _update(number: int, size: int = 20) -> list[bytes]:
    """Two messages that belong together."""
    text = encode(Message(c.Text(f"{number}"), "number"))
    return [text, encode(Message(c.NumberArray(np.full(size, float(number))), "array"))]


def _numbers(messages) -> list[int]:
    """Numbers of the updates; each must have come whole."""
    texts, arrays = messages[0::2], messages[1::2]
    assert len(texts) == len(arrays)
    for text, array in zip(texts, arrays, strict=True):
        assert np.all(array.content.values == float(text.content.text))
    return [int(text.content.text) for text in texts]


def _connected(server: Endpoint, count: int = 1) -> list[socket.socket]:
    before = server.peers
    clients = [socket.create_connection(("127.0.0.1", server.address.port)) for _ in range(count)]
    until(lambda: server.receive() or server.peers == before + count)
    return clients


def _read(client: socket.socket, framer: Framer) -> list[Message]:
    client.settimeout(0.2)
    try:
        return [decode(raw) for raw in framer.feed(client.recv(1 << 16))]
    except TimeoutError:
        return []


def _newest(messages) -> int:
    """The number of the last update that came whole; -1 before."""
    arrays = [m for m in messages if m.content.type_id == "NDARRAY"]
    return int(arrays[-1].content.values[0]) if arrays else -1


@pytest.mark.slow
def test_a_stream_cut_anywhere_is_the_same_messages():
    rng = np.random.default_rng(1)
    wires = [encode(m) for m in random_messages(rng)]
    unread = encode(Message(c.Text("x" * 300), "skipped")).replace(b"STRING", b"IMAGES", 1)
    stream = b"".join(wire + unread for wire in wires)
    for _ in range(20):
        cuts = np.sort(rng.integers(0, len(stream), size=int(rng.integers(1, 60))))
        framer, out = Framer(), []
        for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
            out += framer.feed(stream[begin:end])
        assert out == wires
        assert framer.skipped == len(wires)


def test_a_body_that_is_not_read_takes_no_memory():
    huge = bytearray(encode(Message(c.Text(""), "d")).replace(b"STRING", b"IMAGES", 1))
    huge[42:50] = (10**12).to_bytes(8, "big")
    framer = Framer()
    for _ in range(100):
        assert framer.feed(bytes(huge) if not framer.skipped else bytes(1 << 16)) == []
        assert len(framer._held) == 0


@pytest.mark.parametrize("garbage", [b"GET / HTTP/1.1\r\n" * 8, bytes(64), b"\xff" * 64])
def test_what_is_no_message_ends_the_stream(garbage):
    with pytest.raises(MessageError):
        Framer().feed(garbage)


def test_a_message_beyond_the_limit_is_refused_by_its_header():
    wire = encode(Message(c.NumberArray(np.zeros(2000)), "d"))
    with pytest.raises(MessageError, match="1000 are read"):
        Framer(1000).feed(wire[:58])


@pytest.mark.slow
def test_peers_get_the_same_whole_updates_and_can_answer():
    with Endpoint("igtl-server://:0") as server:
        where = f"igtl://127.0.0.1:{server.address.port}"
        with Endpoint(where) as one, Endpoint(where) as other:
            until(lambda: server.receive() or server.peers == 2)
            for number in range(3):
                until(lambda number=number: server.send(_update(number)))
            for client in (one, other):
                read = []
                until(lambda r=read, cl=client: r.extend(m for _, m in cl.receive()) or len(r) > 5)
                assert _numbers(read) == [0, 1, 2]
            one.send(_update(7))
            read = []
            until(lambda: read.extend(m for _, m in server.receive()) or len(read) > 1)
            assert _numbers(read) == [7]


def test_a_peer_that_comes_or_goes_is_reported_at_once(monkeypatch):
    monkeypatch.setattr(peer_server_module, "_REPORT", 1e9)  # only the first comes of its own
    with socket.create_server(("127.0.0.1", 0)) as door:
        near = PacketLink(socket.create_connection(door.getsockname()))
        far = PacketLink(door.accept()[0])
    exchange, reports = PeerServer(Address.parse("igtl-server://:0"), far), []
    thread = threading.Thread(target=exchange.run, daemon=True)
    thread.start()

    def peers():
        reports.extend(json.loads(data) for kind, data in near.receive() if kind == Packet.REPORT)
        return [report["peers"] for report in reports]

    until(lambda: peers() == [0])
    one = socket.create_connection(("127.0.0.1", exchange.port))
    until(lambda: peers() == [0, 1])
    one.close()
    until(lambda: peers() == [0, 1, 0])
    near.close()
    thread.join()
    far.close()
    exchange._server.close()


@pytest.mark.parametrize("problem", [OSError(101, "Network is unreachable"), PermissionError()])
def test_a_call_that_fails_at_once_is_no_connection(monkeypatch, problem):
    class Unreachable(socket.socket):
        def connect(self, where):
            raise problem

    near, far = socket.socketpair()
    with near, far:
        exchange = PeerServer(Address.parse("igtl://127.0.0.1:1"), SimpleNamespace(socket=far))
        monkeypatch.setattr(peer_server_module.socket, "socket", Unreachable)
        exchange._call()
        assert exchange._calling is None
        assert [key.fileobj for key in exchange._selector.get_map().values()] == [far]
        assert exchange._next_call > time.monotonic()
        exchange._call()  # not yet
        assert exchange.counts == {}


def test_a_host_of_several_addresses_is_called_at_each_in_turn(monkeypatch):
    found = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", ("127.0.0.1", 1))]  # nobody is there
    near, far = socket.socketpair()
    with near, far, socket.create_server(("127.0.0.1", 0)) as door:
        found.append((*found[0][:4], door.getsockname()))
        monkeypatch.setattr(peer_server_module.socket, "getaddrinfo", lambda *_, **__: found)
        monkeypatch.setattr(peer_server_module, "_AGAIN", 0.0)
        exchange = PeerServer(Address.parse("igtl://both:1"), SimpleNamespace(socket=far))

        def connected():
            exchange._call()
            for key, events in exchange._selector.select(0.01):
                exchange._serve(key.fileobj, events)
            return exchange._peers

        (peer,) = until(connected, 5.0)
        exchange._let_go(exchange._peers[peer], "lost")
        (peer,) = until(connected, 5.0)
        assert exchange._failed == 1  # who answered is called first
        peer.close()


@pytest.mark.slow
def test_what_a_peer_sends_before_the_endpoint_looks_comes_once(monkeypatch):
    met = endpoint_module._met
    monkeypatch.setattr(endpoint_module, "_met", lambda *a: (met(*a), time.sleep(0.5))[0])
    with socket.create_server(("127.0.0.1", 0)) as door:

        def send():
            with door.accept()[0] as caller:
                caller.sendall(b"".join(wire for k in range(20) for wire in _update(k)))
                caller.recv(1)  # until it hangs up

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        with Endpoint(f"igtl://127.0.0.1:{door.getsockname()[1]}") as client:
            read = []
            until(lambda: read.extend(m for _, m in client.receive()) or len(read) >= 40)
            time.sleep(0.1)
            read += [m for _, m in client.receive()]
        thread.join()
    assert _numbers(read) == list(range(20))


@pytest.mark.slow
def test_a_slow_peer_misses_old_updates_and_the_others_none():
    with Endpoint("igtl-server://:0") as server:
        slow, quick = _connected(server, 2)
        framer, got, count = Framer(), [], 120
        for number in range(count):
            until(lambda n=number: server.send(_update(n, 8000)))
            until(lambda n=number: got.extend(_read(quick, framer)) or _newest(got) == n)
        assert _numbers(got) == list(range(count))
        until(lambda: server.receive() or server.counts["updates dropped"])
        framer, late = Framer(), []
        until(lambda: late.extend(_read(slow, framer)) or _newest(late) == count - 1)
        numbers = _numbers(late)
        assert numbers == sorted(set(numbers))
        missed = count - len(numbers)
        assert missed > 0
        until(lambda: server.receive() or server.counts["updates dropped"] == missed)
        slow.close()
        quick.close()


def test_malicious_and_dead_peers_are_let_go_and_the_others_served():
    with Endpoint("igtl-server://:0") as server:
        good, garbage, dying = _connected(server, 3)
        garbage.sendall(b"GET / HTTP/1.1\r\n\r\n" * 10)
        dying.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        dying.close()  # with a reset
        until(lambda: server.receive() or server.peers == 1)
        assert server.counts["refused"] == 1
        until(lambda: server.send(_update(5)))
        framer, read = Framer(), []
        until(lambda: read.extend(_read(good, framer)) or len(read) > 1)
        assert _numbers(read) == [5]
        good.close()
        garbage.close()


@pytest.mark.slow
def test_a_flood_is_heard_at_a_bounded_rate():
    flood = b"".join(_update(1)) * 50
    with Endpoint("igtl-server://:0") as server:
        (client,) = _connected(server)
        client.settimeout(0.2)
        sent, end = 0, time.monotonic() + 1.5
        while time.monotonic() < end:
            try:
                sent += client.send(flood)
            except TimeoutError:
                break
            assert len(server.receive()) <= 256
        assert sent < 6e7
        client.close()


@pytest.mark.slow
def test_the_seventeenth_peer_is_turned_away():
    with Endpoint("igtl-server://:0") as server:
        clients = _connected(server, 16)
        extra = socket.create_connection(("127.0.0.1", server.address.port))
        until(lambda: server.receive() or server.counts["turned away"])
        assert extra.recv(1) == b""
        for client in (*clients, extra):
            client.close()


@pytest.mark.slow
def test_sending_never_waits_even_if_the_process_stands_still():
    with Endpoint("igtl-server://:0") as server:
        os.kill(server._process.pid, signal.SIGSTOP)
        try:
            slowest = 0.0
            for number in range(200):
                began = time.thread_time()
                server.send(_update(number, 8000))
                slowest = max(slowest, time.thread_time() - began)
            assert server.counts["not sent"] > 0
            assert slowest < 0.05
        finally:
            os.kill(server._process.pid, signal.SIGCONT)


@pytest.mark.slow
def test_a_client_calls_until_somebody_answers_and_again_when_he_is_gone():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with Endpoint(f"igtl://127.0.0.1:{port}") as client:
        for number in range(3):
            with Endpoint(f"igtl-server://127.0.0.1:{port}") as server:
                until(lambda s=server: s.receive() or s.peers)
                server.send(_update(number))
                read = []
                until(lambda r=read: r.extend(m for _, m in client.receive()) or len(r) > 1)
                assert _numbers(read) == [number]
        until(lambda: client.receive() or client.counts["connected"] == 3)


@pytest.mark.slow
def test_a_tracker_is_asked_for_tracking_data_on_connecting():
    with Endpoint("igtl-server://:0") as tracker:
        where = f"igtl://127.0.0.1:{tracker.address.port}?start=20"
        with Endpoint(where):
            ((_, message),) = until(tracker.receive)
    assert message.content == c.StartTracking(20)


def test_a_server_listens_on_this_machine_alone_unless_told():
    assert Address.parse("igtl-server://:0").host == "127.0.0.1"
    assert Address.parse("igtl-server://0.0.0.0:5").host == "0.0.0.0"
    with Endpoint("igtl-server://:0") as server:
        own = socket.gethostbyname(socket.gethostname())
        if own.startswith("127."):
            pytest.skip("this machine has no address but 127.0.0.1")
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((own, server.address.port), 2.0)


@pytest.mark.slow
def test_a_port_that_is_taken_and_a_process_that_died_are_sentences():
    with Endpoint("igtl-server://:0") as server:
        with (
            pytest.raises(DeviceError, match=r"Port \d+ of 127.0.0.1 cannot be listened at"),
            Endpoint(f"igtl-server://:{server.address.port}"),
        ):
            pass
        os.kill(server._process.pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match="has ended"):
            until(server.receive)


@pytest.mark.parametrize(
    "text",
    [
        "host:1",
        "http://host",
        "igtl://host:x",
        "igtl://h?unit=inch",
        "igtl://h?a=1",
        "igtl://h/p",
        f"igtl://h?start={1 << 31}",
        "igtl://h?start=-1",
    ],
)
def test_what_is_no_address_is_explained(text):
    with pytest.raises(DeviceError, match="igtl://host:port"):
        Address.parse(text)
