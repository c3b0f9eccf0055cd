"""`occmap demo`: a log and its map, for an install without a clone."""

import shutil
from importlib.resources import files
from pathlib import Path

import click

from occmap.cli.console import Console, show_progress, write_rows
from occmap.cli.declaring import PATH, Answer, command
from occmap.errors import OccmapError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.report import label_first
from occmap.report.results import Report, tell_map, tell_scans
from occmap.writers.atomic import refuse_unwritable

SAMPLES = "drive.mcap", "floor_plan.pgm", "floor_plan.yaml"
"""A simulated drive through an office, and the plan of it"""


@command(
    "demo", Report, click.Argument(["folder"], type=PATH, default="occmap-demo", metavar="[FOLDER]")
)
def demo_command(console: Console, /, folder: Path) -> Answer:
    """Map a simulated drive, to see what occmap does.

    The log, the plan of the office and the maps are put into FOLDER (occmap-demo), and what to type
    next is said.

      occmap demo
    """
    with refuse_unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name in SAMPLES:
            shutil.copyfile(find_sample(name), folder / name)
    log, made = folder / SAMPLES[0], [folder / f"map.{suffix}" for suffix in ("pgm", "png", "npz")]
    with show_progress(console) as progress:
        report = build([log], BuildOptions(), made, progress).report
    commands = (
        f"occmap check {log}",
        f"occmap build beam {log} -o {folder / 'beam.png'}",
        f"occmap explain {made[2]} 11.18 -1.18 --log {log}",
        f"occmap score {folder / 'map.yaml'} --truth {folder / SAMPLES[2]}",
        "occmap build YOUR_LOG -o map.pgm",
    )
    rows = [
        *tell_map(report.map),
        *tell_scans(report),
        *label_first("files", report.files),
        ("look at", str(made[1])),
        *label_first("next", commands),
    ]
    return Answer(report, write_rows(rows))


def find_sample(name: str) -> Path:
    """Find a sample in the install, or in the clone that it is of; raises OccmapError if absent."""
    package = Path(str(files("occmap")))
    for folder in (package / "samples", package.parent / "sample_logs"):
        if (folder / name).is_file():
            return folder / name
    raise OccmapError(f"the sample {name} is not a part of this install", fix="install it anew")
