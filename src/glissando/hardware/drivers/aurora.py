"""Driver of an NDI Aurora: each frame once, with the time of its measurement."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from glissando.errors import DeviceError
from glissando.hardware.drivers import aurora_setup as setup
from glissando.hardware.drivers.aurora_protocol import (
    BX_HEADER,
    bx_length,
    frame_command,
    parse_ascii,
    parse_bx,
    parse_tx,
)
from glissando.hardware.drivers.aurora_reply import Frame, GarbledError, RefusedError, Reply
from glissando.hardware.drivers.clock import ClockFit
from glissando.hardware.drivers.link import ConnectionLostError, DeviceTimeoutError, Link

_WITH_OUT_OF_VOLUME = "0801"
_FIRMWARE_WITHOUT_BX = ("AURORA Rev 007", "AURORA Rev 008")
_EARLY = 2e-3  # s, least time before a frame is due at which requests begin
_PAUSE = 5e-4  # s between requests
_REPLY, _REST = 0.2, 0.05  # s until a reply begins, and for its remainder
_SILENCE = 2.0  # s without a complete reply after which the link counts as lost
_RETRY_INTERVAL = 0.3  # s between attempts to reconnect
_REFUSALS = 4  # successive refusals before one counts, as a request may arrive damaged
_STATE_ERRORS = (0x0C, 0x10)  # errors of a device that is not tracking, or was reset
_COMMAND_ERRORS = (0x02, 0x03, 0x04, 0x05)  # errors of a command that arrived damaged
_ABSENT = ("unoccupied", "disabled")


class Aurora:
    """An NDI Aurora that tracks while the context lasts.

    Args:
        address: Serial path, or tcp://host:port.
        baud: Baud rate of a serial line after the connection, which starts at 9600.
        srom: File for coils without a memory of their own.
        rate: Frames a second.
        latency: Constant delay from measurement to availability of a frame, s, which cannot be
            estimated from arrivals.
        std_latency: Standard deviation of `latency`, s.
        reconnect: Seconds in which a lost link is reopened; 0 to raise at once.
        patience: Seconds allowed for each of reset and initialisation.

    Raises:
        DeviceError: The device cannot be used; raised on entry and by `read`.

        with Aurora("/dev/ttyUSB0") as tracker:
            for frame in tracker:
                print(frame.time, frame.ports[0].pose)
    """

    def __init__(
        self,
        address: str,
        *,
        baud: int = 115200,
        srom: Path | None = None,
        rate: float = 40.0,
        latency: float = 0.0,
        std_latency: float = 0.0,
        reconnect: float = 20.0,
        patience: float = 12.0,
    ):
        if baud not in setup.BAUD_CODES:
            known = ", ".join(map(str, sorted(setup.BAUD_CODES)))
            raise DeviceError(f"An Aurora has no rate of {baud} baud; give one of {known}.")
        if not 0.0 < rate <= 1000.0:
            raise DeviceError(f"An Aurora has no rate of {rate:g} frames a second; give 40, say.")
        self.address, self.counts = address, Counter[str]()
        self.clock = ClockFit(1.0 / rate, 2**32, latency=latency, std_latency=std_latency)
        self.version, self.tools = "", list[setup.Tool]()
        self._baud, self._srom, self._period = baud, srom, 1.0 / rate
        self._latency, self._reconnect, self._patience = latency, reconnect, patience
        self._link: Link | None = None
        self._binary, self._last, self._last_reply = True, -1, 0.0
        self._status, self._absent = 0, frozenset[int]()
        self._early, self._last_was_duplicate = self._period, False
        self._first_number: int | None = None
        self._refusals = 0  # of requests, one after the other

    def __enter__(self) -> Aurora:
        self._connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames until `read` raises."""
        while True:
            yield self.read()

    def close(self) -> None:
        """Stop tracking, if the link still works, and close the link."""
        if self._link is not None:
            with contextlib.suppress(DeviceError):
                setup.end_tracking(self._link)
            self._link.close()
            self._link = None

    def read(self, timeout: float = 1.0) -> Frame:
        """Wait for the next frame, and return it as soon as the tracker has it.

        Args:
            timeout: Seconds to wait, not counting the time to reconnect.

        Raises:
            DeviceTimeoutError: No frame arrived in time.
            ConnectionLostError: The link is lost and could not be reopened.
        """
        if self._link is None:
            raise DeviceError(
                "The Aurora is not connected; read inside 'with Aurora(…) as tracker'."
            )
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            self._wait_until_due()
            try:
                reply = self._poll()
            except ConnectionLostError as loss:
                self._connect_again(loss)
                deadline = time.monotonic() + timeout
                continue
            frame = self._accept(reply) if reply else None
            if frame:
                return frame
        counted = ", ".join(f"{what}: {n}" for what, n in self.counts.items() if n) or "no reply"
        raise DeviceTimeoutError(
            f"The Aurora at {self.address} had no new frame for {timeout:.3g} s ({counted}); "
            f"check that a coil is plugged in."
        )

    def _connect(self) -> None:
        self._link = link = Link(self.address)
        try:
            self.version = setup.start_up(link, self._baud, self._patience)
            self._binary = not any(tag in self.version for tag in _FIRMWARE_WITHOUT_BX)
            self.tools, faulty = setup.enable_tools(link, self._srom)
            if faulty:
                raise DeviceError(faulty[0])
            if not self.tools:
                raise DeviceError(
                    f"No coil is plugged in at the Aurora at {self.address}; plug one in."
                )
            setup.begin_tracking(link)
        except BaseException:
            self.close()
            raise
        self._last_reply, self._status, self._absent = time.monotonic(), 0, frozenset()
        self._first_number = None

    def _connect_again(self, loss: ConnectionLostError) -> None:
        deadline = time.monotonic() + self._reconnect
        why: DeviceError = loss
        self.close()
        while time.monotonic() < deadline:
            time.sleep(_RETRY_INTERVAL)
            try:
                self._connect()
            except DeviceError as problem:
                why = problem
                continue
            self.counts["reconnects"] += 1
            self.clock.restart()
            self._last = -1
            return
        raise ConnectionLostError(f"{why} It did not come back within {self._reconnect:g} s.")

    def _wait_until_due(self) -> None:
        """Sleep until shortly before the next frame can be ready.

        The arrival of a frame that is ready at the first request does not show when it became
        ready; after such a frame the next is requested earlier.
        """
        if self._last < 0:
            time.sleep(_PAUSE)
            return
        due = self.clock.time(self._last + 1) + self._latency
        wait = due - self._early - time.monotonic()
        late = -wait > self._period
        time.sleep(min(wait, self._period) if wait > 0.0 else self._period / 4 if late else _PAUSE)

    def _poll(self) -> Reply | None:
        """Request a reply; None if it is damaged or refused for now. Raises ConnectionLostError."""
        try:
            reply = self._request()
        except (GarbledError, DeviceTimeoutError) as problem:
            if isinstance(problem, GarbledError):
                self.counts["bad_crc"] += 1
            else:
                self.counts["silent"] += 1
            if time.monotonic() - self._last_reply > _SILENCE:
                raise ConnectionLostError(f"The Aurora has fallen silent: {problem}") from None
            return None
        except RefusedError as refusal:
            self._refused(refusal)
            return None
        self._last_reply, self._refusals = time.monotonic(), 0
        return reply

    def _request(self) -> Reply:
        link = self._open_link()
        wire = 4000.0 / link.baud if link.baud else 0.0  # s that 400 bytes take
        name = "BX:" if self._binary else "TX:"
        link.write(frame_command(name + _WITH_OUT_OF_VOLUME))
        head = link.read(BX_HEADER, _REPLY + wire)
        if self._binary and not head.isalnum():  # text can only be a refusal
            return parse_bx(head + link.read(bx_length(head), _REST + wire))
        raw = head + (b"" if b"\r" in head else link.read_until(b"\r", _REST + wire))
        if raw.startswith(b"RESET") and parse_ascii(raw):
            raise ConnectionLostError("The Aurora was reset.")
        return parse_tx(raw)

    def _refused(self, refusal: RefusedError) -> None:
        if refusal.code in _STATE_ERRORS:
            raise ConnectionLostError(f"The Aurora has stopped tracking. {refusal}")
        if refusal.code in _COMMAND_ERRORS:
            self.counts["bad_crc"] += 1
            return
        self._refusals += 1
        if self._refusals < _REFUSALS:  # the request may have arrived damaged
            self.counts["bad_crc"] += 1
        elif self._binary:
            self._binary, self._refusals = False, 0
        else:
            raise refusal

    def _open_link(self) -> Link:
        assert self._link is not None
        return self._link

    def _accept(self, reply: Reply) -> Frame | None:
        """Frame of a reply if it is new, after setting up coils that were plugged in or out."""
        arrival = self._open_link().arrived
        absent = frozenset(p.handle for p in reply.ports if p.condition in _ABSENT)
        changed = reply.hot_plugged and reply.status & ~self._status
        if changed or absent - self._absent:
            self._update_tools()
        self._status, self._absent = reply.status, absent
        numbers = [p.number for p in reply.ports if p.number is not None and p.handle not in absent]
        if self._first_number is None and numbers:
            self._first_number = numbers[0]  # ready before the first request, at an unknown time
        if not numbers or (self._last < 0 and numbers[0] == self._first_number):
            return None
        restarts, last = self.clock.restarts, self._last
        count = self.clock.add(numbers[0], arrival)
        jumped = self.clock.restarts > restarts
        self.counts["clock_restarts"] += jumped
        if count == last and not jumped:
            self.counts["duplicates"] += 1
            self._last_was_duplicate = True
            return None
        early = 0.9 * self._early if self._last_was_duplicate else 2.0 * self._early
        self._early, self._last_was_duplicate = min(max(early, _EARLY), self._period), False
        if last >= 0 and not jumped:
            self.counts["dropped"] += count - last - 1
        self._last = count
        return self._frame(count, numbers[0], arrival, reply)

    def _frame(self, count: int, number: int, arrival: float, reply: Reply) -> Frame:
        # All ports of a reply belong to one frame [inferred]; another's time would be wrong.
        ports = tuple(p for p in reply.ports if p.number in (None, number))
        self.counts["frames"] += 1
        self.counts["missing"] += sum(p.missing for p in ports)
        self.counts["out_of_volume"] += sum(p.out_of_volume for p in ports)
        moment, std = self.clock.time(count), self.clock.std_time(count)
        return Frame(count, moment, std, arrival, ports)

    def _update_tools(self) -> None:
        """Free the handles of absent coils and set up new ones; the others lose a few frames."""
        link = self._open_link()
        self.counts["hot_plugs"] += 1
        try:
            setup.end_tracking(link)
            self.tools, faulty = setup.enable_tools(link, self._srom)
            setup.begin_tracking(link)
        except DeviceError as problem:
            raise ConnectionLostError(f"After a coil was plugged in or out: {problem}") from None
        self.counts["faulty"] += len(faulty)
