"""Random damage to a file: what disks, networks and dead batteries do, and worse."""

import random
from collections.abc import Callable

Damage = Callable[[bytearray, int, random.Random], int]
"""Damages a file from an offset on, and says where the damage ends"""

NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
WORDS = (*b'nan inf -1 1e999 99999999999 , " # \0 \xff'.split(), b"\n", b" ")


def mutate(data: bytes, dice: random.Random) -> bytes:
    """Change a file in a few places."""
    changed = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 4, 8))):
        if changed:
            dice.choice(MUTATIONS)(changed, dice.randrange(len(changed)), dice)
    return bytes(changed)


def flip_bit(data: bytearray, at: int, dice: random.Random) -> int:
    data[at] ^= 1 << dice.randrange(8)
    return at + 1


def change_byte(data: bytearray, at: int, dice: random.Random) -> int:
    data[at] ^= dice.randrange(1, 256)
    return at + 1


def put_number(data: bytearray, at: int, dice: random.Random) -> int:
    """Write a number that lengths and counts fear."""
    size = dice.choice((1, 2, 4, 8))
    value = dice.choice(NUMBERS) % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, "little")[: len(data) - at]
    return at + size


def put_zeros(data: bytearray, at: int, dice: random.Random) -> int:
    """As a disk leaves a sector that it never wrote."""
    start = at // 512 * 512
    end = min(start + 512 * dice.choice((1, 1, 8)), len(data))
    data[start:end] = bytes(end - start)
    return end


def put_word(data: bytearray, at: int, dice: random.Random) -> int:
    """Insert what texts fear."""
    data[at:at] = dice.choice(WORDS)
    return len(data)


def lose_end(data: bytearray, at: int, _dice: random.Random) -> int:
    del data[at:]
    return at


def lose_part(data: bytearray, at: int, dice: random.Random) -> int:
    del data[at : at + dice.randrange(1, 64)]
    return len(data)


def repeat_part(data: bytearray, at: int, dice: random.Random) -> int:
    data[at:at] = data[at : at + dice.randrange(1, 256)]
    return len(data)


IN_PLACE: tuple[Damage, ...] = (flip_bit, change_byte, put_number, put_zeros)
MUTATIONS = (*IN_PLACE, flip_bit, put_number, put_word, lose_end, lose_part, repeat_part)
