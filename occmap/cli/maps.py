"""`occmap merge`, `render`, `explain`, `score` and `diff`: what is made and asked of what is there.

That is saved evidence, which is added up, made a map and asked about; and written maps, which are
scored and compared.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from occmap.choices import list_options, take
from occmap.cli import options
from occmap.cli.console import Console, align, write_rows
from occmap.cli.declaring import CONFIG, PATH, Answer, Value, command, fail_if, flag
from occmap.difference import MapDifference, tell_changes
from occmap.errors import UsageError
from occmap.explanation import Explanation, Observation, Question, Visits, explain
from occmap.grid.rendering import Framing
from occmap.options import FILES, OPTIONS, POSES, SCANS, BuildOptions
from occmap.report import Row, count, join_names, label_first, write_box, write_time
from occmap.report.limits import DIFF, SAVED, SCORE
from occmap.report.results import Report
from occmap.scoring.maps import Against, MapScore, score
from occmap.scoring.matching import lay_on
from occmap.store import Blocks, open_saved
from occmap.store.merging import STAY, Transform, combine
from occmap.store.painting import RenderOptions, publish, refuse_unsaved
from occmap.types import Paths
from occmap.writers import WriteOptions, check_outputs

LIMIT = fail_if(SAVED, "unknown > 60%")


@command(
    "merge",
    Report,
    click.Argument(["paths"], nargs=-1, required=True, type=PATH, metavar="NPZ|ZARR..."),
    *options.WRITING,
    options.paths(FILES, "NPZ", "Take the evidence in this file away.", "--subtract"),
    flag(
        FILES,
        "--fit",
        text="First move each file after the first by the shift of up to 2 m and the turn of up "
        "to 20 degrees by which its walls lie on those before it, where one is clearly the best.",
    ),
    *(*options.KEPT_CELLS, LIMIT),
)
def merge_command(console: Console, /, paths: tuple[Path, ...], **values: Any) -> Answer:
    """Add saved evidence, or take some of it away, exactly.

    The sum has the same cells as one build of all the logs, whatever the order; what is subtracted
    leaves no trace. All must have one resolution, update and kind of model. The visits that
    --min-passes counts are those of one build, too: one that goes on from log to log is one.

      occmap merge monday.npz tuesday.npz -o both.npz
      occmap merge both.npz --subtract monday.npz -o tuesday.npz -o tuesday.pgm
      occmap merge monday.npz shifted.npz --fit -o both.npz
    """
    taken = values["subtract"]
    if values["fit"] and len(paths) == 1:
        console.announce("--fit does nothing: one file has nothing to be moved onto")
    lay = lay_on if values["fit"] else None
    return put_out(console, [*paths, *taken], lambda: combine(paths, taken, lay), values)


OF_SAVED = list_options(RenderOptions, "Map")


@command(
    "render",
    Report,
    click.Argument(["paths"], nargs=-1, required=True, type=PATH, metavar="NPZ|ZARR"),
    *(*options.WRITING, *options.fields(list_options(Framing))),
    *(options.field(OF_SAVED[name]) for name in ("since", "until", "overview")),
    *(*options.KEPT_CELLS, *options.SAVED_MODEL, LIMIT),
)
def render_command(console: Console, /, paths: tuple[Path, ...], **values: Any) -> Answer:
    """Make a map of saved evidence, without reading the log.

    The evidence is what `occmap build -o map.npz` wrote. Hits and misses can be weighed by any
    model that counts. The evidence of a radial model, such as quadratic, can be weighed only by
    that model, though with another --prior, --clamp-min or --clamp-max.

      occmap render map.npz -o map.pgm --model simple --p-hit 0.8
      occmap render map.npz -o map.pgm -o map.png --model counting --mode scale
      occmap render map.npz -o room.png --extent 0,0,5,4
      occmap render map.npz -o fresh.png --since 2026-11-02
      occmap render city.zarr -o city.png --overview 16
    """
    if len(paths) > 1:
        raise UsageError("there are several files", fix="`occmap merge` adds them up to one map")
    return put_out(console, paths, lambda: open_saved(paths[0]), values)


def put_out(
    console: Console, inputs: Paths, read: Callable[[], Blocks], values: dict[str, Any]
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
    outputs = options.place_outputs(console, values["outputs"], inputs[0])
    writing = take(WriteOptions, values)
    check_outputs(outputs, inputs, writing)
    refuse_unsaved(outputs, values.get("overview"))
    evidence = read()
    view = {"model": options.choose_saved_model(evidence, values), "writing": writing}
    return options.answer(publish(evidence, take(RenderOptions, values | view), outputs))


MOST_SCANS, MOST_BUILDS = 12, 6
"""Longer lists are cut: --json has all"""


@command(
    "explain",
    Explanation,
    click.Argument(["path"], type=PATH, metavar="NPZ|ZARR"),
    click.Argument(["x"], type=Value.of(float)),
    click.Argument(["y"], type=Value.of(float)),
    options.paths(
        SCANS, "LOG", "List the scans of this log that observed the cell.", "--log", "logs"
    ),
    options.paths(POSES, "FILE", "The trajectory that the log was built with.", "--poses"),
    *(*options.fields(["min_passes"]), *options.SAVED_MODEL, *options.THRESHOLDS),
)
def explain_command(console: Console, /, path: Path, **values: Any) -> Answer:
    """Say what was seen at a point of saved evidence, and by which scans.

    X and Y are metres in the map frame. Give the logs that the evidence was made of as --log, to
    list the scans that hit or cleared the cell. A log is known by its hash, wherever it lies now.

      occmap explain map.npz 1.5 -0.25
      occmap explain map.npz 1.5 -0.25 --log drive.mcap
      occmap explain map.npz 1.5 -0.25 --log scans.csv --poses trajectory.txt --json
    """
    evidence = open_saved(path)
    model, writing = options.choose_saved_model(evidence, values), take(WriteOptions, values)
    others = values["poses"]  # lie beside the logs, and are none
    values["logs"], _ = options.gather_logs(console, values["logs"], BuildOptions(), others)
    question = take(Question, {**values, "model": model, "writing": writing})
    explanation = explain(evidence, question, console.advance)
    scans = list_scans(explanation) if values["logs"] else ()
    return Answer(explanation, write_rows([*list_cell(explanation), *scans]))


def list_cell(explanation: Explanation) -> Iterator[Row]:
    """Say where the cell is, what it is, and what is beside it."""
    cell, seen = explanation.cell, explanation.seen
    place = f"row {cell.lattice_row}, column {cell.lattice_column} of the lattice"
    yield "cell", f"{place}: {write_box(cell.extent)}"
    if explanation.verdict != "unknown":
        by = f"probability {explanation.probability:.3f} by {explanation.model}"
        yield "class", f"{explanation.verdict}: {by}"
    elif seen.observations:
        yield "class", "unknown: it was hit, but on fewer visits than --min-passes"
    else:
        yield "class", "unknown: nothing observed this cell"
    if seen.observations:
        yield "seen", str(seen)
        yield from list_forgotten(explanation)
        yield from list_builds(explanation)
        pairs = [["/".join(write_pair(each)) for each in row] for row in explanation.around]
        yield from label_first("around", align(pairs))
    elif explanation.verdict != "unknown":
        beside = "hits of the cells beside it count here in part (--spread)"
        yield "seen", f"nothing of its own: {beside}"
    if explanation.ground is not None:
        yield "ground", f"{explanation.ground:.3f} m high there, as the clouds showed it"
    if box := explanation.map_extent:
        x, y = explanation.point
        if not (box[0] <= x < box[2] and box[1] <= y < box[3]):
            yield "", f"it lies outside of the map: {write_box(box)}"


def list_forgotten(explanation: Explanation) -> Iterator[Row]:
    """Say what is left of a cell, and why, if the number of visits took some of it away."""
    kept = explanation.kept
    if kept and kept.numbers != explanation.seen.numbers:
        why = "half of its visits or more" if kept.hits else "fewer visits"
        yield "kept", f"{kept} by --min-passes {explanation.min_passes}, since {why} hit it"


def list_builds(explanation: Explanation) -> list[Row]:
    """Say on how many visits each build observed the cell, and when; and then all together."""
    builds = explanation.builds
    shown = [f"{join_names(each.logs)}: {describe_visits(each)}" for each in builds[:MOST_BUILDS]]
    if len(builds) > MOST_BUILDS:
        shown.append(f"and {len(builds) - MOST_BUILDS:,} more builds: --json lists all")
    if len(builds) > 1 and explanation.visits:
        shown.append(f"together: {describe_visits(explanation.visits)}")
    return label_first("visits", shown)


def describe_visits(visits: Visits) -> str:
    """Write on how many visits a cell was observed, and in which slices of time."""
    found = count(visits.seen_visits, "visit")
    if visits.hit_visits is not None:
        found = f"hit on {visits.hit_visits:,} of {found}"
    since, until = write_time(visits.since_ns), write_time(visits.until_ns)
    return f"{found}, in slices of time from {since} to {until}"


def write_pair(seen: Observation) -> tuple[str, str]:
    """Write the two numbers of a cell."""
    first, second = seen.pair
    return f"{first:.15g}" if seen.log_odds is None else f"{first:.2f}", f"{second:.15g}"


def list_scans(explanation: Explanation) -> Iterator[Row]:
    """Sum up the scans that observed the cell, and list some, those that speak for a thing first.

    A cell is mostly seen through, and who asks wants to know who hit it.
    """
    scans = sorted(explanation.scans, key=lambda scan: scan.seen.numbers[0] <= 0)
    used = f"of {count(explanation.scans_used, 'scan')} used"
    if not scans:
        yield "scans", f"none {used} observed the cell"
        return
    yield "scans", f"{len(scans):,} {used}: {explanation.explained}"
    pair = "hits misses" if explanation.seen.log_odds is None else "log-odds observations"
    rows = [("stamp (s)", *pair.split(), "sensor at (m)", "away (m)", "from")]
    for scan in scans[:MOST_SCANS]:
        place, log = f"{scan.x:.3f}, {scan.y:.3f}", f"{Path(scan.log).name} {scan.topic}"
        away = f"{scan.distance:.3f}"
        rows.append((f"{scan.stamp_ns / 1e9:.3f}", *write_pair(scan.seen), place, away, log))
    yield from (("", line) for line in align(rows))
    if len(scans) > MOST_SCANS:
        yield "", f"and {len(scans) - MOST_SCANS:,} more: --json lists all"


AGAINST = list_options(Against, "What it is held against")


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
        values["logs"], _ = options.gather_logs(console, values["logs"], common)
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


@command(
    "diff",
    MapDifference,
    click.Argument(["before"], type=PATH, metavar="A"),
    click.Argument(["after"], type=PATH, metavar="B"),
    options.one_output(
        "output", "FILE", "Write the changes here: .png is a picture, .html a page."
    ),
    *options.THRESHOLDS,
    options.field(OPTIONS["edits"], help="Say which changes lie in the shapes in this file."),
    fail_if(DIFF, "changed > 1%", "--fail-above"),
)
def diff_command(_console: Console, /, before: Path, after: Path, **values: Any) -> Answer:
    """Say what changed between two maps, and fail above a limit.

    A and B are maps as PGM with YAML, PNG, or evidence (.npz or .zarr). They may differ in size, as
    all maps of one resolution share a lattice. A PNG does not say where it lies, so it is compared
    with a map of its size. A PNG that occmap wrote says how its cells were decided; in any other,
    dark cells are occupied.

    A cell that is neither occupied nor free is unknown or undecided; images do not tell one from
    the other, so both count as neither.

    In the picture, cells that became occupied are orange and cells that became free are blue:
    strong where they were the opposite before, pale where they were neither. Cells that became
    neither are wine red if they were occupied and pink if they were free.

      occmap diff yesterday.pgm today.pgm
      occmap diff golden.yaml build/map.pgm -o diff.png --fail-above 1%
    """
    from occmap.page import compare_files  # noqa: PLC0415  late: it brings all that makes pages

    difference = compare_files(before, after, take(WriteOptions, values), values["output"])
    return Answer(difference, write_rows(tell_changes(difference)))
