"""CRC-64 of OpenIGTLink: ECMA-182, most significant bit first, with initial value zero.

The checksum is linear: that of a message is the sum (XOR) of its words' checksums, each shifted by
the number of bytes that follow the word. Neighbouring words are therefore combined in pairs, all at
once. Source: ECMA-182, annex B; the protocol calls it crc64.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x42F0E1EBA9EA3693
_WORD = 8  # bytes
_ROWS = 256 * np.arange(_WORD)  # start of the table of each byte

Words = NDArray[np.uint64]


def crc64(data: bytes) -> int:
    """Checksum of bytes.

    >>> hex(crc64(b"123456789"))
    '0x6c40df5f0b497347'
    """
    padded = data.rjust(_WORD * -(-len(data) // _WORD), b"\0")  # leading zeros do not change it
    words = np.frombuffer(padded or bytes(_WORD), dtype=">u8").astype("<u8")
    span = _WORD
    while words.size > 1:
        if words.size % 2:
            words = np.concatenate([[np.uint64(0)], words])
        words = _shifted(words[::2], span) ^ words[1::2]
        span *= 2
    return int(_shifted(words, _WORD)[0])


def _shifted(words: Words, span: int) -> Words:
    """Checksums (M,) of words (M,) followed by `span` zero bytes."""
    each = np.ascontiguousarray(words, dtype="<u8").view(np.uint8).reshape(-1, _WORD)
    out: Words = np.bitwise_xor.reduce(_tables(span).take(each + _ROWS), axis=1)
    return out


@lru_cache(maxsize=64)
def _tables(span: int) -> Words:
    """Contribution of each value of each byte of a word to `_shifted`, last byte first (8, 256)."""
    if span > _WORD:
        half = _tables(span // 2)
        return np.stack([_shifted(row, span // 2) for row in half])
    first = np.arange(256, dtype=np.uint64) << np.uint64(56)
    for _ in range(8):
        carry = first >> np.uint64(63)
        first = (first << np.uint64(1)) ^ carry * np.uint64(_POLYNOMIAL)
    rows = [first]
    while len(rows) < _WORD:
        last = rows[-1]
        rows.append((last << np.uint64(8)) ^ first[last >> np.uint64(56)])
    return np.stack(rows)
