"""What is said on an Aurora's wire: never a pose from a damaged reply, never a crash."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators, law
from glissando.hardware.drivers.aurora import Aurora
from glissando.hardware.drivers.aurora_protocol import (
    bx_length,
    crc16,
    frame_command,
    parse_ascii,
    parse_bx,
    parse_handles,
    parse_tx,
)
from glissando.hardware.drivers.aurora_reply import ERRORS, GarbledError, RefusedError, Reply
from glissando.hardware.simulated_devices.aurora_wire import (
    PortReport,
    bx_reply,
    crc,
    text_reply,
    tx_reply,
)

A_REPORT = 15  # mutated replies of each report
many = settings(law, max_examples=200)  # with four tests, 12,000 of them
VECTORS = {
    "INIT:": 0xE3A5,
    "OKAY": 0xA896,
    "RESET": 0xBE6F,
    "VER:0": 0x65EE,
    "GETINFO:Features.Firmware.Version": 0x0492,
    "TX:0801": 0xC19B,
    "BX:0801": 0x00EC,
    "TSTART:": 0x5423,
    "TSTOP:": 0x2C14,
    "PHSR:02": 0xE17E,
    "PINIT:0A": 0xD5EB,
    "PENA:0AD": 0xAD1E,
    "ERROR01": 0x6BC2,
    "COMM:50000": 0x0048,
    "010A001": 0xC1B5,
    "00": 0x1414,
}


@pytest.mark.parametrize("text", VECTORS)
def test_the_crc_is_the_one_seen_on_real_wires(text):
    assert crc16(text.encode()) == crc(text.encode()) == VECTORS[text]


@given(st.binary(max_size=100))
@law
def test_the_crc_by_table_is_the_crc_bit_by_bit(data):
    assert crc16(data) == crc(data)


@st.composite
def reports(draw):
    """What a device tells of several handles, with frame number and system status."""
    told = []
    for handle in draw(st.lists(st.integers(1, 0x7F), max_size=5, unique=True)):
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        quaternion = rng.standard_normal(4)
        place, quality = rng.uniform(-900.0, 900.0, 3), rng.uniform(0.0, 5.0)
        values = np.r_[quaternion / np.linalg.norm(quaternion), place, quality]
        kind = draw(st.sampled_from(["", "", "missing", "DISABLED", "UNOCCUPIED"]))
        seen = values if kind == "" else None
        condition = kind if kind.isupper() else ""
        status = draw(st.integers(0, 2**32 - 1)) & ~0x100
        told.append(PortReport(handle, status, seen, condition))
    return told, draw(st.integers(0, 2**32 - 1)), draw(st.integers(0, 2**16 - 1))


@given(reports(), st.booleans())
@settings(law, max_examples=150)
def test_tx_and_bx_of_the_same_frame_agree_to_their_resolution(report, bare):
    tx, bx = parse_tx(tx_reply(*report, bare)), parse_bx(bx_reply(*report))
    told, number, status = report
    assert tx.status == bx.status == status
    assert len(tx.ports) == len(bx.ports) == len(told)
    for one, other, truth in zip(tx.ports, bx.ports, told, strict=True):
        assert one.handle == other.handle == truth.handle
        if truth.condition:
            assert one.condition == truth.condition.lower()
            assert other.condition == "disabled"
            assert one.pose is None
            assert other.pose is None
            continue
        assert one.number == other.number == number
        assert one.status == other.status == truth.status
        assert one.missing == other.missing == (truth.values is None)
        if truth.values is None:
            assert one.pose is None
            assert other.pose is None
            continue
        for reading, far in ((one, 0.0051e-3), (other, 1e-7)):
            assert np.abs(reading.pose[:3, 3] - 1e-3 * truth.values[4:7]).max() < far
        assert np.abs(one.pose[:3, :3] - other.pose[:3, :3]).max() < 4e-4
        assert abs(one.quality - other.quality) < 1e-4


def mutated(data, rng):
    """The bytes with a few of them changed, lost, doubled or added."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, few = int(rng.integers(0, len(out) + 1)), int(rng.integers(1, 20))
        match rng.choice(["flip", "cut", "lose", "double", "add"]):
            case "flip" if at < len(out):
                out[at] ^= 1 << int(rng.integers(0, 8))
            case "cut":
                del out[at:]
            case "lose":
                del out[at : at + few]
            case "double":
                out[at:at] = out[at : at + few]
            case _:
                out[at:at] = rng.bytes(few)
    return bytes(out)


def whole(raw, binary):
    """Whether the CRCs of a reply fit, by the other implementation."""
    if not binary:
        return raw[-1:] == b"\r" and raw[-5:-1].upper() == b"%04X" % crc(raw[:-5])
    lengths = len(raw) >= 8 and int.from_bytes(raw[2:4], "little") == len(raw) - 8
    sums = (raw[:4], raw[4:6]), (raw[6:-2], raw[-2:])
    return lengths and all(crc(a) == int.from_bytes(b, "little") for a, b in sums)


def sealed(body, binary):
    """A reply with this body, its CRCs right."""
    if not binary:
        return body + b"%04X\r" % crc(body)
    head = b"\xc4\xa5" + struct.pack("<H", len(body))
    return head + struct.pack("<H", crc(head)) + body + struct.pack("<H", crc(body))


def harmless(raw, binary):
    """Parse: poses only of whole replies, and only ones that are poses; no other exception."""
    try:
        reply = (parse_bx if binary else parse_tx)(raw)
    except (GarbledError, RefusedError):
        return
    assert whole(raw, binary)
    for port in reply.ports:
        assert (port.pose is not None) == (port.condition == "valid")
        if port.pose is not None:
            rotation = port.pose[:3, :3]
            assert np.all(np.isfinite(port.pose))
            assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            assert not port.broken


@pytest.mark.slow
@pytest.mark.parametrize("resealed", [False, True], ids=["as it came", "with a right CRC"])
@pytest.mark.parametrize("binary", [False, True], ids=["TX", "BX"])
@given(report=reports(), bare=st.booleans(), rng=generators, noise=st.binary(max_size=200))
@many
def test_a_mutated_reply_is_garbled_or_whole_with_true_poses(
    binary, resealed, report, bare, rng, noise
):
    raw = bx_reply(*report) if binary else tx_reply(*report, bare)
    body = raw[6:-2] if binary else raw[:-5]
    harmless(noise, binary)
    for _ in range(A_REPORT):
        wire = sealed(mutated(body, rng), binary) if resealed else mutated(raw, rng)
        harmless(wire, binary)


@given(raw=st.binary(max_size=60), resealed=st.booleans())
@settings(law, max_examples=300)
def test_random_bytes_are_no_list_of_handles(raw, resealed):
    try:
        handles = parse_handles(parse_ascii(sealed(raw, False) if resealed else raw))
    except (GarbledError, RefusedError):
        return
    assert all(0 <= handle <= 0xFF for handle in handles)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -3.697314e28, 0.0])
def test_a_number_that_is_no_pose_is_missing(bad):
    values = np.r_[[bad] * 4, 1.0, 2.0, 3.0, 0.1]
    (port,) = parse_bx(bx_reply([PortReport(10, 0x31, values)], 5, 0)).ports
    assert (port.missing, port.pose) == (True, None)


@pytest.mark.parametrize("binary", [False, True], ids=["TX", "BX"])
def test_a_broken_coil_has_no_pose_and_one_out_of_the_volume_is_marked(binary):
    values = np.r_[1.0, 0, 0, 0, 1, 2, 3, 0.1]
    states = enumerate((0x131, 0x71, 0xB1, 0x31), start=10)
    reports = [PortReport(handle, status, values) for handle, status in states]
    reply = (
        parse_bx(bx_reply(reports, 5, 0)) if binary else parse_tx(tx_reply(reports, 5, 0, False))
    )
    broken, out, partly, inside = reply.ports
    assert (broken.broken, broken.pose) == (True, None)
    assert (out.out_of_volume, partly.partially_out) == (True, True)
    assert (out.good, partly.good, inside.good) == (False, False, True)


@pytest.mark.parametrize("code", ERRORS)
def test_every_error_is_a_sentence(code):
    with pytest.raises(RefusedError, match=rf"ERROR{code:02X}: .{{15,}}\.$") as caught:
        parse_tx(text_reply(f"ERROR{code:02X}"))
    assert caught.value.code == code


def test_an_unknown_error_and_a_wrong_beginning_are_sentences():
    with pytest.raises(RefusedError, match="ERROR7E"):
        parse_ascii(text_reply("ERROR7E"))
    with pytest.raises(GarbledError, match="beginning"):
        bx_length(b"ERROR0")
    assert frame_command("PHSR:02") == b"PHSR:02E17E\r"  # as clients frame it


def test_one_command_that_came_damaged_does_not_change_how_frames_are_read(monkeypatch):
    """ERROR01 is what a device says that does not know BX, and of a damaged BX as well."""
    tracker, replies = Aurora("nowhere"), []
    monkeypatch.setattr(tracker, "_request", lambda: replies.pop(0)())

    def refuse():
        raise RefusedError(1)

    def answer():
        return Reply((), 0)

    for _ in range(20):
        replies[:] = [refuse, refuse, answer]
        assert [tracker._poll() for _ in range(3)] == [None, None, answer()]
    assert tracker._binary
    replies[:] = [refuse] * 8
    while replies and tracker._binary:
        assert tracker._poll() is None
    assert len(replies) == 4
    with pytest.raises(RefusedError):
        [tracker._poll() for _ in range(4)]
