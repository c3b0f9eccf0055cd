"""`occmap merge` and `occmap render`: saved evidence added up, taken apart and made a map."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli import options
from occmap.cli.console import Console, label_first, write_rows
from occmap.cli.declaring import Answer, answering, fail_if, join, option
from occmap.cli.options import choose_saved_model
from occmap.cli.streams import hide_sent, place_outputs
from occmap.errors import UsageError
from occmap.report.limits import SAVED
from occmap.report.results import Report, tell_map, tell_scans
from occmap.store.merging import combine
from occmap.store.publishing import RenderOptions, publish
from occmap.store.reading import Saved, open_saved
from occmap.writers.outputs import check_outputs

subtracted = options.paths(
    options.FILES, "--subtract", metavar="NPZ", text="Take the evidence in this file away."
)


@answering("merge", Report)
@click.argument("paths", nargs=-1, required=True, type=options.PATH, metavar="NPZ|ZARR...")
@join(options.writing, subtracted, options.min_passes, options.max_cells)
@join(fail_if(SAVED, "unknown > 60%"), options.printing)
def merge_command(console: Console, /, paths: tuple[Path, ...], **values: Any) -> Answer:
    """Add saved evidence, or take some of it away, exactly.

    The sum has the same cells as one build of all the logs, whatever the order; what is subtracted
    leaves no trace. All must have one resolution, update and kind of model. The visits that
    --min-passes counts are those of one build, too: one that goes on from log to log is one.

      occmap merge monday.npz tuesday.npz -o both.npz
      occmap merge both.npz --subtract monday.npz -o tuesday.npz -o tuesday.pgm
    """
    taken = values["subtract"]
    return put_out(console, [*paths, *taken], lambda: combine(paths, taken), values)


overview = option(
    options.MAP,
    "--overview",
    type=click.IntRange(min=1),
    metavar="N",
    help="Make each pixel N x N cells, quickly, from the pictures in a .zarr: 4, 16, 64 ...",
)


@answering("render", Report)
@click.argument("path", type=options.PATH, metavar="NPZ|ZARR")
@join(options.writing, options.framing, overview, options.min_passes, options.max_cells)
@join(options.saved_model)
@join(fail_if(SAVED, "unknown > 60%"), options.printing)
def render_command(console: Console, /, path: Path, **values: Any) -> Answer:
    """Make a map of saved evidence, without reading the log.

    The evidence is what `occmap build -o map.npz` wrote. Hits and misses can be weighed by any
    model that counts. The evidence of a radial model, such as quadratic, can be weighed only by
    that model, though with another --prior, --clamp-min or --clamp-max.

      occmap render map.npz -o map.pgm --p-hit 0.8
      occmap render map.npz -o map.pgm -o map.png --model counting --mode scale
      occmap render map.npz -o room.png --extent 0,0,5,4
      occmap render city.zarr -o city.png --overview 16
    """
    return put_out(console, [path], lambda: open_saved(path), values)


def put_out(
    console: Console, inputs: Sequence[Path], read: Callable[[], Saved], values: dict[str, Any]
) -> Answer:
    """Render evidence, write it as the user wants, and sum it up.

    Raises
    ------
    OccmapError
        No output is given, or, before anything is read, one that cannot be made or is an input;
        or the evidence cannot be rendered.
    """
    if not values["outputs"]:
        command = click.get_current_context().info_name
        example = "merged.npz" if command == "merge" else "map.pgm"
        raise UsageError("where to write is not given", fix=f"add -o {example}")
    outputs = place_outputs(console, values["outputs"], inputs[0])
    check_outputs(outputs, inputs)
    evidence = read()
    options = take(RenderOptions, {**values, "model": choose_saved_model(evidence, values)})
    report = hide_sent(publish(evidence, options, outputs))
    rows = [*tell_map(report.map), *tell_scans(report), *label_first("files", report.files)]
    return Answer(report, write_rows(rows))
