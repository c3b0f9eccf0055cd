"""Random mutations of a file: what disks, networks and dead batteries do, and worse."""

import random
import struct
from collections.abc import Callable

Mutation = Callable[[bytearray, random.Random], None]

NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
WORDS = (
    b"nan",
    b"inf",
    b"-1",
    b"1e999",
    b"\n",
    b",",
    b'"',
    b"#",
    b" ",
    b"\0",
    b"\xff",
    b"99999999999",
)
FORMS = ("<B", "<H", "<I", "<Q")


def mutate(data: bytes, dice: random.Random) -> bytes:
    """Change a file in a few places."""
    changed = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 4, 8))):
        dice.choice(MUTATIONS)(changed, dice)
    return bytes(changed)


def flip_bit(data: bytearray, dice: random.Random) -> None:
    """Flip one bit."""
    if data:
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)


def put_number(data: bytearray, dice: random.Random) -> None:
    """Write a number that lengths and counts fear."""
    form = dice.choice(FORMS)
    size = struct.calcsize(form)
    if len(data) >= size:
        number = dice.choice(NUMBERS) % 2 ** (8 * size)
        struct.pack_into(form, data, dice.randrange(len(data) - size + 1), number)


def put_word(data: bytearray, dice: random.Random) -> None:
    """Insert what texts fear."""
    at = dice.randrange(len(data) + 1)
    data[at:at] = dice.choice(WORDS)


def cut_end(data: bytearray, dice: random.Random) -> None:
    """Lose the end."""
    del data[dice.randrange(len(data) + 1) :]


def lose_part(data: bytearray, dice: random.Random) -> None:
    """Lose some bytes."""
    at = dice.randrange(len(data) + 1)
    del data[at : at + dice.randrange(1, 64)]


def repeat_part(data: bytearray, dice: random.Random) -> None:
    """Write some bytes twice."""
    at = dice.randrange(len(data) + 1)
    data[at:at] = data[at : at + dice.randrange(1, 256)]


def zero_part(data: bytearray, dice: random.Random) -> None:
    """Find zeros where a block was not written."""
    at = dice.randrange(len(data) + 1)
    size = len(data[at : at + dice.randrange(1, 512)])
    data[at : at + size] = bytes(size)


MUTATIONS: tuple[Mutation, ...] = (
    flip_bit,
    flip_bit,
    put_number,
    put_number,
    put_word,
    cut_end,
    lose_part,
    repeat_part,
    zero_part,
)
