"""What a user may choose about a build, checked as a whole."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from occmap.errors import require
from occmap.evidence.persistence import check_passes
from occmap.grid.framing import Framing
from occmap.grid.lattice import Lattice
from occmap.grid.tiles import MAX_CELLS
from occmap.posing.options import PosingOptions
from occmap.readers.options import ReaderOptions
from occmap.selection import Selection
from occmap.sensor.models import CountingModel, SensorModel
from occmap.sensor.returns import ReturnOptions
from occmap.types import Metres, Seconds, Update
from occmap.workers import count_cores
from occmap.writers import WriteOptions

MOST_OFFSET = 10
"""The largest `hit_offset`: no hit lies deeper in a wall (cells)"""
MOST_GAP = 1000
"""The largest `border_gap` (cells)"""
SHORTEST_GAP_S, LONGEST_GAP_S = 1e-3, 1e9
"""The least and the largest `pass_gap_s`, by which slices of time are cut"""
DEFAULT_UPDATE = Update.SURFACE


def choose_model(update: Update) -> SensorModel:
    """Choose the model of an update where nobody names one, as measured on real logs.

    A scan counts once in the polygon update, and its joined borders thicken walls by themselves.
    """
    return CountingModel(cut=0.4, spread=0.0) if update is Update.POLYGON else CountingModel()


@dataclass(frozen=True)
class BuildOptions:
    """What a user may choose about a map, grouped by the stage that it concerns.

    The text below a field is its help on the command line, where a second part of its type, as in
    `Metres`, stands for the value.
    """

    resolution: Metres = 0.05
    """Side of a cell."""
    update: Update = DEFAULT_UPDATE
    model: SensorModel = None  # type: ignore[assignment]  # the update chooses it, below
    reading: ReaderOptions = field(default_factory=ReaderOptions)
    returns: ReturnOptions = field(default_factory=ReturnOptions)
    posing: PosingOptions = field(default_factory=PosingOptions)
    selection: Selection = field(default_factory=Selection)
    framing: Framing = field(default_factory=Framing)
    writing: WriteOptions = field(default_factory=WriteOptions)
    jump: Metres = 0.1
    """Two neighbouring beams meet one surface if their ranges differ by at most this."""
    border_gap: Annotated[int, "CELLS"] = 8
    """polygon: join end cells on one surface up to this far apart."""
    hit_offset: Annotated[float, "CELLS"] = 0.5
    """Move each hit this far behind the measured point, which is on a surface."""
    max_cells: Annotated[int, "N"] = MAX_CELLS
    """Refuse to make a larger map."""
    min_passes: Annotated[int, "K"] | None = None
    """Keep the hits of a cell only if they came on at least this many visits: drops people who
    passed once."""
    pass_gap_s: Seconds = 10.0
    """Sightings of a cell at least this far apart are two visits."""
    jobs: Annotated[int, "N"] = field(default_factory=count_cores)
    """Threads."""
    resume: Annotated[Path, "NPZ"] | None = None
    """Add to the evidence in this file, which `outputs` may name again."""
    resume_if_there: Annotated[Path, "NPZ"] | None = None
    """As `resume` if the file exists; otherwise start a new map."""

    def __post_init__(self) -> None:
        if self.model is None:
            object.__setattr__(self, "model", choose_model(self.update))
        Lattice(self.resolution)  # refuses one that is not possible
        check_passes(self.min_passes, self.model)
        found = f"`pass_gap_s={self.pass_gap_s:g}` is not possible"
        fix = f"give {SHORTEST_GAP_S:g} to {LONGEST_GAP_S:g} seconds"
        require(SHORTEST_GAP_S <= self.pass_gap_s <= LONGEST_GAP_S, found, fix)
        both = bool(self.resume and self.resume_if_there)
        require(not both, "`resume` and `resume_if_there` are both given", "leave one out")
        require(self.jobs >= 1, f"{self.jobs} jobs are not possible", "give `jobs=1` or more")
        require(self.jump >= 0, f"a jump of {self.jump} m is not possible", "try `jump=0.1`")
        found = f"a hit offset of {self.hit_offset} cells is not possible"
        require(0 <= self.hit_offset <= MOST_OFFSET, found, f"give 0 to {MOST_OFFSET}")
        found = f"a border gap of {self.border_gap} cells is not possible"
        require(0 <= self.border_gap <= MOST_GAP, found, f"give 0 to {MOST_GAP}")

    def list_idle(self) -> Iterator[str]:
        """Name the options that do nothing under the update."""
        if self.update is Update.BEAM and self.jump != BuildOptions.jump:
            yield "`jump` does nothing under `occmap build beam`"
        if self.update is not Update.POLYGON and self.border_gap != BuildOptions.border_gap:
            yield "`border_gap` does nothing: it is for `occmap build polygon`"
