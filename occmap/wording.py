"""How numbers of things are written for people."""


def count(number: int, noun: str) -> str:
    """Write how many there are: 1 beam, 2,000 beams."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"
