"""Raw session logs: messages of devices as they arrive, in an MCAP file that survives a crash.

Each device stream is a topic of JSON messages with a JSON schema, which Foxglove and any MCAP
reader understand. Log times are the host's monotonic clock in ns; the metadata record 'session'
relates it to the wall clock. Floats are stored exactly; NaN is written as null.
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
