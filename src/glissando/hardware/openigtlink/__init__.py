"""OpenIGTLink: encoding and decoding of messages, and connections to peers."""

from glissando.hardware.openigtlink.endpoint import Endpoint, EndpointUser
from glissando.hardware.openigtlink.message import (
    Message,
    decode,
    encode,
    seconds_since,
    stamp_of,
)

__all__ = ["Endpoint", "EndpointUser", "Message", "decode", "encode", "seconds_since", "stamp_of"]
