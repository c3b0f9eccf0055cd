"""What a user may choose about a build, checked as a whole, and the line that types it."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from occmap.choices import check_bounds, list_options, list_values, option
from occmap.clouds import CloudOptions
from occmap.errors import require
from occmap.evidence import check_passes
from occmap.grid import Lattice
from occmap.grid.rendering import Framing
from occmap.grid.tiles import MAX_CELLS
from occmap.posing import PosingOptions
from occmap.readers import ReaderOptions
from occmap.sensor import ReturnOptions
from occmap.sensor.models import MODEL, PARAMETERS, CountingModel, SensorModel
from occmap.threads import count_cores
from occmap.types import Update
from occmap.writers import WriteOptions

DEFAULT_UPDATE = Update.SURFACE
FILES, RUN = "Files", "Run"
SCANS, POSES = "Which scans", "Where the scans were taken"
"""Headings of --help"""


def choose_model(update: Update) -> CountingModel:
    """Choose the model of an update where nobody names one, as measured on real logs.

    A scan counts once in the polygon update, and its joined borders thicken walls by themselves.
    """
    if update is Update.CLOUD:
        return CountingModel(cut=0.05, spread=0.0, ceiling=1.0, doubt=0.0, repeat_from=8.0)
    return CountingModel(cut=0.4, spread=0.0) if update is Update.POLYGON else CountingModel()


@dataclass(frozen=True)
class Selection:
    """Which scans of a log to use: a part begins with its start and ends before its end.

    Raises
    ------
    UsageError
        The values leave no scan to use.
    """

    topics: tuple[str, ...] = option(
        (), "Use the scans of this topic; by default of all.", metavar="TOPIC", flag="scan-topic"
    )
    start_s: float = option(-math.inf, "Use scans from this time after the first on.", unit="s")
    end_s: float = option(math.inf, "Use scans before this time after the first.", unit="s")
    stride: int = option(
        1, "Use every N-th scan of a topic.", unit="scans", metavar="N", bounds=(1, math.inf)
    )

    def __post_init__(self) -> None:
        check_bounds(self)
        found = f"`start_s={self.start_s}` is not before `end_s={self.end_s}`"
        fix = "both are in seconds after the log's first scan"
        require(self.start_s < self.end_s, found, fix)


@dataclass(frozen=True)
class BuildOptions:
    """What a user may choose about a map, grouped by the stage that it concerns."""

    resolution: float = option(0.05, "Side of a cell.", unit="m")
    update: Update = option(DEFAULT_UPDATE, "How a scan becomes observations of cells.")
    # None: the update chooses it, below.
    model: SensorModel = option(
        None,
        "How evidence is weighed: see `occmap models`.",
        metavar="NAME[:KEY=NUMBER,...]",
        section="Sensor model",
        form=MODEL,
    )
    reading: ReaderOptions = option(ReaderOptions, section=SCANS)
    returns: ReturnOptions = option(ReturnOptions, section="What a range means")
    posing: PosingOptions = option(PosingOptions, section=POSES)
    selection: Selection = option(Selection, section=SCANS)
    framing: Framing = option(Framing)
    writing: WriteOptions = option(WriteOptions, section=FILES)
    clouds: CloudOptions = option(CloudOptions, section=SCANS)
    jump: float = option(
        0.1,
        "Two neighbouring beams meet one surface if their ranges differ by at most this.",
        unit="m",
        bounds=(0, math.inf),
    )
    border_gap: int = option(
        8,
        "polygon: join end cells on one surface up to this far apart.",
        unit="cells",
        bounds=(0, 1000),
    )
    hit_offset: float = option(
        0.5,
        "Move each hit this far behind the measured point, which is on a surface.",
        unit="cells",
        bounds=(0, 10),  # no hit lies deeper in a wall
    )
    max_cells: int = option(
        MAX_CELLS, "Refuse to make a larger map.", unit="cells", metavar="N", bounds=(1, math.inf)
    )
    min_passes: int | None = option(
        None,
        "Keep the hits of a cell only if they came on at least this many visits: drops people who "
        "passed once. Where these are half of its visits or more, its misses are forgotten.",
        unit="visits",
        metavar="K",
    )
    pass_gap_s: float = option(
        10.0,
        "Sightings of a cell at least this far apart are two visits.",
        unit="s",
        bounds=(1e-3, 1e9),  # slices of time are cut by it
    )
    jobs: int = option(
        count_cores, "Threads.", unit="threads", metavar="N", section=RUN, bounds=(1, math.inf)
    )
    resume: Path | None = option(
        None,
        "Add to the evidence in this file, which `outputs` may name again.",
        unit="path",
        metavar="NPZ",
        section=FILES,
    )
    resume_if_there: Path | None = option(
        None,
        "As `resume` if the file exists; otherwise start a new map.",
        unit="path",
        metavar="NPZ",
        section=FILES,
    )

    fit: bool = option(
        False,
        "With evidence to add to: first move the logs by the shift of up to 2 m and the turn of up "
        "to 20 degrees by which their walls lie on its walls, where one is clearly the best.",
        section=FILES,
    )

    def __post_init__(self) -> None:
        if self.model is None:
            object.__setattr__(self, "model", choose_model(self.update))
        check_bounds(self)
        Lattice(self.resolution)  # refuses one that is not possible
        check_passes(self.min_passes, self.model)
        both = bool(self.resume and self.resume_if_there)
        require(not both, "`resume` and `resume_if_there` are both given", "leave one out")

    def list_changed(self) -> dict[str, Any]:
        """List the values of the options that are not at their defaults, by name."""
        values = list_values(self)
        return {name: values[name] for name in values if values[name] != OPTIONS[name].default}

    def list_idle(self) -> Iterator[str]:
        """Name the options that do nothing under the update."""
        changed = self.list_changed()
        for name in (name for name in IDLE[self.update] if name in changed):
            yield f"`{name}` does nothing with the {self.update} update"
        if self.fit and not (self.resume or self.resume_if_there):
            yield "`fit` does nothing: it is for `resume`"


OPTIONS = list_options(BuildOptions, "Map")
"""All of them by name"""
CLOUDS_ALONE = tuple(list_options(CloudOptions))
IDLE = {
    Update.POLYGON: CLOUDS_ALONE,
    Update.SURFACE: ("border_gap", *CLOUDS_ALONE),
    Update.BEAM: ("jump", "border_gap", *CLOUDS_ALONE),
    Update.CLOUD: ("border_gap", "jump", "hit_offset", "no_return", "deskew"),
}
"""Options that do nothing with an update"""

COMMAND_FLAGS = (
    *("dask", "output", "overview", "scratch", "since"),
    *("skip_unreadable", "strict", "truth", "until"),
)
OTHER_FLAGS = {
    **{name: "--" + name.replace("_", "-") for name in (*PARAMETERS, *COMMAND_FLAGS)},
    "limits": "--fail-if",
    "logs": "--log",
    "outputs": "-o",
    "within_m": "--within",
}
"""How what is no option of a build is typed, where texts name it"""
FLAGS = {name: option.flag for name, option in OPTIONS.items()} | OTHER_FLAGS
"""How all of them are typed: `max_pose_gap_s` as --max-pose-gap"""

MARK = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")
"""An option in a text, as libraries write it: `max_range`, `max_range=6`, `transform=(1,2,0)`"""

OF_ONE_MAP = {
    *("update", "model", "min_passes", "pass_gap_s", "resume", "resume_if_there", "fit", "align"),
    *(*list_options(Framing), *list_options(WriteOptions)),
}
"""Options of a single map, which do not change how logs are read"""
OF_A_SCORED_MAP = {
    *OF_ONE_MAP - {"occupied_thresh", "free_thresh"},
    *("resolution", "max_cells", "jump", "border_gap", "hit_offset"),
}
"""Those that do not concern what is read of logs and of a written map"""


def spell_flags(text: str) -> str:
    """Spell the options that a text names, as in `max_range=6`, as they are typed."""

    def spell(mark: re.Match[str]) -> str:
        name, value = mark.groups()
        if name not in FLAGS:
            return mark[0]
        if value is not None and value.startswith("("):  # a tuple, as Python has it
            value = value.strip("()")
        return FLAGS[name] if value is None else f"{FLAGS[name]} {value}"

    return MARK.sub(spell, text)


def compose_build(
    logs: Sequence[str], options: BuildOptions, changes: Iterable[tuple[str, str]], update: str = ""
) -> tuple[str, ...]:
    """Compose the words of an `occmap build`.

    Parameters
    ----------
    options
        Those that differ from their defaults are written; not so update, model and outputs.
    changes
        Values of options by name, which go before those of `options`; "" leaves an option out.
    """
    given = {
        name: OPTIONS[name].write(value)
        for name, value in options.list_changed().items()
        if name not in {*OF_ONE_MAP, "jobs"}
    }
    for name, text in changes:
        kept = []
        if frame := find_child(name, text):  # the transforms to other frames stay beside a new one
            kept = [each for each in given.get(name, []) if find_child(name, each) != frame]
        given[name] = [*kept, text] if text else []
    words = [w for name, texts in given.items() for text in texts for w in (FLAGS[name], text)]
    start = ("occmap", "build", update) if update else ("occmap", "build")
    # What begins with a dash would be taken for an option.
    *files, image = (
        f"./{path}" if path.startswith("-") else path
        for path in (*logs, f"{name_map(logs[0])}.pgm")
    )
    return (*start, *files, *words, "-o", image)


def find_child(name: str, text: str) -> str:
    """Find the frame that an option with a value says where it is; "" of other options."""
    return text.split(",")[1] if name == "static_transforms" else ""


def name_map(path: str) -> str:
    """Name a map after its log: the base name without what it is packed and written in."""
    stem = Path(re.sub(r"(?i)\.gz$", "", Path(path).resolve().name)).stem
    return "stdin" if stem == "-" else stem or "map"
