"""Raw session logs: what devices say, as it comes, in an MCAP file that outlives a crash.

One topic a device stream, messages of JSON with a JSON schema, so that Foxglove and any MCAP reader
open them. Log times are the host's monotonic clock in ns; the metadata record 'session' says what
the wall clock was at one of them. Floats come back bit by bit; NaN is written as null.
"""

from glissando.io.session_log.messages import INTEGER, NUMBER, TEXT, numbers, schema
from glissando.io.session_log.reader import RawSession, Topic, read_session
from glissando.io.session_log.writer import SessionWriter

__all__ = [
    "INTEGER",
    "NUMBER",
    "TEXT",
    "RawSession",
    "SessionWriter",
    "Topic",
    "numbers",
    "read_session",
    "schema",
]
