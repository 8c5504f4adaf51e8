"""Writing a session log from which a crash loses at most the last second."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from glissando.errors import GlissandoError, needing
from glissando.io.provenance import stated_format
from glissando.io.session_log.messages import encoded

_SAFE_EVERY = 0.5  # s between flushes: a crash loses at most a second
_CHUNK_BYTES = 256 * 1024


class SessionWriter:
    """Writer of messages to a session log; messages older than a second survive a crash.

    The writer is a context manager, and may be used from several threads. A background thread ends
    a chunk and flushes it to disk twice a second.

    Args:
        path: File to create.
        metadata: Metadata of the session, in addition to its clocks.

    Raises:
        GlissandoError: The file exists or cannot be written, or mcap is not installed.
    """

    def __init__(self, path: str | Path, metadata: Mapping[str, str] | None = None) -> None:
        with needing("Writing MCAP files needs mcap", "hardware"):
            from mcap.writer import Writer
        self.path = Path(path)
        try:
            self._file = self.path.open("xb")
        except FileExistsError:
            raise GlissandoError(f"{path} exists; give a new name.") from None
        except OSError as problem:
            raise GlissandoError(f"{path} cannot be written ({problem.strerror}).") from None
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._channels: dict[str, int] = {}
        self._count: dict[str, int] = {}
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._failure: OSError | None = None
        self._flushed = 0.0
        clocks = {"monotonic_ns": str(time.monotonic_ns()), "wall_ns": str(time.time_ns())}
        try:
            with self._locked_writer():
                self._writer.start(profile="", library="glissando")
                stated = {"format": stated_format("session"), **clocks, **(metadata or {})}
                self._writer.add_metadata("session", stated)
            self.sync()
        except BaseException:
            with suppress(OSError):
                self._file.close()
            raise
        self._flusher = threading.Thread(target=self._flush_regularly, name="session", daemon=True)
        self._flusher.start()

    def add_topic(self, topic: str, message: Mapping[str, Any], **metadata: str) -> None:
        """Declare a topic with the JSON schema of its messages; repeating that has no effect."""
        text = json.dumps(message).encode()
        with self._locked_writer():
            if topic not in self._channels:
                made = self._writer.register_schema(message.get("title", topic), "jsonschema", text)
                channel = self._writer.register_channel(topic, "json", made, metadata)
                self._channels[topic], self._count[topic] = channel, 0

    def write(self, topic: str, message: Mapping[str, Any], time_ns: int | None = None) -> None:
        """Write a message.

        Args:
            topic: A declared topic.
            message: Numbers, texts, lists, dicts and arrays, by name.
            time_ns: Time of arrival, ns of the monotonic clock; by default now.

        Raises:
            GlissandoError: A number is infinite, the topic is not declared, the log is closed, or
                writing to disk has failed before.
        """
        data = encoded(topic, message)
        now = time.monotonic_ns() if time_ns is None else time_ns
        with self._locked_writer():
            if topic not in self._channels:
                raise GlissandoError(f"Topic {topic!r} is not declared; call add_topic first.")
            if not 0 <= now < 1 << 63:
                raise GlissandoError(f"Log time {now} ns cannot be; give nanoseconds from 0 up.")
            self._count[topic] += 1
            self._writer.add_message(self._channels[topic], now, data, now, self._count[topic])
            if time.monotonic() - self._flushed > _SAFE_EVERY:  # the thread waits for a slow disk
                self._flush()

    def sync(self) -> None:
        """Flush everything written so far to disk."""
        with self._locked_writer():
            self._flush()
            at = os.dup(self._file.fileno())  # fsync outside the lock: the disk may be slow
        try:
            os.fsync(at)
        except OSError as problem:
            raise self._write_error(problem) from None
        finally:
            os.close(at)

    def close(self) -> None:
        """Write the index and close the file.

        Raises:
            GlissandoError: Writing to disk failed.
        """
        self._closing.set()
        self._flusher.join()
        if self._file.closed:
            return
        try:
            with self._locked_writer():
                self._writer.finish()
                self._file.flush()
                os.fsync(self._file.fileno())
        finally:
            with suppress(OSError):
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _flush(self) -> None:
        """Hand all messages to the operating system, which keeps them if this process is killed."""
        self._writer.flush()
        self._flushed = time.monotonic()

    def _flush_regularly(self) -> None:
        with suppress(GlissandoError):  # the next write raises it
            while not self._closing.wait(_SAFE_EVERY):
                self.sync()

    @contextmanager
    def _locked_writer(self) -> Iterator[None]:
        """Hold the lock of the log; raises if it is closed or if writing has failed before."""
        with self._lock:
            if self._failure is None and self._file.closed:
                raise GlissandoError(f"{self.path} is closed; write before close().")
            try:
                if self._failure is not None:
                    raise self._failure
                yield
            except OSError as problem:
                raise self._write_error(problem) from None

    def _write_error(self, problem: OSError) -> GlissandoError:
        self._failure = problem
        return GlissandoError(
            f"{self.path} could not be written on ({problem.strerror}); make room. What came "
            f"before is kept."
        )
