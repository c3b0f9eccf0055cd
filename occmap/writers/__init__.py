"""What a writer is: one file per map format, found through entry points and chosen by suffix.

A writer is registered under its suffix without the dot and is a class with a `description`, a
`targets(path)` and one of three methods: `write(path, grid, options)`, for a map;
`write_evidence(path, evidence)`, for what maps are made of; or `write_product(path, product,
options)`, for all that there is to show, the way of the robot among it. Nothing here imports PIL: a
writer is loaded on use.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

from occmap.cells import Decision, Evidence, OccupancyMap
from occmap.choices import option
from occmap.errors import UsageError
from occmap.types import Int64, Journey

BAND_CELLS = 1 << 18
"""Cells that are turned into pixels at once: what is worked out for them fits a core's cache, and a
large map needs no second copy in floats."""


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
        The thresholds are not in the order 0 < free < occupied < 1, or are too near each other.
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
        Shade.DARK_OCCUPIED,
        "PNG: light is occupied, as in Elfes' figures.",
        flag="light-occupied",
    )

    def __post_init__(self) -> None:
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
        free = DEFAULT_THRESHOLDS.free_below if self.free_thresh is None else self.free_thresh
        occupied = self.occupied_thresh
        return Decision(free, DEFAULT_THRESHOLDS.occupied_above if occupied is None else occupied)

    def decide(self, decision: Decision) -> Decision:
        """How the cells of a written map are decided, where the map itself has a decision."""
        if self.mode is not MapMode.TRINARY:
            return self.thresholds
        occupied, free = self.occupied_thresh, self.free_thresh
        above = decision.occupied_above if occupied is None else occupied
        return Decision(min(decision.free_below if free is None else free, above), above)


DEFAULT_THRESHOLDS = Decision(free_below=0.196, occupied_above=0.65)


class OneFile:
    """What most formats have in common: all that they write is one file."""

    needs_evidence = needs_journey = False

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the file."""
        return (path,)


class Format(Protocol):
    """What all writers have."""

    description: str

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Every file that is written, so that all can be checked before the work starts."""


class Writer(Format, Protocol):
    """A map format."""

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> tuple[Path, ...]:
        """Write a map; return the files written.

        Raises
        ------
        OutputError
            A file cannot be written; then none is left behind.
        """


@runtime_checkable
class EvidenceWriter(Format, Protocol):
    """A format for what was observed."""

    def write_evidence(self, path: Path, evidence: Evidence) -> tuple[Path, ...]:
        """Write evidence; return the files written.

        Raises
        ------
        OutputError
            A file cannot be written; then none is left behind.
        """


@dataclass(frozen=True)
class Product:
    """What there is to write."""

    grid: OccupancyMap
    evidence: Callable[[], Evidence]
    """Called where a format wants it: it takes memory, and time to hash the logs"""
    journey: Journey | None = None
    """None: nobody asked for it while the map was built, or the map is of saved evidence"""
    report: Any = None
    """What there is to say of the map so far, as a `Report`; None: nothing is known"""
    inspect: Callable[[], Any] | None = None
    """Finds what `occmap check` does, as an `Inspection`; it reads the logs once more"""


@runtime_checkable
class ProductWriter(Format, Protocol):
    """A format for more than a map."""

    needs_evidence: bool
    """Whether it calls `Product.evidence`, so that a build keeps when cells were seen"""
    needs_journey: bool
    """Whether it writes nothing else than where the robot went"""

    def write_product(
        self, path: Path, product: Product, options: WriteOptions
    ) -> tuple[Path, ...]:
        """Write what the format holds; return the files written.

        Raises
        ------
        UsageError, OutputError
            It is to hold where the robot went, which is not known, or a file cannot be written;
            then none is left behind.
        """


AnyWriter: TypeAlias = Writer | EvidenceWriter | ProductWriter


@runtime_checkable
class FolderWriter(Protocol):
    """A format of which the path is a folder with many files."""

    def owns(self, path: Path) -> bool:
        """Whether an existing folder is one that this writer made, which it may replace."""


class Windows(Protocol):
    """A map that is looked at part by part."""

    @property
    def place(self) -> Int64:
        """(2,) row and column of its first cell."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    @property
    def resolution(self) -> float:
        """Side of a cell (m)."""

    @property
    def decision(self) -> Decision:
        """How its cells are decided."""

    def take(self, rows: slice, cols: slice) -> OccupancyMap:
        """A part of it."""


@runtime_checkable
class WindowWriter(Protocol):
    """A format that is written part by part, so that there need not be a whole map."""

    in_windows: bool
    """True; it tells such a format from others"""

    def write(self, path: Path, grid: Windows, options: WriteOptions) -> tuple[Path, ...]:
        """As `Writer.write`."""


def bands_from_top(grid: OccupancyMap) -> Iterator[OccupancyMap]:
    """Cut a map into bands of whole rows, highest y first; each is a view, not a copy."""
    rows, cols = grid.shape
    height = max(1, BAND_CELLS // max(1, cols))
    for stop in range(rows, 0, -height):
        yield grid.take(slice(max(0, stop - height), stop), slice(None))
