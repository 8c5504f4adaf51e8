"""Messages are byte for byte the C++ library's, and nothing malformed becomes a value."""

import json
import math
import time
import tracemalloc
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glissando.errors import DeviceError
from glissando.hardware.openigtlink import Message, decode, encode, seconds_since, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.message import read_header
from igtl_messages import random_messages
from oracles.crc64_bitwise import crc64_bitwise

UNREAD = [
    "BIND",
    "CAPABILITY",
    "COLORTABLE",
    "COLORT",
    "COMMAND",
    "IMAGE",
    "IMGMETA",
    "LBMETA",
    "TRAJ",
    "VIDEOMETA",
]
REASONS = {"SHORT_BUFFER": "read on", "CRC_MISMATCH": "CRC-64"}  # words of no other


def test_every_type_that_is_read_is_written_byte_for_byte_as_the_library_writes_it(openigtlink):
    fixtures = json.loads((openigtlink / "fixtures.json").read_text())["fixtures"]
    versions = set()
    for name, fixture in fixtures.items():
        wire = bytes.fromhex(fixture["wire_hex"])
        assert crc64(wire[58:]) == read_header(wire).crc, name
        if fixture["type_id"] in UNREAD:
            with pytest.raises(MessageError, match=fixture["type_id"]):
                decode(wire)
            continue
        message = decode(wire)
        assert encode(message) == wire, name
        assert message.content.type_id == fixture["type_id"]
        versions.add(message.version)
    assert versions == {1, 2}


def test_the_librarys_values_are_read(openigtlink):
    fixtures = json.loads((openigtlink / "fixtures.json").read_text())["fixtures"]
    message = decode(bytes.fromhex(fixtures["tdataFormat2"]["wire_hex"]))
    tool = message.content.tools[1]
    assert (tool.name, tool.kind, message.identity) == ("Tracker1", c.TOOL_6D, 1)
    assert message.metadata == {"First patient age": "22", "Second patient age": "25"}
    np.testing.assert_allclose(tool.matrix[:3, 3], [46.0531, 19.4709, 46.0531], rtol=1e-6)
    np.testing.assert_allclose(tool.matrix[:3, 0], [-0.954892, 0.196632, -0.222525], rtol=1e-6)
    mesh = decode(bytes.fromhex(fixtures["polydata"]["wire_hex"])).content
    assert mesh.points.shape == (8, 3)
    assert mesh.polygons[3].tolist() == [1, 2, 6, 5]
    assert mesh.attributes[0].name == "attr"
    assert mesh.attributes[0].values.ravel().tolist() == list(range(8))


@pytest.mark.slow
def test_random_messages_come_back_as_they_were():
    rng = np.random.default_rng(1)
    for _ in range(20):
        for message in random_messages(rng):
            again = decode(encode(message))
            assert encode(again) == encode(message)
            assert again.metadata == message.metadata
            assert (again.device, again.stamp) == (message.device, message.stamp)
            np.testing.assert_equal(asdict(again.content), asdict(message.content))


def test_the_checksum_is_that_of_the_definition():
    rng = np.random.default_rng(2)
    for length in [*range(40), 63, 64, 65, 500, 1025]:
        data = rng.bytes(length)
        assert crc64(data) == crc64_bitwise(data), length


def test_malformed_messages_are_refused_for_their_reason(openigtlink):
    corpus = openigtlink / "spec" / "corpus" / "negative"
    entries = json.loads((corpus / "index.json").read_text())["entries"]
    assert len(entries) == 32
    for name, entry in entries.items():
        wire = (corpus / entry["path"]).read_bytes()
        with pytest.raises(MessageError) as refused:
            decode(wire)
        said = str(refused.value)
        for reason, words in REASONS.items():
            assert (words in said) == (entry["error_class"] == reason), name
        if "messages are not read" in said:
            assert read_header(wire).type_id in UNREAD, name


def _mutated(wire: bytes, rng, *, sealed: bool) -> bytes:
    """The message with bytes changed, cut or added; sealed, its size and checksum fit again."""
    out = bytearray(wire)
    begin = 58 if sealed else 0
    for _ in range(int(rng.integers(1, 6))):
        if len(out) > begin:
            out[int(rng.integers(begin, len(out)))] = int(rng.choice([0, 1, 127, 255, 4, 70]))
    if rng.random() < 0.3:
        out = out[: int(rng.integers(begin, len(out) + 1))]
    if rng.random() < 0.2:
        out += rng.bytes(int(rng.integers(1, 80)))
    if sealed:
        out[42:50] = (len(out) - 58).to_bytes(8, "big")
        out[50:58] = crc64(bytes(out[58:])).to_bytes(8, "big")
    return bytes(out)


@pytest.mark.slow
def test_ten_thousand_mutated_messages_are_read_or_refused_in_bounded_time_and_memory():
    rng = np.random.default_rng(3)
    wires = [encode(m) for _ in range(4) for m in random_messages(rng)]
    mutated = [_mutated(wires[k % len(wires)], rng, sealed=k % 5 > 0) for k in range(10_000)]
    read, longest = 0, 0.0
    tracemalloc.start()
    try:
        for wire in mutated:
            began = time.thread_time()
            try:
                decode(wire)
                read += 1
            except MessageError:
                pass
            longest = max(longest, time.thread_time() - began)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 500 < read < 9500  # both happen
    assert peak < 4e6
    assert longest < 0.1


@pytest.mark.parametrize("at", range(0, 40, 4))
def test_a_count_of_four_thousand_million_allocates_nothing(at):
    wire = encode(Message(c.CONTENTS["POLYDATA"](np.zeros((4, 3)), lines=(np.arange(4),))))
    body = bytearray(wire[58:])
    body[at : at + 4] = b"\xff\xff\xff\xfc"
    wire = wire[:50] + crc64(bytes(body)).to_bytes(8, "big") + bytes(body)
    tracemalloc.start()
    try:
        with pytest.raises(MessageError):
            decode(wire)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


@settings(max_examples=200, deadline=None)
@given(
    code=st.sampled_from(sorted(c._SCALARS)),
    shape=st.lists(st.sampled_from([0, 1, 2, 65535]), max_size=255),
)
@example(code=11, shape=[1] * 65)
@example(code=11, shape=[65535] * 4 + [0])
def test_an_array_of_any_stated_shape_is_read_or_refused(code, shape):
    count = math.prod(shape)
    size = count * np.dtype(c._SCALARS[code]).itemsize if count <= 16 else 16
    data = bytes([code, len(shape)]) + np.array(shape, ">u2").tobytes() + bytes(size)
    try:
        assert c.NumberArray.unpack(data).values.shape == tuple(shape)
    except MessageError:
        assert count > 16 or len(shape) > 32 or 65535 in shape


def test_a_stamp_loses_nothing_where_a_float_of_seconds_would():
    origin = stamp_of(1_700_000_000.0)
    for ticks in (1, 12345, (1 << 51) + 1):
        assert seconds_since(origin + ticks, origin) * 2**32 == ticks
    rng = np.random.default_rng(4)
    for seconds in rng.uniform(0.0, 1e3, 100):
        assert abs(seconds_since(stamp_of(seconds), 0) - seconds) <= 2.0**-33


def test_what_does_not_fit_a_field_is_refused_when_written():
    with pytest.raises(DeviceError, match="21 bytes"):
        encode(Message(c.Text("x"), "d" * 21))
    with pytest.raises(DeviceError, match="STRING"):
        encode(Message(c.Text("x" * 70_000)))
    with pytest.raises(DeviceError, match="255 numbers"):
        encode(Message(c.SensorValues(np.zeros(256))))
    with pytest.raises(DeviceError, match="version 1"):
        encode(Message(c.Text("x"), metadata={"a": "b"}))
    with pytest.raises(DeviceError, match="NDARRAY"):
        encode(Message(c.NumberArray(np.zeros(3, dtype=bool))))
