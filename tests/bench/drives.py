"""How good the maps of 3D drives with a known truth are: `python -m tests.bench.drives [NAME...]`.

The folder that `OCCMAP_CLOUDS` names holds what simulates the drives (`drives.py`), scores a map
(`score.py`), and a table of what the rules of others reach (`README.md`). Each drive is built
without options, and scored on the file that is written.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

from tests.bench.processes import OCCMAP
from tests.bench.tables import draw
from tests.samples import ROOT

CLOUDS = Path(os.environ.get("OCCMAP_CLOUDS", ROOT.parent / "shared" / "clouds"))
LIMITS = {"edge": (98.0, 100.0), "danger": (0, 4.0), "phantom": (0, 0.4), "free": (97.5, 100.0)}
"""The least and the most of each measure (%): true edges found, obstacles called free, obstacles
invented, and free floor called free"""


def call(*words: object) -> str:
    """Run a command; return what it printed."""
    return subprocess.run(list(map(str, words)), capture_output=True, text=True, check=True).stdout


def score_drives(folder: Path, names: Sequence[str], seed: int) -> Iterator[list[str]]:
    """Simulate, build and score drives, and those told in further forms, one by one."""
    call(sys.executable, CLOUDS / "drives.py", folder, *names, "--seed", seed)
    truths = sorted(path.name.removesuffix("-truth.npz") for path in folder.glob("*-truth.npz"))
    for drive in sorted(path for path in folder.iterdir() if path.is_dir()):
        near = [name for name in truths if drive.name.startswith(name)]
        truth = near[0] if near else next(name for name in truths if name[:2] == drive.name[:2])
        call(OCCMAP, "build", "-q", drive, "-o", folder / "map.pgm")
        scored = [CLOUDS / "score.py", folder / "map.yaml", folder / f"{truth}-truth.npz", "--json"]
        yield [drive.name, *mark(json.loads(call(sys.executable, *scored)))]
        rmtree(drive)


def mark(found: dict[str, float]) -> list[str]:
    """Write the measures, with an exclamation mark where one is beyond its limits."""
    return [
        f"{found[name]:.2f}{'' if least <= found[name] <= most else ' !'}"
        for name, (least, most) in LIMITS.items()
    ]


def list_others(text: str) -> list[str]:
    """The lines of the table of rules in a README."""
    lines = text.splitlines()
    start = next(at for at, line in enumerate(lines) if line.startswith("| rule"))
    stop = next(at for at in range(start, len(lines)) if not lines[at].startswith("|"))
    return lines[start:stop]


def main(words: Sequence[str] | None = None) -> None:
    """Simulate the drives, map them, and print how good the maps are beside those of others."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="the drives; all, if none is named")
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    args = parser.parse_args(words)
    if not (CLOUDS / "drives.py").exists():
        sys.exit(f"{CLOUDS} has no drives.py: name its folder in OCCMAP_CLOUDS")
    with TemporaryDirectory() as folder:
        rows = score_drives(Path(folder), args.names, args.seed)
        sys.stdout.write(draw(["drive (%)", *LIMITS], rows))
    others = list_others((CLOUDS / "README.md").read_text(encoding="utf-8"))
    sys.stdout.write("\n".join(["\nOthers, as edge / danger / phantom:\n", *others, ""]))


if __name__ == "__main__":
    main()
