"""What a user may choose about a build, checked as a whole."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from occmap.batching import Selection
from occmap.errors import require
from occmap.evidence.persistence import check_gap, check_passes
from occmap.grid.framing import Framing
from occmap.grid.tiles import MAX_CELLS
from occmap.posing.options import PosingOptions
from occmap.readers.options import ReaderOptions
from occmap.sensor.models import CountingModel, SensorModel
from occmap.sensor.returns import ReturnOptions
from occmap.types import Update
from occmap.workers import count_cores
from occmap.writers import WriteOptions

MOST_OFFSET = 10
"""The largest `hit_offset`: no hit lies deeper in a wall (cells)"""
MOST_GAP = 1000
"""The largest `border_gap` (cells)"""
DEFAULT_UPDATE = Update.SURFACE


def choose_model(update: Update) -> SensorModel:
    """Choose the model of an update where nobody names one, as measured on real logs.

    A scan counts once in the polygon update, and its joined borders thicken walls by themselves.
    """
    return CountingModel(cut=0.4, spread=0.0) if update is Update.POLYGON else CountingModel()


@dataclass(frozen=True)
class BuildOptions:
    """What a user may choose about a map, grouped by the stage that it concerns."""

    resolution: float = 0.05
    """Side of a cell (m)"""
    update: Update = DEFAULT_UPDATE
    model: SensorModel = field(default_factory=CountingModel)
    reading: ReaderOptions = field(default_factory=ReaderOptions)
    returns: ReturnOptions = field(default_factory=ReturnOptions)
    posing: PosingOptions = field(default_factory=PosingOptions)
    selection: Selection = field(default_factory=Selection)
    framing: Framing = field(default_factory=Framing)
    writing: WriteOptions = field(default_factory=WriteOptions)
    jump: float = 0.1
    """Neighbouring beams see one surface where ranges differ by at most this (m; not beam)"""
    border_gap: int = 8
    """A surface is closed between end cells at most this far apart (cells; polygon)"""
    hit_offset: float = 0.5
    """How far a hit lies behind the measured point, which is on a surface (cells)"""
    max_cells: int = MAX_CELLS
    """A map with more cells is refused"""
    min_passes: int | None = None
    """A cell keeps its hits only if they came on so many visits; None: it keeps all"""
    pass_gap_s: float = 10.0
    """Two visits of a cell lie at least this far apart (s)"""
    jobs: int = field(default_factory=count_cores)
    """Threads"""
    resume: Path | None = None
    """An evidence file: its observations are added to those of the logs"""
    resume_if_there: Path | None = None
    """As `resume` where this file exists; where it does not, the build starts anew"""

    def __post_init__(self) -> None:
        check_passes(self.min_passes, self.model)
        check_gap(self.pass_gap_s)
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
