"""What a notebook or a program calls: the commands as functions, and the map that they give."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from html import escape
from pathlib import Path
from typing import Any, Self

from occmap import difference, explanation, inspection, page, tuning
from occmap.cells import Evidence, OccupancyMap
from occmap.choices import describe_options, read_options, read_value
from occmap.errors import UsageError, refuse_failures, require
from occmap.evidence import to_grid
from occmap.grid.tiles import CellNumbers, EvidenceKind
from occmap.options import OF_A_SCORED_MAP, OF_ONE_MAP, BuildOptions
from occmap.pipeline import build, list_input_files
from occmap.readers import DEFAULT_OPTIONS, Log, open_log
from occmap.report.results import Build, Report
from occmap.scans.logs import Inputs, find_inputs
from occmap.scoring import compare as scoring
from occmap.scoring import maps
from occmap.scoring.matching import lay_on
from occmap.sensor.models import MODEL, SensorModel
from occmap.store import Blocks, merging, open_saved, painting, read_all
from occmap.types import Float64, Update
from occmap.writers import Product, WriteOptions, check_outputs, write_outputs


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Map(OccupancyMap):
    """An occupancy map with its report and what was observed."""

    report: Report
    """Scans, beams, shares, and `notes`: what the command line prints beside the map"""
    writing: WriteOptions
    """How it is saved"""
    inputs: tuple[Path, ...]
    """The files it was made of, which are never written over"""
    evidence: Evidence
    """What was observed; without slices of time where no .npz was asked for"""

    @classmethod
    def of(cls, made: Build, writing: WriteOptions, inputs: Sequence[Path]) -> Self:
        """Add to a map what was found beside it, and how and over what it may be saved."""
        whole = made.map
        if isinstance(whole, painting.BlockMap):
            whole, _ = whole.paint_all()
        found: dict[str, Any] = {it.name: getattr(whole, it.name) for it in fields(OccupancyMap)}
        found |= {"report": made.report, "evidence": made.evidence}
        return cls(**found, writing=writing, inputs=tuple(inputs))

    @property
    def hits(self) -> Float64:
        """(H, W): how many beams ended in each cell.

        The polygon update counts scans rather than beams. The beams that the surface update adds
        between two neighbours count as fractions of one.

        Raises
        ------
        UsageError
            The map was made with a model that sums up log-odds.
        """
        return self._read_counts()[0]

    @property
    def misses(self) -> Float64:
        """(H, W): how many beams went through each cell; as `hits` otherwise."""
        return self._read_counts()[1]

    @refuse_failures()
    def save(self, path: str | Path) -> tuple[Path, ...]:
        """Write the map; the suffix picks the format, such as .pgm (with its YAML).

        Returns
        -------
        tuple of Path
            The files that were written.

        Raises
        ------
        UsageError, OutputError
            No writer has that suffix, the path is an input of the map, the evidence was not kept
            (.npz), or the file cannot be written.
        """
        outputs = read_value("path", Paths, path)
        check_outputs(outputs, self.inputs, self.writing)
        product = Product(self, self._take_evidence, report=self.report)
        return tuple(map(Path, write_outputs(outputs, product, self.writing)))

    def __repr__(self) -> str:
        grid, scans = self.report.map, self.report.scans
        # What one of several builds left out is mostly in another one.
        asked = scans.wanted if self.report.builds > 1 else scans.read
        return (
            f"<Map of {grid.columns} x {grid.rows} cells of {grid.resolution:g} m: "
            f"{grid.occupied:.1%} occupied, {grid.free:.1%} free, {grid.unknown:.1%} unknown; "
            f"{scans.used:,} of {asked:,} scans used>"
        )

    def _repr_html_(self) -> str:
        """Show the probability as a small picture, dark is occupied, and the notes under it."""
        from occmap.writers.images import encode_png  # noqa: PLC0415  late: brings pillow

        png = b64encode(encode_png(page.paint_map(self, self.box))).decode()
        lines = [repr(self).strip("<>"), *self.report.notes]
        return f'<img src="data:image/png;base64,{png}"><br>' + "<br>".join(map(escape, lines))

    def _take_evidence(self) -> Evidence:
        # Of what a build went on from they are there, but maybe not its own.
        if not len(self.evidence.slices) == len(self.evidence.manifest.builds) > 0:
            found = "this map did not keep when its cells were seen, which an .npz holds"
            raise UsageError(found, fix='build it with outputs="map.npz"')
        return self.evidence

    def _read_counts(self) -> CellNumbers:
        if self.evidence.manifest.kind != EvidenceKind.COUNTS:
            name, _, _ = self.report.map.model.partition(":")
            found = f"the model {name} sums up log-odds: it keeps no hits and misses"
            raise UsageError(found, fix='build with model="counting" or model="simple"')
        return to_grid(self.evidence).read(self.box)


AnyPath = str | Path
AnyPaths = AnyPath | Iterable[AnyPath]
Paths = tuple[Path, ...]


@refuse_failures()
def build_map(*logs: AnyPaths, outputs: AnyPaths = (), **options: Any) -> Map:
    """Build one occupancy map from all usable scans of one or more logs.

    Parameters
    ----------
    logs
        Paths to recordings of any installed format, one by one or as a list; a folder or a pattern
        such as "day/*.bag" stands for all recordings in it.
    outputs
        Files to write at once; the suffix picks the format. Only a map that was built with an .npz
        among them can be saved as one later: it keeps when its cells were seen, which takes time.
    options
        By name, each as Python has it or as it is typed; None leaves an option at its default:

        OPTIONS

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, an option is unknown or out of its range,
        the map would be too large, or an output cannot be written.
    """
    files: Paths = read_value("outputs", Paths, outputs)
    (paths, notes), chosen = read_request(logs, options, "build_map", files)
    made = build(paths, chosen, files)
    told = made._replace(report=made.report.add_notes(notes))
    return Map.of(told, chosen.writing, list_input_files(paths, chosen))


if build_map.__doc__:  # Python leaves texts out where it is told to
    _LINES = "\n        ".join(describe_options(BuildOptions))
    build_map.__doc__ = build_map.__doc__.replace("OPTIONS", _LINES)


@refuse_failures()
def check(*logs: AnyPaths, **options: Any) -> inspection.Inspection:
    """Say what is in logs, and what will go wrong with them: `occmap check`.

    Parameters
    ----------
    logs, options
        As for `build_map`; options that concern one map alone are refused.

    Returns
    -------
    Inspection
        `logs`, `map`, `problems`, `warnings`, and the `command` that it recommends. A log that
        cannot be read is among the problems.

    Raises
    ------
    UsageError
        No log is given, or an option is unknown or out of its range.
    """
    (paths, notes), common = read_request(logs, options, "check")
    return inspection.inspect(paths, common, notes)


@refuse_failures()
def compare(
    *logs: AnyPaths,
    updates: Sequence[str] = (),
    models: Sequence[str | SensorModel] = (),
    picture: AnyPath | None = None,
    **options: Any,
) -> scoring.VariantComparison:
    """Build maps with several updates and models, and score them on held-out scans.

    Parameters
    ----------
    logs, options
        As for `check`.
    updates, models
        What to combine; without them, all updates and the usual models.
    picture
        A PNG to draw all maps in, and where they disagree; or a page (.html).

    Returns
    -------
    VariantComparison
        `results`, the best share first, each with its `variant`, `score` and `map`; the
        `recommended` one, and the `likeliest`.

    Raises
    ------
    OccmapError
        As `build_map`, or no held-out beam measured a range.
    """
    (paths, notes), common = read_request(logs, options, "compare")
    variants = scoring.combine(
        read_value("updates", tuple[Update, ...], updates),
        read_value("models", tuple[SensorModel, ...], models, MODEL),
    )
    drawn = read_value("picture", Path | None, picture)
    return page.compare_logs(paths, variants, common, drawn).add_notes(notes)


@refuse_failures()
def tune(*logs: AnyPaths, **options: Any) -> tuning.Tuning:
    """Search for the time offset and the mount by which a map predicts held-out scans better.

    Parameters
    ----------
    logs, options
        As for `check`.

    Returns
    -------
    Tuning
        What was found of `time` and of `mount`, the `gain`, and the `command` that uses it.

    Raises
    ------
    OccmapError
        As `compare`.
    """
    (paths, notes), common = read_request(logs, options, "tune")
    return tuning.tune(paths, common).add_notes(notes)


@refuse_failures()
def merge(*paths: AnyPaths, subtract: AnyPaths = (), fit: bool = False, **options: Any) -> Map:
    """Add saved evidence (.npz) exactly, or take some of it away; one file alone is rendered.

    Parameters
    ----------
    paths
        Evidence of one resolution, update and kind of model.
    subtract
        Evidence to take away from the sum.
    fit
        First move each file after the first one so that its walls lie on those before it.
    options
        Of `build_map`: model (the default is what the evidence was built with), min_passes,
        max_cells, extent, margin, edits, georeference, mode, occupied_thresh, free_thresh and
        shade; since and until, stamps or dates: only what was seen in that time is shown.

    Raises
    ------
    OccmapError
        A file cannot be read, the evidence does not go together, or an option is unknown or out of
        its range.
    """
    added, taken = list_paths(paths, "merge"), read_value("subtract", Paths, subtract)
    chosen = read_options(painting.RenderOptions, options, "merge")
    lay = lay_on if read_value("fit", bool, fit) else None
    whole = read_all(merging.combine(added, taken, lay))
    made = painting.render_saved(Blocks.of(whole), chosen)
    build = Build(made.grid, made.report, made.evidence())
    return Map.of(build, chosen.writing, [*added, *taken])


@refuse_failures()
def diff(
    before: AnyPath, after: AnyPath, picture: AnyPath | None = None, **thresholds: Any
) -> difference.MapDifference:
    """Say what changed between two maps.

    Parameters
    ----------
    before, after
        Maps as PGM with YAML, PNG or evidence (.npz).
    picture
        A PNG to draw the changes in, or a page (.html).
    thresholds
        occupied_thresh and free_thresh, for formats that hold probabilities.

    Returns
    -------
    MapDifference
        `share` of the `known` cells that changed, `changed` cells by what they were and are, and
        the `largest` connected change.

    Raises
    ------
    OccmapError
        A map cannot be read, they do not lie on one lattice, or the picture cannot be written.
    """
    one, other = read_value("before", Path, before), read_value("after", Path, after)
    chosen = read_options(WriteOptions, thresholds, "diff")
    return page.compare_files(one, other, chosen, read_value("picture", Path | None, picture))


@refuse_failures()
def score(  # noqa: PLR0913  what a caller gives, by name
    path: AnyPath,
    *,
    logs: AnyPaths = (),
    truth: AnyPath | None = None,
    within_m: float = maps.WITHIN_M,
    fit: bool = False,
    picture: AnyPath | None = None,
    **options: Any,
) -> maps.MapScore:
    """Say how good a written map is, whatever tool made it: `occmap score`.

    Parameters
    ----------
    path
        A map as PGM with YAML, or evidence (.npz or .zarr).
    logs
        Recordings of the place; best such as the map was not made of.
    truth
        The map that is true: a plan, a simulator's, or another tool's.
    within_m
        A wall is found, and not invented, if it is off by at most so much (m).
    fit
        First move the recordings onto the map, and the map onto the truth, as they fit best.
    picture
        A PNG to draw in where the map and the truth differ.
    options
        Of `build_map`: how logs are read and posed, occupied_thresh and free_thresh, and jobs.

    Returns
    -------
    MapScore
        `by_logs`: `share`, `log_likelihood` and `agreement`; `by_truth`: `edges_found`,
        `edges_invented` and others; None each where it is not asked for.

    Raises
    ------
    OccmapError
        Neither logs nor the truth are given, a map or a log cannot be read, no beam measured a
        range, an option is unknown or out of its range, or the picture cannot be written.
    """
    chosen = read_options(BuildOptions, options, "score", OF_A_SCORED_MAP)
    recordings, notes = find_inputs(read_value("logs", Paths, logs), chosen.reading)
    asked = {"truth": truth, "within_m": within_m, "fit": fit, "picture": picture}
    against = read_options(maps.Against, {"logs": recordings, **asked}, "score")
    return maps.score(read_value("path", Path, path), against, chosen).add_notes(notes)


@refuse_failures()
def explain(
    path: AnyPath, x: float, y: float, *, logs: AnyPaths = (), poses: AnyPaths = (), **options: Any
) -> explanation.Explanation:
    """Say what was seen at a point of saved evidence, and by which scans: `occmap explain`.

    Parameters
    ----------
    path
        Evidence (.npz or .zarr).
    x, y
        The point in the map frame (m).
    logs
        Those that the evidence was made of, or their folder, to list the scans that observed the
        cell.
    poses
        The trajectory files that these were built with.
    options
        model (the default is what the evidence was built with), min_passes, occupied_thresh and
        free_thresh: how the cell is judged.

    Returns
    -------
    Explanation
        `verdict`, `probability`, what was `seen` in the cell and `around` it, and the `scans`.

    Raises
    ------
    OccmapError
        A file cannot be read, the evidence was not made of a log, or an option is unknown or out of
        its range.
    """
    asked = {"x": x, "y": y, "logs": logs, "poses": poses, **options}
    question = read_options(explanation.Question, asked, "explain")
    recordings, notes = find_inputs(question.logs, DEFAULT_OPTIONS, question.poses)
    question = replace(question, logs=tuple(recordings))
    saved = open_saved(read_value("path", Path, path))
    return explanation.explain(saved, question).add_notes(notes)


@refuse_failures()
def read_log(path: AnyPath) -> Log:
    """Open a recording of any installed format; iterate over its `scans` and `poses`.

    Raises
    ------
    LogError, UsageError
        The path cannot be read, or no reader knows what it is; or it is no path.
    """
    return open_log(read_value("path", Path, path))


def read_request(
    logs: Sequence[AnyPaths], options: Mapping[str, Any], call: str, outputs: Paths | None = None
) -> tuple[Inputs, BuildOptions]:
    """Find the recordings that a caller means, and make the options of maps of them.

    Parameters
    ----------
    outputs
        Of a build; None: no single map is made.

    Raises
    ------
    UsageError
        No log is given, or an option is unknown, out of its range, or among those of one map.
    """
    chosen = read_options(BuildOptions, options, call, OF_ONE_MAP if outputs is None else ())
    others = [*(outputs or ()), *chosen.posing.files]
    return find_inputs(list_paths(logs, call), chosen.reading, others), chosen


def list_paths(paths: Sequence[AnyPaths], call: str) -> Paths:
    """Make paths of what a function was called with, one by one or as a list.

    Raises
    ------
    UsageError
        There is none, or one of them is not a path.
    """
    name = "paths" if call == "merge" else "logs"
    made: Paths = read_value(name, Paths, paths[0] if len(paths) == 1 else paths)
    require(bool(made), "no file is given", f"see help(occmap.{call})")
    return made
