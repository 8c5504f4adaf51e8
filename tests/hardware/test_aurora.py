"""The Aurora's driver, and other people's, against a simulated device in its own process."""

import errno
import socket
import sys
import threading
import time
from contextlib import ExitStack
from types import SimpleNamespace

import ndicapy
import numpy as np
import pytest
import serial
from sksurgerynditracker.nditracker import NDITracker

from aurora_bench import SPEED, measured_time, simulated, tell_tale
from glissando.errors import DeviceError, SimulationError
from glissando.hardware.drivers import Aurora, aurora
from glissando.hardware.drivers.link import ConnectionLostError, DeviceTimeoutError, Link
from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.travel import MESSAGE

FAST = ("--rate", "200")


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def read(tracker, count):
    return [tracker.read(5.0) for _ in range(count)]


def readings(frames):
    return [(frame, port) for frame in frames for port in frame.ports if port.pose is not None]


def require_true(frames, epoch, rate):
    """Every pose is the truth of its frame's number, and times are better than arrivals."""
    found = readings(frames)
    said = np.array([measured_time(port.pose, epoch) for _, port in found])
    drift = said - np.array([frame.number for frame, _ in found]) / rate
    assert np.ptp(drift) < 1e-3  # BX is good for 0.1 ms, TX for 0.25 ms of this
    times, arrivals = np.array([(frame.time, frame.arrival) for frame, _ in found]).T
    settled = slice(len(found) // 2, None)
    off, late = np.median((times - said)[settled]), np.median((arrivals - said)[settled])
    assert -2e-3 < off < late + 5e-4
    return off


def stalls(tracker, monkeypatch):
    """A list that grows by each time (s) that the host keeps the tracker waiting for nothing.

    In a poll, or from one to the next, but for what it meant to sleep.
    """
    found, poll, asked, polled = [], tracker._poll, [], [time.monotonic()]

    def sleep(wait):
        asked.append(wait)
        time.sleep(wait)

    def timed_poll():
        start = time.monotonic()
        found.append(start - polled[-1] - sum(asked))
        reply = poll()
        asked.clear()
        polled.append(time.monotonic())
        found.append(polled[-1] - start)
        return reply

    monkeypatch.setattr(aurora, "time", SimpleNamespace(sleep=sleep, monotonic=time.monotonic))
    monkeypatch.setattr(tracker, "_poll", timed_poll)
    return found


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize(("where", "count"), [("--tcp", 240), ("--pty", 80)])
def test_no_frame_is_lost_at_40_hz_but_what_the_host_sleeps_through(
    tmp_path, monkeypatch, where, count
):
    place = "0" if where == "--tcp" else str(tmp_path / "aurora")
    with simulated(tmp_path, where, place) as (address, epoch), Aurora(address) as tracker:
        waits = stalls(tracker, monkeypatch)
        frames = read(tracker, count)
        counts, slept = tracker.counts, np.array(waits)
        # A device keeps its newest frame only. An idle host never stalls for so long.
        assert counts["dropped"] <= np.sum(np.ceil(slept[slept > 5e-3] * 40.0))
        assert counts["dropped"] == frames[-1].number - frames[0].number + 1 - count
        assert counts["bad_crc"] == counts["missing"] == counts["reconnects"] == 0
        require_true(frames, epoch, 40.0)


@pytest.mark.slow
def test_old_firmware_is_read_by_tx(tmp_path):
    options = (*FAST, "--firmware", "AURORA Rev 008")
    with simulated(tmp_path, *options) as (address, epoch), Aurora(address, rate=200.0) as tracker:
        assert "Rev 008" in tracker.version
        frames = read(tracker, 60)
        require_true(frames, epoch, 200.0)
        places = np.array([port.pose[:3, 3] for _, port in readings(frames)])
        assert np.allclose(places, np.rint(places * 1e5) * 1e-5)


LINE = {"bad_crc": 3, "silent": 2, "duplicates": 10}
FRAMES = {"missing": 5, "out_of_volume": 10, "dropped": 2}
FAULTS = {
    "crc=0.1,truncate=0.03,quiet=0.02,repeat=0.3,crc_setup=0.2": LINE,
    "missing=0.05,out=0.2,partly=0.2,drop=0.05,counter=4294967250,warning=1": FRAMES,
    "broken=1,srom=0,slow_init=0.5": {"missing": 120},
    "reset=0.3": {"clock_restarts": 1},
    "cut=0.2,mended=0.5": {"reconnects": 1},
    "unplug=0.1,replug=0.3,bare=1": {"hot_plugs": 2},
}


@pytest.mark.slow
@pytest.mark.parametrize("faults", FAULTS)
@pytest.mark.parametrize("firmware", ["AURORA Rev 013", "AURORA Rev 007"], ids=["BX", "TX"])
def test_every_fault_is_recovered_from_or_reported(tmp_path, faults, firmware):
    options = (*FAST, "--faults", faults, "--firmware", firmware)
    with simulated(tmp_path, *options) as (address, epoch), Aurora(address, rate=200.0) as tracker:
        frames = read(tracker, 120)
        counts = tracker.counts
        for what, least in FAULTS[faults].items():
            assert counts[what] >= least, counts
        assert counts["frames"] == 120
        numbers = np.array([frame.number for frame in frames])
        again = int(np.argmin(np.diff(numbers))) + 1 if counts["clock_restarts"] else 0
        if not counts["reconnects"]:
            assert np.all(np.diff(numbers[again:]) > 0)
            lost = np.diff(numbers) - 1
            assert np.sum(np.delete(lost, again - 1) if again else lost) == counts["dropped"]
        require_true(frames[again:], epoch, 200.0)
        ports = [port for frame in frames for port in frame.ports]
        assert (sum(port.partially_out for port in ports) > 10) == ("partly" in faults)
        assert counts["missing"] == sum(port.missing for port in ports)
        if "unplug" in faults:
            assert {len(frame.ports) for frame in frames} >= {1, 2}
            assert len(tracker.tools) == 2


@pytest.mark.slow
@pytest.mark.parametrize("where", ["--tcp", "--pty"])
def test_a_device_started_again_is_found_again(tmp_path, where):
    at_pty = str(tmp_path / "aurora")
    place = at_pty if where == "--pty" else str(free_port(socket.SOCK_STREAM))
    with ExitStack() as stack:
        with simulated(tmp_path, *FAST, where, place) as (address, _):
            tracker = stack.enter_context(Aurora(address, rate=200.0, baud=9600))
            read(tracker, 20)
        with simulated(tmp_path, *FAST, where, place) as (_, epoch):
            require_true(read(tracker, 40), epoch, 200.0)
            assert tracker.counts["reconnects"] == 1


@pytest.mark.slow
def test_a_device_that_stays_away_is_a_sentence(tmp_path):
    with simulated(tmp_path, *FAST) as (address, _):
        tracker = Aurora(address, rate=200.0, reconnect=0.5)
        tracker.__enter__()
        read(tracker, 5)
    with pytest.raises(ConnectionLostError, match=r"did not come back within 0.5 s\.$"):
        read(tracker, 500)
    with pytest.raises(DeviceError, match="not connected"):
        tracker.read()


@pytest.mark.slow
@pytest.mark.parametrize("mistake", [None, KeyError], ids=["leaving", "failing"])
def test_tracking_is_stopped_whatever_happens(tmp_path, mistake):
    with simulated(tmp_path, *FAST) as (address, _):
        try:
            with Aurora(address, rate=200.0) as tracker:
                tracker.read()
                if mistake:
                    raise mistake
        except KeyError:
            pass
        with Link(address) as link:
            link.write(b"TSTOP \r")
            assert link.read_until(b"\r", 5.0).startswith(b"ERROR0C")


@pytest.mark.slow
def test_the_travel_of_another_device_moves_the_coil(tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    options = (*FAST, "--travel", str(port))
    with simulated(tmp_path, *options) as (address, _), Aurora(address, rate=200.0) as tracker:
        before = tracker.read().ports[1].pose
        assert np.isclose(before[2, 3], 0.05)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as servo:
            servo.sendto(MESSAGE.pack(time.monotonic(), 0.02), ("127.0.0.1", port))
        after = read(tracker, 10)[-1].ports[1].pose
        assert np.isclose(after[2, 3], 0.03)


@pytest.mark.slow
def test_a_serial_line_is_sped_up_and_the_beginning_of_a_reply_tells_its_time(tmp_path):
    options = ("--wired", "--pty", str(tmp_path / "aurora"))
    with simulated(tmp_path, *options) as (address, epoch), Aurora(address) as tracker:
        off = require_true(read(tracker, 100), epoch, 40.0)
        assert off < 9e-3  # when a whole reply would be there
        assert tracker._link.baud == 115200


@pytest.mark.slow
@pytest.mark.parametrize("network", [False, True], ids=["pty", "tcp"])
def test_ndicapi_reads_the_simulator_by_bx_and_tx(tmp_path, network):
    link = str(tmp_path / "aurora")
    with simulated(tmp_path, *(("--tcp", "0") if network else ("--pty", link))) as (address, _):
        if network:
            host, port = address.removeprefix("tcp://").split(":")
            device = ndicapy.ndiOpenNetwork(host, int(port))
        else:
            assert ndicapy.ndiProbe(link) == ndicapy.NDI_OKAY
            device = ndicapy.ndiOpen(link)
        commands = "INIT: PHSR:02 PINIT:0A PINIT:0B PENA:0AD PENA:0BD TSTART:"
        for command in commands.split():
            ndicapy.ndiCommand(device, command)
            assert ndicapy.ndiGetError(device) == ndicapy.NDI_OKAY
        starts = []
        for kind in ("BX", "TX"):
            ndicapy.ndiCommand(device, f"{kind}:0801")
            values = getattr(ndicapy, f"ndiGet{kind}Transform")(device, b"\x0a")
            number = getattr(ndicapy, f"ndiGet{kind}Frame")(device, b"\x0a")
            assert np.allclose([*values[:4], values[6]], [1, 0, 0, 0, 100], atol=1e-4)
            starts.append(values[4] - 1e3 * SPEED * number / 40.0)
        assert abs(starts[0] - starts[1]) < 0.006  # mm, what TX resolves
        ndicapy.ndiCommand(device, "TSTOP:")
        (ndicapy.ndiCloseNetwork if network else ndicapy.ndiClose)(device)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["AURORA Rev 013", "AURORA Rev 008"])
def test_scikit_surgery_reads_the_simulator(tmp_path, firmware):
    link = str(tmp_path / "aurora")
    with simulated(tmp_path, "--pty", link, "--firmware", firmware):
        tracker = NDITracker({"tracker type": "aurora", "serial port": link})
        tracker.start_tracking()
        handles, _, numbers, places, quality = tracker.get_frame()
        assert handles == [0x0A, 0x0B]
        assert numbers[0] == numbers[1] > 0
        assert np.isclose(places[0][2, 3], 100.0, atol=0.01)
        assert np.isclose(places[1][2, 3], 50.0, atol=0.01)
        assert np.all(np.isfinite(quality))
        tracker.stop_tracking()
        tracker.close()


@pytest.mark.slow
def test_a_coil_without_srom_is_read_with_a_file_or_the_default_or_else_a_sentence(tmp_path):
    rom = tmp_path / "coil.rom"
    rom.write_bytes(bytes(range(100)))
    with simulated(tmp_path, *FAST, "--faults", "srom=1") as (address, _):
        for srom in (None, rom):
            with Aurora(address, rate=200.0, srom=srom) as tracker:
                assert len(tracker.read().ports) == 2
    with simulated(tmp_path, "--faults", "bad_srom=1") as (address, _):
        for srom in (None, rom):
            with pytest.raises(DeviceError, match=r"Coil 0B .*ERROR13.* srom= .*unplug it\.$"):
                Aurora(address, srom=srom).__enter__()
        rom.write_bytes(bytes(2000))
        with pytest.raises(DeviceError, match="2000 bytes"):
            Aurora(address, srom=rom).__enter__()
        with pytest.raises(DeviceError, match="cannot be read"):
            Aurora(address, srom=tmp_path / "absent.rom").__enter__()
    none = pytest.raises(DeviceError, match="No coil is plugged in")
    with simulated(tmp_path, scene=tell_tale(coils=())) as (address, _), none:
        Aurora(address).__enter__()


def echo(server):
    client, _ = server.accept()
    with client:
        while came := client.recv(100):
            client.sendall(came)


@pytest.mark.slow
def test_what_is_no_aurora_is_a_sentence():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(DeviceTimeoutError, match=r"did not answer within 0.2 s .*switched on"):
            Aurora(address, patience=0.2).__enter__()
        server.accept()[0].close()
        thread = threading.Thread(target=echo, args=[server])
        thread.start()
        with pytest.raises(DeviceError, match="no Aurora does"):
            Aurora(address, patience=0.2).__enter__()
        thread.join(10.0)


ADDRESSES = {
    "/dev/ttyNOPE": "There is no device /dev/ttyNOPE",
    "tcp://127.0.0.1:1": "Nothing answers at",
    "tcp://here": "not a network address",
    "tcp://here:99999": "not a network address",
    __file__: "cannot be opened as a serial port",
}


@pytest.mark.parametrize("address", ADDRESSES)
def test_an_address_that_cannot_be_opened_is_a_sentence(address):
    with pytest.raises(DeviceError, match=rf"{ADDRESSES[address]}.*\.$"):
        Link(address)


@pytest.mark.slow
def test_a_port_in_use_is_a_sentence(tmp_path):
    link = str(tmp_path / "aurora")
    with (
        simulated(tmp_path, "--pty", link),
        Link(link),
        pytest.raises(DeviceError, match="Another program has"),
    ):
        Link(link)


def test_permission_a_missing_package_and_a_wrong_baud_rate_are_sentences(monkeypatch):
    with pytest.raises(DeviceError, match="12345 baud; give one of 9600"):
        Aurora("/dev/ttyUSB0", baud=12345)

    def refuse(*_, **__):
        raise serial.SerialException(errno.EACCES, "no")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError, match="usermod -aG dialout"):
        Link("/dev/ttyUSB0")
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(DeviceError, match=r"pip install 'glissando\[hardware\]'"):
        Link("/dev/ttyUSB0")


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [["--tcp", "0"], ["--tcp", "0", "--scene", "absent"], ["--nonsense"]]
)
def test_a_simulated_device_that_cannot_start_says_why(options):
    with pytest.raises(SimulationError, match=r"did not start: .+"), started("aurora", *options):
        pass
