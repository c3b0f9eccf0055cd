"""How numbers of things are written for people."""


def count(number: int, noun: str) -> str:
    """Write how many there are: 1 beam, 2,000 beams, 2 misses."""
    ending = "" if number == 1 else "es" if noun.endswith("s") else "s"
    return f"{number:,} {noun}{ending}"
