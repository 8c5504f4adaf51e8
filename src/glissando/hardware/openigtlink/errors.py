"""What can be wrong with a message of another program; all are refused and counted."""

from glissando.errors import DeviceError


class MessageError(DeviceError):
    """Bytes are no OpenIGTLink message that can be read."""


class TruncatedError(MessageError):
    """The bytes end before the message does."""


class MalformedError(MessageError):
    """A size, a count or a version in the message contradicts the protocol or the message."""


class ChecksumError(MessageError):
    """The CRC of the body is not the one its header states."""


class UnreadTypeError(MessageError):
    """The message is of a type that is not read here."""
