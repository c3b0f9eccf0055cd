"""`occmap check`: what is in logs, and what will go wrong. `occmap score`: how good a map is."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.choices import list_options, take
from occmap.cli import options
from occmap.cli.console import Console, write_command, write_rows
from occmap.cli.declaring import CONFIG, PATH, Answer, command, fail_if
from occmap.inspection import findings, inspect
from occmap.inspection.findings import Inspection, LogFindings
from occmap.options import BuildOptions
from occmap.readers import Role, Stream
from occmap.report import Row, count, label_first
from occmap.report.limits import CHECK, SCORE
from occmap.scoring.maps import Against, MapScore, score
from occmap.store.moving import STAY, Transform
from occmap.writers import check_picture

AGAINST = list_options(Against, "What it is held against")
LABEL = 10
"""Width of the column of labels"""


@command(
    "check",
    Inspection,
    options.LOGS,
    options.one_output("output", "FILE.html", "Write the findings as a page as well."),
    *options.OF_LOGS,
    *(fail_if(CHECK, "dropped_scans > 5%"), CONFIG),
)
def check_command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Say what is in logs, and what will go wrong with them.

    It takes the options of `occmap build` that concern scans, poses and ranges, and ends with the
    command line that it recommends. Exits with 1 if a build with the options given would fail.

      occmap check drive.mcap
      occmap check room.bag --sensor-pose 0,0,3.14159 --resolution 0.02
      occmap check intel.log.gz --json
    """
    check_picture(values["output"], logs, [".html"])
    chosen = take(BuildOptions, values)
    inspection = inspect(options.gather_logs(console, logs, chosen), chosen)
    if values["output"]:
        from occmap.page import write_inspection  # noqa: PLC0415  late: few want it

        write_inspection(values["output"], inspection)
    if console.quiet or console.as_json:
        for problem in inspection.problems:
            console.tell(f"error: {problem}")
    failure = None if inspection.buildable else click.exceptions.Exit(1)
    return Answer(inspection, format_inspection(inspection), failure)


def format_inspection(inspection: Inspection) -> Iterator[str]:
    """Write all findings; problems and the recommended command come last."""
    for log in inspection.logs:
        yield log.path
        yield from write_rows(((f"  {name}", text) for name, text in list_log(log)), LABEL)
        yield ""
    rows = [] if inspection.map is None else [("map", findings.describe_map(inspection.map))]
    rows += [("warning", text) for text in inspection.warnings]
    rows += [("problem", text) for text in inspection.problems]
    yield from write_rows(rows, LABEL)
    if inspection.command:
        yield from (*[""] * bool(rows), write_command(inspection.command))


def list_log(log: LogFindings) -> Iterator[Row]:
    """List all about one log."""
    yield from label_first("topics", list_streams(log.streams))
    for topic in log.scans:
        yield "", ""
        yield from findings.list_facts(topic)
    if log.coverage:
        yield "", ""
    yield from label_first("sources", findings.list_sources(log.coverage))
    yield from label_first("note", log.other_notes)


def list_streams(streams: Sequence[Stream]) -> Iterator[str]:
    """List the topics with their types and counts, and what each is good for."""
    width = max((len(stream.topic) for stream in streams), default=0)
    kinds = max((len(stream.type) for stream in streams), default=0)
    for stream in streams:
        role = "" if stream.role is Role.OTHER else f"  {stream.role}s"
        yield f"{stream.topic:<{width}}  {stream.type:<{kinds}}  {stream.count:>8,}{role}"


@command(
    "score",
    MapScore,
    click.Argument(["path"], type=PATH, metavar="MAP"),
    *(options.field(AGAINST[name]) for name in ("logs", "truth", "within_m", "fit")),
    options.one_output("picture", "FILE", "Write a .png here: where the map and the truth differ."),
    *options.OF_SCORED_LOGS,
    *(fail_if(SCORE, "edges_found < 95%"), CONFIG),
)
def score_command(console: Console, /, path: Path, **values: Any) -> Answer:
    """Say how good a map is, by recordings or by the truth.

    MAP is what map_server loads, whatever tool made it (PGM with YAML), or evidence (.npz or
    .zarr). Recordings say how well it predicts their beams: the share whose first occupied cell is
    within two cells of the measured range, as compare has it, and the share of hits that lie in
    occupied cells or beside one. Use recordings that the map was not made of.

    The truth, of any resolution, says which of its edges are found and which of the map's walls are
    invented, what is free though it is occupied and the other way round, and how far walls are off.
    In the picture edges that were missed are orange, and blue where the map calls them free; walls
    that were invented are red.

      occmap score map.yaml --log drive.mcap
      occmap score map.yaml --truth plan.yaml --fit -o score.png
      occmap score map.yaml --truth plan.yaml --fail-if "edges_found < 95%"
    """
    common = take(BuildOptions, values)
    if values["logs"]:
        values["logs"] = tuple(options.gather_logs(console, values["logs"], common))
    made = score(path, take(Against, values), common, console.advance)
    return Answer(made, write_rows(list_score(made)))


def list_score(made: MapScore) -> Iterator[Row]:
    """Write a score in a few rows."""
    occupied, free = count(made.occupied, "occupied cell"), count(made.free, "free one")
    yield "map", f"{made.map}: {occupied} and {free} of {made.resolution:g} m"
    if it := made.by_logs:
        error = f" +- {it.share_error:.4f}" if math.isfinite(it.share_error) else ""
        yield "logs", f"share {it.share:.4f}{error} of {count(it.beams, 'beam')}"
        yield "", f"log-likelihood {it.log_likelihood:.3f}"
        yield "", f"{it.agreement:.1%} of the hits lie in occupied cells or beside one"
        stops = f"{it.stops_in_occupied:.1%} of the looks at occupied cells"
        yield "", f"beams stop at {stops} and {it.stops_in_free:.1%} of those at free ones"
        yield from tell_move(it.transform, "the logs fit with --transform ")
    if found := made.by_truth:
        near = f"within {found.within_m:g} m"
        yield "truth", f"{found.edges_found:.1%} of the edges of {found.truth} found {near}"
        yield "", f"{found.edges_invented:.1%} of the occupied cells invented"
        yield "", f"{found.occupied_called_free:.1%} of the edges called free"
        floor = f"{found.free_called_occupied:.2%} called occupied, {found.free_found:.1%} free"
        yield "", f"of the free cells away from walls {floor}"
        mean, most = found.wall_distance_m, found.wall_distance_95_m
        yield "walls", f"{mean:.3f} m from those of the truth, 95 in 100 within {most:.3f} m"
        yield from tell_move(found.transform, "the map fits moved by ")
    yield from (("file", file) for file in made.files)


def tell_move(moved: Transform, text: str) -> Iterator[Row]:
    """Say by what something was moved to fit, if it was."""
    if moved != STAY:
        yield "fit", f"{text}{moved.x:g},{moved.y:g},{moved.yaw:g}"
