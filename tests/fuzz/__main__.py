"""Fuzz each reader for a minute, damage each sample log in 1,200 ways, spoil 5,000 messages.

`python -m tests.fuzz SECONDS` fuzzes each so long, and does of the rest a part as large.
"""

import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from tests.fuzz.mutate import mutate
from tests.fuzz.targets import TARGETS, Target

SECONDS = 60.0
HANG_S = 10
KEPT = Path(__file__).parents[1] / "readers" / "regressions"


def main(words: list[str]) -> int:
    """Run the targets named, or all and the damage tests; 1 where something escaped."""
    seconds = float(words[0]) if words else SECONDS
    names = words[1:] or list(TARGETS)
    failed = [name for name in names if not fuzz(TARGETS[name], seconds)]
    return 1 if failed or (not words[1:] and not spoil(seconds / SECONDS)) else 0


def spoil(part: float) -> bool:
    """Run a part of the tests of damage, with kernels that check every index; say if all passed."""
    settings = {"OCCMAP_FUZZ": str(part), "NUMBA_BOUNDSCHECK": "1"}
    tests = "tests/test_damage.py", "tests/readers/test_typed.py"
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", *tests]
    return subprocess.run(command, env=os.environ | settings, check=False).returncode == 0


def fuzz(target: Target, seconds: float) -> bool:
    """Read mutations of the seeds until the time is over; keep the first that crashes."""
    with tempfile.TemporaryDirectory(prefix="occmap-seeds-") as folder:
        seeds = target.seeds(Path(folder))
    dice = random.Random(time.time_ns())
    end = time.monotonic() + seconds
    count = 0
    while time.monotonic() < end:
        data = mutate(dice.choice(seeds), dice)
        count += 1
        try:
            with alarm(HANG_S):
                target.read(data)
        except Exception as error:  # noqa: BLE001  any that escapes is what is looked for
            name = hashlib.sha256(data).hexdigest()[:12]
            KEPT.mkdir(exist_ok=True)
            (KEPT / f"{target.name}-{name}").write_bytes(data)
            tell(f"{target.name}: {error!r}, kept as {KEPT.name}/{target.name}-{name}")
            return False
    tell(f"{target.name}: {count} inputs in {seconds:g} s, nothing escaped")
    return True


@contextmanager
def alarm(seconds: int) -> Iterator[None]:
    """Raise where a block hangs."""

    def give_up(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"still busy after {seconds} s")

    signal.signal(signal.SIGALRM, give_up)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)


def tell(text: str) -> None:
    """Print at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
