"""Unitree's checksum: CRC-32/MPEG-2 (polynomial 0x04c11db7, from 0xffffffff) over big-endian 32-bit words."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.jit import kernel

POLYNOMIAL: Final = 0x04C11DB7
_MASK: Final = 0xFFFFFFFF


def _table() -> NDArray[np.int64]:
    register = np.arange(256, dtype=np.int64) << 24
    for _ in range(8):
        register = np.where(register & 0x80000000, register << 1 ^ POLYNOMIAL, register << 1) & _MASK
    return register


TABLE: Final = _table()


@kernel
def checksum(words: NDArray[np.uint32], count: int, table: NDArray[np.int64]) -> int:
    """The checksum of the first `count` words, for kernels; `table` is `TABLE`."""
    crc = 0xFFFFFFFF
    for i in range(count):
        word = np.int64(words[i])
        for shift in (24, 16, 8, 0):
            crc = ((crc << 8) & 0xFFFFFFFF) ^ table[((crc >> 24) ^ (word >> shift)) & 0xFF]
    return crc


def crc32(words: NDArray[np.uint32]) -> int:
    """The checksum of a message (n,) in C's layout, as little-endian words, without the last, which holds it."""
    return int(checksum(words, len(words) - 1, TABLE))
