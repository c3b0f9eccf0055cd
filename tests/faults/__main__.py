"""Kill commands that write, 500 times or as often as the first word says; the second is a seed."""

import sys
import tempfile
from pathlib import Path

from tests.faults.kills import kill_at_random

RUNS = 500


def main(words: list[str]) -> int:
    """Print what came of each; 1 where a file was torn or left over, or something else was said."""
    runs, seed = [*map(int, words), *(RUNS, 1)[len(words) :]]
    with tempfile.TemporaryDirectory(prefix="occmap-kills-") as folder:
        outcomes = kill_at_random(Path(folder), runs, seed)
    for outcome, count in sorted(outcomes.items()):
        print(f"{count:5} {outcome}")  # noqa: T201  the result
    return 1 if any(outcome.startswith("FAULT") for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
