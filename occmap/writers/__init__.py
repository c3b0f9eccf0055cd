"""What a writer is: one file per map format, found through entry points and chosen by suffix.

A writer is registered under its suffix without the dot and is a class with a `description`, a
`targets(path)` and one of two methods: `write(path, grid, options)`, for a map, or
`write_product(path, product, options)`, for all that there is to show: what maps are made of, and
the way of the robot. Nothing here imports PIL: a writer is loaded on use. The outputs that a user
names are found to be writable before the work starts, and written after it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from numpy.typing import NDArray

from occmap.cells import Decision, Evidence, OccupancyMap
from occmap.choices import GLOBE, option
from occmap.errors import OutputError, UsageError, require
from occmap.plugins import list_plugins, load_plugin, need_extra
from occmap.types import Journey, Paths
from occmap.writers.atomic import check_parent, check_target, follow_links
from occmap.writers.edits import Shape, apply_edits, read_edits

BAND_CELLS = 1 << 18
"""Cells that are turned into pixels at once: what is worked out for them fits a core's cache, and a
large map needs no second copy in floats."""
PAINTED_ROWS = 512
"""Rows of a map in parts that are painted at once: with fewer, parts are read more often."""


class MapMode(StrEnum):
    """How the pixels of a map image are to be read (the map_server YAML's `mode`)."""

    TRINARY = "trinary"
    """Occupied, free or unknown."""
    SCALE = "scale"
    """Grey says how occupied a cell is between the two thresholds."""
    RAW = "raw"
    """The pixel is the value of the ROS OccupancyGrid: 0 to 100, and 255 for unknown."""


class Shade(StrEnum):
    """Which end of the grey scale of a probability image is occupied."""

    DARK_OCCUPIED = "dark"
    LIGHT_OCCUPIED = "light"
    """As in Elfes' figures (1989)."""


@dataclass(frozen=True)
class WriteOptions:
    """What a user may choose about the files of a map.

    In trinary mode each cell is written as what the map decides it is, unless thresholds are given;
    the YAML's thresholds only let loaders tell the three greys apart, within 0.2 to 0.99 and 0.01
    to 0.196. In scale and raw mode loaders decide, by the thresholds as they are given: 0.65 and
    0.196 where none are, as nav2's map_saver has them.

    Raises
    ------
    UsageError
        The thresholds are not in the order 0 < free < occupied < 1, or are too near each other; or
        the file of edits cannot be read.
    """

    mode: MapMode = option(MapMode.TRINARY, "What the pixels of a PGM mean.")
    occupied_thresh: float | None = option(
        None,
        "Occupied above this probability; by default the model's cut, and 0.65 in the YAML.",
        unit="probability",
        metavar="P",
    )
    free_thresh: float | None = option(
        None,
        "Free below this probability; by default the model's cut, and 0.196 in the YAML.",
        unit="probability",
        metavar="P",
    )
    shade: Shade = option(
        Shade.DARK_OCCUPIED, "PNG: light is occupied, as in Elfes' figures.", flag="light-occupied"
    )

    edits: Path | None = option(
        None,
        "Draw the shapes in this file over the map; evidence stays as it was observed.",
        metavar="FILE",
    )
    georeference: tuple[float, float, float] | None = option(
        None,
        "Where the map's zero lies on the globe, and how far its x axis points north of east (all "
        "degrees), for a .tif and for a .png with a world file.",
        metavar="LAT,LON,YAW",
        form=GLOBE,
    )

    def __post_init__(self) -> None:
        _ = self.shapes  # refuses a file that is wrong
        latitude, longitude, _ = self.georeference or (0.0, 0.0, 0.0)
        is_there = abs(latitude) <= 90 and abs(longitude) <= 180
        found = f"no place has latitude {latitude:g} and longitude {longitude:g}"
        require(is_there, found, "write degrees: LAT,LON,YAW")
        free, occupied = self.thresholds
        found = f"`occupied_thresh` is {occupied}, `free_thresh` is {free}"
        if not 0 < free < occupied < 1:
            raise UsageError(found, fix="they must satisfy 0 < free < occupied < 1")
        # Two grey levels: else no grey may be left for a cell that is neither free nor occupied.
        if self.mode is MapMode.SCALE and occupied - free < 0.008:
            raise UsageError(found, fix="with `mode=scale` they must be at least 0.008 apart")

    @property
    def thresholds(self) -> Decision:
        """Those of the YAML."""
        return self._choose(DEFAULT_THRESHOLDS)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The user's edits; the file is read once, since it may be a pipe."""
        return read_edits(self.edits)

    def edit(self, grid: OccupancyMap) -> OccupancyMap:
        """Draw the user's shapes over a map, or a part of one."""
        return apply_edits(grid, self.shapes)

    def decide(self, decision: Decision) -> Decision:
        """How the cells of a written map are decided, where the map itself has a decision."""
        if self.mode is not MapMode.TRINARY:
            return self.thresholds
        free, occupied = self._choose(decision)
        return Decision(min(free, occupied), occupied)

    def _choose(self, default: Decision) -> Decision:
        free = default.free_below if self.free_thresh is None else self.free_thresh
        occupied = self.occupied_thresh
        return Decision(free, default.occupied_above if occupied is None else occupied)


DEFAULT_THRESHOLDS = Decision(free_below=0.196, occupied_above=0.65)


@dataclass(frozen=True)
class Product:
    """What there is to write."""

    grid: OccupancyMap
    """Maybe painted only where it is looked at, if all formats that are written are `in_parts`"""
    evidence: Callable[[], Evidence]
    """Called where a format wants it: it takes memory, and time to hash the logs"""
    journey: Journey | None = None
    """None: nobody asked for it while the map was built, or the map is of saved evidence"""
    report: Any = None
    """What there is to say of the map so far, as a `Report`; None: nothing is known"""
    inspect: Callable[[], Any] | None = None
    """Finds what `occmap check` does, as an `Inspection`; it reads the logs once more"""
    blocks: Any = None
    """The evidence as `Blocks` of `occmap.store`, where it is not in memory"""


class Writer:
    """A format. A plugin need not be a subclass: what it does not say itself is taken from here."""

    description = ""
    needs_evidence = False
    """Whether it calls `Product.evidence`, so that a build keeps when cells were seen"""
    needs_journey = False
    """Whether it writes nothing else than where the robot went"""
    shows_journey = False
    """Whether it looks at `Product.journey`"""
    in_parts = False
    """Whether it writes part by part, so that there need not be a whole map: of the map it asks
    only `box`, `shape`, `resolution`, `origin`, `decision`, `about` and `take`"""
    is_folder = False
    """Whether it writes a folder with many files"""
    needs: tuple[str, ...] = ()
    """An extra of occmap and the modules that it brings, which are loaded late; none: no extra"""

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Every file that is written, so that all can be checked before the work starts."""
        return (path,)

    def owns(self, path: Path) -> bool:  # noqa: ARG002  for a format that is a folder
        """Whether an existing folder is one that this writer made, which it may replace."""
        return False

    def check(self, path: Path, options: WriteOptions) -> None:  # noqa: ARG002  for some formats
        """Refuse before the work starts, by a UsageError, what cannot be made here, or so."""
        for module in self.needs[1:]:
            with need_extra(self.needs[0], f"a {path.suffix} needs {module}", where=path):
                import_module(module)

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> Paths | None:
        """Write a map; return the files written, or nothing where these are its `targets`.

        Raises
        ------
        OutputError
            A file cannot be written; then none is left behind.
        """
        raise NotImplementedError

    def write_product(self, path: Path, product: Product, options: WriteOptions) -> Paths | None:
        """Write whatever the format holds of all that there is; return as `write` does.

        Raises
        ------
        UsageError, OutputError
            It is to hold where the robot went, which is not known, or a file cannot be written;
            then none is left behind.
        """
        return self.write(path, product.grid, options)


def bands_from_top(grid: OccupancyMap) -> Iterator[OccupancyMap]:
    """Cut a map into bands of whole rows, highest y first; of one in memory they are views."""
    rows, cols = grid.shape
    height = max(1, BAND_CELLS // max(1, cols))
    for top in range(rows, 0, -PAINTED_ROWS):
        painted = grid.take(slice(max(0, top - PAINTED_ROWS), top), slice(0, cols))
        for stop in range(painted.shape[0], 0, -height):
            yield painted.take(slice(max(0, stop - height), stop), slice(0, cols))


def find_writer(path: Path) -> Writer:
    """Find the writer for a file name by its suffix, upper or lower case, `ground.tif` as one.

    Raises
    ------
    UsageError
        No installed writer has that suffix, or it does not load.
    """
    known = [entry.name for entry in list_plugins("occmap.writers")]
    endings = ".".join(path.name.lower().split(".")[-2:]), path.suffix.lower()[1:]
    name = next((each for each in endings if each in known), endings[1])
    listing = "occmap writes " + ", ".join(f".{each}" for each in known)
    if name not in known:
        found = f"unknown suffix {path.suffix!r}" if name else "the file name has no suffix"
        raise UsageError(found, where=path, fix=listing)
    if (kind := load_plugin("occmap.writers", name)) is None:
        raise UsageError(f"the writer for .{name} does not load", where=path, fix=listing)
    if not issubclass(kind, Writer):
        # What shows more than a map may show the way of the robot.
        shows = {"shows_journey": hasattr(kind, "write_product")}
        kind = type(kind.__name__, (kind, Writer), shows)
    return cast(Writer, kind())


def check_outputs(outputs: Paths, inputs: Paths, options: WriteOptions) -> None:
    """Find out before the work starts what could not be written after it.

    Raises
    ------
    UsageError, OutputError
        A suffix that no writer has, two outputs that are one file, a file that cannot be made, one
        that is an input or the file of edits, or one that `options` cannot make.
    """
    writers = [(path, find_writer(path)) for path in outputs]
    inputs = [*inputs, *([options.edits] if options.edits else [])]
    for path, writer in writers:
        writer.check(path, options)
    targets = [(file, its) for path, its in writers for file in to_paths(its.targets(path))]
    files = [follow_links(target) for target, _ in targets]
    for (target, writer), file in zip(targets, files, strict=True):
        if not writer.is_folder:
            check_target(target)
        elif file.exists() and not (file.is_dir() and writer.owns(file)):
            found = "is there already, and not as occmap writes it"
            raise OutputError(found, where=target, fix="give another name")
        else:
            check_parent(target, file.parent)
        refuse_input(target, inputs)
        if files.count(file) > 1:
            found = "would be written twice"
            raise UsageError(found, where=target, fix="give each output its own name")


def check_picture(
    path: Path | None, inputs: Paths, suffixes: Sequence[str] = (".png", ".html")
) -> None:
    """Find out before the work starts whether a picture, if there is one, cannot be written.

    Raises
    ------
    UsageError, OutputError
        It is to be something else, cannot be made, or is an input.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        names, kind = " or ".join(suffixes), "picture" if ".png" in suffixes else "page"
        raise UsageError(f"is not a {kind}", where=path, fix=f"give it a name that ends in {names}")
    check_outputs([path], inputs, WriteOptions())


def refuse_input(target: Path, inputs: Paths) -> None:
    """Refuse to write over what the same command reads.

    Raises
    ------
    UsageError
        The target is an input, under whatever name.
    """
    for path in inputs:
        if path.exists() and target.exists() and target.samefile(path):
            found = "is an input: it would be overwritten"
            raise UsageError(found, where=target, fix="give another name")


def to_paths(files: Iterable[Path | str] | str) -> list[Path]:
    """Take the files that a writer names; a plugin may give text, and one file alone."""
    return [Path(files)] if isinstance(files, str | Path) else [*map(Path, files)]


def want_evidence(outputs: Paths) -> bool:
    """Whether any output is of what was observed, or shows when it was."""
    return any(find_writer(path).needs_evidence for path in outputs)


def want_whole(outputs: Paths) -> bool:
    """Whether any output is made of a map that is there as a whole; without any, a program is."""
    return not outputs or not all(find_writer(path).in_parts for path in outputs)


def want_journey(outputs: Paths) -> bool:
    """Whether any output shows where the robot went."""
    return any(find_writer(path).shows_journey for path in outputs)


USUAL = WriteOptions()
USED_BY = {"mode": (".pgm", ".png", ".mcap"), "shade": (".png",), "georeference": (".tif", ".png")}
"""Options that are for some formats alone"""


def list_idle(outputs: Paths, options: WriteOptions) -> Iterator[str]:
    """Say which options do nothing, since no output is of the format that they are for."""
    suffixes = {path.suffix.lower() for path in outputs}
    for name, formats in USED_BY.items():
        is_usual = getattr(options, name) == getattr(USUAL, name)
        if outputs and not is_usual and suffixes.isdisjoint(formats):  # else it is saved later
            yield f"`{name}` does nothing: it is for {', '.join(formats)}, and no output ends so"


def protect(array: NDArray[Any]) -> NDArray[Any]:
    """A view of an array that nobody can write to."""
    view = array.view()
    view.flags.writeable = False
    return view


def write_outputs(outputs: Paths, product: Product, options: WriteOptions) -> list[str]:
    """Write a map, or its evidence, in the formats of these suffixes; return the files written.

    Raises
    ------
    OutputError
        A file cannot be written, and is not left behind; or a plugin did not write it.
    """
    written: list[Path] = []
    grid = product.grid
    if isinstance(grid, OccupancyMap):  # a plugin must not change what comes after it
        log_odds, observed = protect(grid.log_odds), protect(grid.observed)
        product = replace(product, grid=replace(grid, log_odds=log_odds, observed=observed))
    for path in outputs:
        writer = find_writer(path)
        files = writer.write_product(path, product, options) or writer.targets(path)
        written += to_paths(files)
    for path in (each for each in written if not each.exists()):
        raise OutputError("its writer did not write it", where=path, fix="choose another format")
    return list(map(str, written))
