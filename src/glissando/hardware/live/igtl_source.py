"""Readings from an OpenIGTLink peer: PLUS, a tracker, or another instance of glissando."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from glissando.errors import DeviceError, GlissandoError, RobotFileError
from glissando.geometry.se3 import Array
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.placement import (
    NoTravelError,
    Placement,
    batch,
    reading,
    require_on_robot,
)
from glissando.hardware.openigtlink import EndpointUser, Message, seconds_since
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.sender_clock import SenderClock
from glissando.hardware.openigtlink.tracker import is_rigid, normalized, poses_in
from glissando.io.plain_file import file_stem
from glissando.model.robot import Robot
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.slide_track import SlideTrack

TRAVEL = "travel"  # the device whose SENSOR messages state the slide's travel
_OWN_CLOCK = 1 << 52  # stamps below are a recording's own time, not a wall clock's
_FAR = 20.0  # m from the origin: no tracker reaches there
_MOST = 64  # streams: a journal keeps a file open for each


class IgtlSource(EndpointUser):
    """Readings of TRANSFORM, POSITION, TDATA and NDARRAY; the slide's travel of SENSOR messages.

    Args:
        address: Address as `Endpoint` takes it.
        robot: The robot, which defines the noise of each kind of sensor.
        placements: Positions of the devices on the robot; poses of other devices are dropped.

    Attributes:
        counts: Messages 'heard'; values dropped, by reason: 'unplaced' devices, 'invalid' values,
            'repeated' poses, and 'no travel' for sliding devices while the travel is unknown; and
            the events that the endpoint counts.
        status: Text of the latest STATUS message with a code other than 1; empty after a code 1.

    Raises:
        DeviceError: The address or a placement is invalid.
    """

    first: float | None = None
    clock = None
    finished = False  # a peer may reconnect

    def __init__(self, address: str, robot: Robot, placements: Sequence[Placement] = ()) -> None:
        require_on_robot(placements, robot)
        super().__init__(address)
        self.name, self.status, self._robot = address.partition("?")[0], "", robot
        self._placements = {place.name: place for place in placements}
        self._slide, self._last_arrival = SlideTrack(), -np.inf
        self._last: dict[str, bytes] = {}
        self._clock = SenderClock(self._endpoint.address.clock)
        self._newest, self._origin = -1, 0
        self._kinds: dict[str, str] = {}
        self._waiting: list[tuple[float, Message]] = []
        self._lacks_travel, self._has_readings, self._invalid = False, False, ""
        self._unplaced_names: dict[str, None] = {}

    @property
    def problem(self) -> str:
        """Reason why no readings arrive; empty while they do."""
        if not self._endpoint.peers:
            if self.counts["refused"]:
                return f"what was sent at {self.name} is not OpenIGTLink, so its peer was let go"
            calls = "nobody has called" if self._endpoint.address.listens else "nobody answers"
            return f"{calls} at {self.name}"
        if self.status or not np.isfinite(self._last_arrival):
            unread = " that is read here" if self.counts["of unread types"] else ""
            return self.status or f"{self.name} sends nothing{unread}"
        if self._invalid and not self._has_readings:
            return self._invalid
        if self._unplaced_names and not self._has_readings:
            placed = ", ".join(self._placements) or "none"
            return f"{self.name} sends {', '.join(self._unplaced_names)}; placed are {placed}"
        if not self._lacks_travel:
            return ""
        ended = self._slide.known
        return f"{self.name} {'sends no more' if ended else 'has sent no'} {TRAVEL} of the slide"

    def poll(self) -> None:
        """Receive the messages that have arrived; `read` converts them later."""
        arrived = self._endpoint.receive_all()
        self._own_counts["heard"] += len(arrived)
        self._waiting += arrived

    def read(self, clock: SessionClock) -> list[Readings]:
        """Readings that have arrived since the last call."""
        self.poll()
        out: list[Readings] = []
        waiting, self._waiting = self._waiting, []
        for arrival, message in waiting:
            with self._counted():
                out += self._readings(message, arrival, clock)
        self._has_readings |= bool(out)
        return out

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """Count an invalid value as such, and continue with the next one."""
        try:
            yield
        except RobotFileError:
            raise
        except NoTravelError:
            self._own_counts["no travel"] += 1
            self._lacks_travel = True
        except GlissandoError as problem:
            self._own_counts["invalid"] += 1
            self._invalid = str(problem).partition(";")[0]

    def _readings(
        self, message: Message, arrival: float, clock: SessionClock
    ) -> Iterator[Readings]:
        content = message.content
        if isinstance(content, c.Status):
            self.status = "" if content.code == 1 else f"{self.name} reports {content.message!r}"
        elif isinstance(content, c.NumberArray):
            yield self._rows(message, arrival, clock)
        elif isinstance(content, c.SensorValues) and message.device.lower() == TRAVEL:
            travel, time = self._travel_of(content), self._time(message.stamp, arrival, clock)
            self._slide.add(time, travel)
            self._lacks_travel = False
        else:
            time = self._time(message.stamp, arrival, clock)
            for name, kind, value in poses_in(message, self._frame):
                place = self._placements.get(name)
                if place is None:
                    self._own_counts["unplaced"] += 1
                    if len(self._unplaced_names) < _MOST:
                        self._unplaced_names[name] = None
                elif self._is_new(name, value):
                    with self._counted():
                        yield self._reading(place, place.kind or kind, time, value)
        self._last_arrival = arrival

    def _travel_of(self, content: c.SensorValues) -> float:
        travel = content.values * self._frame.length_unit(content.unit)
        if travel.size != 1 or not abs(travel[0]) < _FAR:
            raise DeviceError(f"A travel of {travel} m cannot be; send one number and its unit.")
        return float(travel[0])

    def _is_new(self, name: str, value: Array) -> bool:
        """Whether a pose differs from the last; servers repeat it between measurements."""
        known, self._last[name] = self._last.get(name), value.tobytes()
        repeated = known == self._last[name]
        self._own_counts["repeated"] += repeated
        return not repeated

    def _require_kind(self, name: str, kind: str) -> None:
        """Raise DeviceError if a device changes its kind: a stream has readings of one kind."""
        if name not in self._kinds and len(self._kinds) >= _MOST:
            raise DeviceError(f"{name} is one of more than {_MOST} streams; send fewer.")
        if (first := self._kinds.setdefault(name, kind)) != kind:
            raise DeviceError(f"{name} sent a {kind} and before a {first}; send one of them.")

    def _reading(self, place: Placement, kind: str, time: float, pose: Array) -> Readings:
        far = float(np.abs(pose[:3, 3]).max())
        if far > _FAR:
            self.status = f"{place.name} is {far:.3g} m away: are its lengths unit=mm or unit=m?"
        if far > _FAR or not is_rigid(pose):
            raise DeviceError(f"{place.name} sent no rigid motion nearby; check the sender.")
        self._require_kind(place.name, kind)
        pose = normalized(pose)
        value = pose[:3, 3] if kind == "position" else pose
        return reading(self._robot, place, kind, place.name, time, value, self._slide)

    def _rows(self, message: Message, arrival: float, clock: SessionClock) -> Readings:
        """Readings sent by an `IgtlSink`, with times and values as float64."""
        assert isinstance(message.content, c.NumberArray)
        kind, table = message.metadata.get("kind", ""), np.asarray(message.content.values, float)
        sensor = SENSORS.get(kind)
        if sensor is None or sensor.settings or table.ndim != 2 or not len(table):
            raise DeviceError(f"{message.device} sent an array without readings; leave it out.")
        units = ["s", "", *sensor.columns.values()]
        if table.shape[1] != len(units):
            raise DeviceError(f"{message.device} sent {table.shape[1]} columns, not {len(units)}.")
        if not np.all(np.abs(table[:, [unit == "m" for unit in units]]) <= _FAR):
            raise DeviceError(f"{message.device} sent lengths beyond {_FAR:g} m; send metres.")
        name = file_stem(message.metadata.get("name", message.device), DeviceError)
        stamped, time = self._time(message.stamp, arrival, clock), table[:, 0]
        if self._endpoint.address.clock != "sender":
            time = time + (stamped - _time_of_stamp(message, time[-1]))
        with np.errstate(all="ignore"):  # readings refuse the NaN of a quaternion of zeros
            values = sensor.from_columns(table[:, 2:])
        self._require_kind(name, kind)
        return batch(self._robot, kind, name, time, table[:, 1], values)

    def _time(self, stamp: int, arrival: float, clock: SessionClock) -> float:
        """Session time of a stamp, s."""
        mode = self._endpoint.address.clock
        if stamp and mode == "shared":
            return clock.of_stamp(stamp)
        if stamp and mode == "sender":
            return self._sender_time(stamp, clock)
        return clock.of_monotonic(self._clock.monotonic(stamp, arrival))

    def _sender_time(self, stamp: int, clock: SessionClock) -> float:
        if self._newest < 0:
            self._origin = 0 if stamp < _OWN_CLOCK else stamp & ~((1 << 32) - 1)
            clock.begin_at(seconds_since(stamp, self._origin))
        self._newest = max(self._newest, stamp)
        return seconds_since(stamp, self._origin)


def _time_of_stamp(message: Message, last: float) -> float:
    """Time of the stamp on the clock of the rows, s; `last` if the message does not contain it."""
    try:
        time = float(message.metadata.get("time", last))
    except ValueError:
        time = np.nan
    if not np.isfinite(time):
        raise DeviceError(f"{message.device} states no time of its stamp that is a number of s.")
    return time
