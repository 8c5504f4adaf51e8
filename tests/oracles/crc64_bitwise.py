"""The CRC-64 of ECMA-182 a bit at a time, from its definition."""


def crc64_bitwise(data: bytes) -> int:
    """Remainder of the bytes as a polynomial, times x⁶⁴, by the standard's polynomial."""
    register = 0
    for byte in data:
        register ^= byte << 56
        for _ in range(8):
            carry = register >> 63
            register = (register << 1) & 0xFFFFFFFFFFFFFFFF
            if carry:
                register ^= 0x42F0E1EBA9EA3693
    return register
