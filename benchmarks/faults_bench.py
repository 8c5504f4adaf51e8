"""Simulated devices, and the program under test, for `faults.py`."""

import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import deque
from contextlib import suppress
from pathlib import Path

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.drivers import dynamixel
from glissando.hardware.drivers.dynamixel import Servo
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.hardware.simulated_devices.travel import MESSAGE
from glissando.io.shipped_robots import robot_file
from glissando.simulation import load_bench

WATCHDOG, SPEED, STROKE = 0.3, 0.024, 0.02  # s, m/s, m
END = 200.0  # s: time limit for a program to end


class Device:
    """Process of a device; `address` is the first line that it prints."""

    def __init__(self, *command):
        self.process = subprocess.Popen(
            [sys.executable, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        self.address = self.process.stdout.readline().decode().strip()

    def kill(self):
        """Kill the process, as if the device were unplugged."""
        self.process.kill()
        self.process.wait()


class Bench:
    """Simulated devices of one lane, with the true travel of the stage over time."""

    def __init__(self, folder):
        self.folder = folder
        bench = load_bench(robot_file("sliding700"))
        motion = bench.move(bench.shape("C"), bench.flaws, 0)
        tip = bench.rod.length + bench.coil_offset
        scene = Scene.of(
            motion, motion.time[:1], [SceneCoil(tip, -1.0, np.eye(4), port=0)],
            T_wt=bench.tracker, flaws=bench.flaws, seed=0,
        )  # fmt: skip
        scene.save(folder / "scene.npz")
        self.tip = tip
        self._ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._ear.bind(("127.0.0.1", 0))
        self._tracker_port, self.mocap_port = free_port(), free_port()
        self.travel = deque(maxlen=20_000)
        threading.Thread(target=self._listen, daemon=True).start()
        self.devices = {}
        for name in ("servo", "aurora", "vicon"):
            self.start(name)

    def _listen(self):
        while True:
            data = self._ear.recv(64)
            self.travel.append(MESSAGE.unpack(data))
            self._ear.sendto(data, ("127.0.0.1", self._tracker_port))

    def start(self, name):
        """Start or restart a device."""
        place = self.travel[-1][1] if self.travel else 0.0
        options = {
            "servo": ["--travel", f"127.0.0.1:{self._ear.getsockname()[1]}", f"--start={place}"],
            "aurora": ["--scene", str(self.folder / "scene.npz"), "--tcp", "0", "--travel",
                       str(self._tracker_port)],
            "vicon": ["--scene", str(self.folder / "scene.npz"), "--to",
                      f"127.0.0.1:{self.mocap_port}", "--bodies", "tip=0.7", "--rate", "25"],
        }[name]  # fmt: skip
        module = f"glissando.hardware.simulated_devices.{name}"
        self.devices[name] = Device("-m", module, *options)

    def setup(self, hold):
        """Write the setup file with the stage's present position."""
        standing = min(max(self.travel[-1][1], 0.0), 0.06)
        (self.folder / "bench.toml").write_text(
            f'robot = "sliding700"\n[tracker]\naddress = "{self.devices["aurora"].address}"\n'
            f'[[tracker.coils]]\nname = "coil"\narclength = {self.tip}\n'
            f'[slide]\naddress = "{self.devices["servo"].address}"\nlead = 0.0254\n'
            f"stroke = [0.0, 0.06]\nstanding = {standing}\nwatchdog = {WATCHDOG}\n"
            f"speed = {SPEED}\nacceleration = 0.2\nlag = 0.02\nhold = {str(hold).lower()}\n"
            f"[mocap]\nport = {self.mocap_port}\n"
            f'[[mocap.bodies]]\nname = "tip"\narclength = 0.7\n'
        )

    def moved_until(self, since):
        """Time of the stage's last motion, in seconds after `since`; waits for 0.5 s of data."""
        points = np.zeros((0, 2))
        while len(points) < 2 or points[-1, 0] < since + 0.5:
            if self.devices["servo"].process.poll() is not None:
                raise DeviceError("The simulated servo has ended.")
            time.sleep(0.1)
            points = np.array([p for p in list(self.travel) if p[0] > since]).reshape(-1, 2)
        steps = np.flatnonzero(np.abs(np.diff(points[:, 1])) > 1e-7)
        return float(points[steps[-1] + 1, 0] - since) if steps.size else 0.0

    def torque(self):
        """Whether the servo's torque is enabled."""
        servo = Servo(self.devices["servo"].address, 1, 57600)
        try:
            return bool(servo.read(dynamixel.TORQUE, 1, check_error=False).data[0])
        finally:
            servo.close()

    def close(self):
        """Kill all devices."""
        for device in self.devices.values():
            device.kill()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Program:
    """A command of glissando in its own process session."""

    def __init__(self, arguments, *, room=None, **environment):
        self.mark, self.began = uuid.uuid4().hex, time.monotonic()
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  (goes with this object)

        def prepare():
            for number in (signal.SIGINT, signal.SIGHUP):  # ignored in a shell's background jobs
                signal.signal(number, signal.SIG_DFL)
            if room is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

        self.process = subprocess.Popen(
            [sys.executable, "-m", "glissando", *map(str, arguments)],
            env={**os.environ, "GLISSANDO_TRIAL": self.mark, **environment},
            stdin=subprocess.DEVNULL, stdout=self._errors, stderr=self._errors,
            start_new_session=True, preexec_fn=prepare,
        )  # fmt: skip

    def send(self, number):
        """Send a signal to the whole process group, as a terminal does."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def alone(self, number):
        """Send a signal to the main process only."""
        self.process.send_signal(number)

    def running_for(self, seconds):
        """Wait for some seconds, or until the program ends."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)

    def ended(self, within=END):
        """Wait for the exit status; None if the program did not end and was killed."""
        try:
            return self.process.wait(within)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGKILL)
            self.process.wait()
            return None

    def said(self):
        """Output of the program."""
        self._errors.seek(0)
        return self._errors.read()

    def left(self, within=8.0):
        """Number of the program's processes that still run some seconds after its end."""
        end = time.monotonic() + within
        while (count := len(self._running())) and time.monotonic() < end:
            time.sleep(0.1)
        return count

    def _running(self):
        found = []
        for entry in Path("/proc").iterdir():
            with suppress(OSError):
                ours = self.mark.encode() in (entry / "environ").read_bytes()
                if ours and (entry / "stat").read_text().rpartition(")")[2].split()[0] != "Z":
                    found.append(int(entry.name))
        return found
