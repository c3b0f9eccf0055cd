"""Saved evidence painted as a map and written, and what the report says of it.

A map is painted block by block: memory is that of the map and of a few blocks.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, reduce
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np

from occmap import evidence, writers
from occmap.cells import About, Box, CellBox, CellClass, Decision, Manifest, OccupancyMap
from occmap.choices import TIME, check_bounds, option
from occmap.errors import MapError, UsageError
from occmap.evidence.manifest import BuildRecord, describe_about, list_doubts
from occmap.grid import Lattice
from occmap.grid.rendering import NOTHING_LEFT, Framing, choose_box, count_agreeing, measure_bounds
from occmap.grid.tiles import MAX_CELLS, TILE, TileGrid, refuse_large
from occmap.report import results
from occmap.report.results import MapFacts, Report, count_cells
from occmap.scans.tally import ScanCounts
from occmap.sensor import ReturnCounts
from occmap.sensor.models import MODEL, SensorModel, describe_model, find_decision, parse_model
from occmap.store import SIDE, Block, Blocks, identify, list_blocks, read_all, read_part
from occmap.types import Int64, Paths, UInt8
from occmap.writers import Product, WriteOptions
from occmap.writers.npz import refuse_damage

KEPT_BLOCKS = 18
"""How many blocks are kept that were read last, up to 8 MiB each"""
LARGE_TILES = 1 << 13
"""A map that spans more tiles, most of them maybe empty, is painted in parts"""
FULL = 0.25
"""Evidence in memory that fills more of a map than this is held to the limit of its cells; two
sites far apart have few cells, and many between them"""
STRIPE = 3
"""Blocks are painted in stripes so many rows high, so that few of them are read twice"""

CLASS_LOG_ODDS = np.log([1, 1 / 99, 99]).astype(np.float32)
"""Of a pixel of each CellClass, of which nothing else is known: 0.5, 0.01 and 0.99"""


@dataclass(frozen=True)
class RenderOptions:
    """What a user may choose about a map of saved evidence."""

    model: SensorModel | None = option(None, form=MODEL)
    """None: the one that the evidence was built with"""
    writing: WriteOptions = field(default_factory=WriteOptions)
    max_cells: int = option(MAX_CELLS, bounds=(1, math.inf))
    """A map with more cells is refused"""
    framing: Framing = field(default_factory=Framing)
    min_passes: int | None = None
    """A cell keeps its hits only if they came on so many visits; None: it keeps all"""
    since: float | None = option(
        None,
        "Show only what was still seen at this time or later: seconds as in the log's stamps, or a "
        "date such as 2026-11-02T08:00, in UTC. Slices of time (`pass_gap_s`) are not cut. An .npz "
        "holds everything in any case.",
        metavar="TIME",
        form=TIME,
    )
    until: float | None = option(
        None, "Show only what was seen at this time or before.", metavar="TIME", form=TIME
    )
    overview: int | None = option(
        None,
        "Make each pixel N x N cells, quickly, from the pictures in a .zarr: 4, 16, 64 ...",
        metavar="N",
        bounds=(1, math.inf),
    )

    def __post_init__(self) -> None:
        check_bounds(self)


Piece: TypeAlias = tuple[tuple[slice, slice], OccupancyMap, Int64]
"""A piece of a map as it is painted: its rows and columns in the map, what it shows, and (4,) its
hits in occupied cells and all of them, also those that do not last; its cells that would be
occupied if all hits lasted, and those of them that are"""
Read: TypeAlias = Callable[[CellBox], tuple[TileGrid, TileGrid]]
"""Gives what was observed in a box of cells, and maybe beside it, when the user wants to know, and
what of that lasts; raises MapError where a block cannot be read"""


@dataclass(frozen=True, eq=False)
class BlockMap:
    """A map that is painted piece by piece, anew whenever it is asked for."""

    source: Blocks
    read: Read
    model: SensorModel
    options: RenderOptions
    box: CellBox
    """Its cells"""
    resolution: float
    """Side of a cell (m)"""
    decision: Decision
    """How its cells are decided"""
    logs: Sequence[str] = ()
    """Names of those that the manifest does not have"""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.box.shape

    @property
    def extent(self) -> Box:
        """Lowest x and y, highest x and y (m)."""
        return Lattice(self.resolution).measure(self.box)

    @cached_property
    def about(self) -> About:
        """What it is of; a sum of stores is read once more for that."""
        return describe_about(self.source.manifest, identify(self.source), self.options, self.logs)

    @property
    def origin(self) -> tuple[float, float]:
        """As of `OccupancyMap`."""
        return self.extent[:2]

    def take(self, rows: slice, cols: slice) -> OccupancyMap:
        """Paint a part of it."""
        part = CellBox(rows.start, cols.start, rows.stop, cols.stop)
        made, _ = self.paint(part.move(*self.box[:2]))
        return made

    def paint(self, box: CellBox) -> tuple[OccupancyMap, Int64]:
        """Paint all of it, or a part; return (4,) what all pieces found, too."""
        nothing, found = evidence.make_empty(self.source.manifest), np.zeros(4, np.int64)
        made = evidence.paint_box(nothing, self.model, box)
        for window, piece, of_piece in self.list_pieces(box):
            made.log_odds[window], made.observed[window] = piece.log_odds, piece.observed
            found += of_piece
        return made, found

    def paint_all(self) -> tuple[OccupancyMap, list[str]]:
        """Paint the whole, and say what does not last; raises MapError where it is too large."""
        refuse_large(self.box, Lattice(self.resolution), self.options.max_cells)
        made, found = self.paint(self.box)
        agreement, lost = sum_up(found)
        return replace(made, agreement=agreement, about=self.about), lost

    def list_pieces(self, box: CellBox) -> Iterator[Piece]:
        """Paint all of it, or a part, piece by piece; the rest of that was not observed.

        Raises
        ------
        MapError
            A block cannot be read.
        """
        # Cells that were forgotten count as lost, also where nothing is left around them.
        counts_forgotten = self.is_whole(box) and self.options.min_passes is not None
        for part in self.list_parts(box):
            shown = box.clip(part)
            around = part if counts_forgotten else shown
            if around.cells:
                seen, lasting = self.read(around)
                made = evidence.paint_box(lasting, self.model, shown)
                occupied = np.zeros(around.shape, np.bool_)
                occupied[shown.within(around)] = made.occupied
                found = np.array([*count_agreeing(seen, occupied, around), 0, 0])
                if lasting is not seen:
                    before = evidence.paint_box(seen, self.model, around).occupied
                    found[2:] = np.count_nonzero(before), np.count_nonzero(before & occupied)
                yield shown.within(box), self.options.writing.edit(made), found

    def is_whole(self, box: CellBox) -> bool:
        """Whether a box is the whole map, which no extent cuts."""
        return box == self.box and self.options.framing.extent is None

    def list_parts(self, box: CellBox) -> list[CellBox]:
        """List the blocks in which a box may show something, in the order to paint them in."""
        observed: Iterable[Block] = self.source.blocks
        if not self.is_whole(box):  # maybe a tile of a large map, and most blocks lie far from it
            observed = self.source.blocks.keys() & set(list_blocks(box.grow(1)))
        # Hits speak for the cells beside them, and edits may lie where nothing was observed.
        seen = {each for block in observed for each in list_blocks(block.box.grow(1))}
        for shape in self.options.writing.shapes:
            corners = np.array(shape.measure(self.resolution))
            seen |= set(list_blocks(Lattice(self.resolution).enclose(corners).clip(box)))
        order = sorted(seen, key=lambda each: (each.row // STRIPE, each.col, each.row))
        return [block.box for block in order]


def open_map(source: Blocks, model: SensorModel, options: RenderOptions | None = None) -> BlockMap:
    """Find out what cells a map covers; what is in memory, or was read last, is kept from now on.

    Raises
    ------
    MapError
        Nothing was observed, or lasts, or lies in the extent; or a block cannot be read.
    """
    chosen, lattice = options or RenderOptions(), Lattice(source.manifest.resolution)
    kept = replace(source, read_block=lru_cache(KEPT_BLOCKS)(source.read_block))
    when = chosen.min_passes, chosen.since, chosen.until
    at_once = source.whole and evidence.find_lasting(source.whole, *when)

    def read(box: CellBox) -> tuple[TileGrid, TileGrid]:
        return at_once or evidence.find_lasting(read_part(kept, box), *when)

    box = choose_box(bound_map(kept, read, model, chosen), chosen.framing, lattice)
    return BlockMap(kept, read, model, chosen, box, lattice.resolution, find_decision(model))


def bound_map(source: Blocks, read: Read, model: SensorModel, options: RenderOptions) -> CellBox:
    """The smallest box around all cells of a map; only blocks that may reach its edges are read.

    Raises
    ------
    MapError
        Nothing was observed, or lasts.
    """
    reach = {block.box: farthest for block, farthest in source.blocks.items()}

    @cache
    def measure(part: CellBox) -> CellBox | None:
        _, lasting = read(part)
        return measure_bounds(evidence.choose_tiles(lasting, model))

    edges = []
    for side, outward in enumerate((-1, -1, 1, 1)):  # of a box: row, col, row_end, col_end
        farthest = -math.inf
        for part in sorted(reach, key=lambda each: outward * reach[each][side], reverse=True):
            # A hit speaks for the cell beside it, so a part may reach one cell farther.
            if outward * reach[part][side] + 1 <= farthest:
                break
            if box := measure(part):
                farthest = max(farthest, outward * box[side])
        if math.isinf(farthest):
            refuse_nothing_left(source, options)
        edges.append(int(outward * farthest))
    return CellBox(*edges)


def refuse_nothing_left(source: Blocks, options: RenderOptions) -> NoReturn:
    """Say why no cell is left of a map; raises MapError."""
    if source.blocks and (options.since, options.until) != (None, None):
        found = "nothing was observed, or lasts, of the time that is asked for"
        raise MapError(found, fix="`occmap explain` says when a cell was seen")
    if source.blocks and options.min_passes is not None:
        visits = f"no cell was hit on {options.min_passes} visits, and none was seen free"
        raise MapError(f"{visits}: there is no map", fix="give a smaller `min_passes`")
    raise MapError(NOTHING_LEFT)


def is_large(saved: Blocks) -> bool:
    """Whether the map of all evidence would be large."""
    keys, side = (saved.whole.tiles, 1) if saved.whole else (saved.blocks, SIDE)
    return bool(keys) and CellBox.enclose(keys).cells * side**2 > LARGE_TILES


MUCH = 0.25
"""A note is given if this share of the occupied cells is lost: people are seldom so many."""


def sum_up(found: Int64) -> tuple[float | None, list[str]]:
    """Say how well a map agrees, and if much does not last, by (4,) what its parts found."""
    agreeing, hits, were, still = found.tolist()
    notes, lost = [], were - still
    if lost and lost >= MUCH * were:
        notes.append(
            f"`min_passes` takes away {100 * lost / were:.0f}% of the occupied cells ({lost:,} of "
            f"{were:,}), since they were hit on fewer visits; walls may be among them: leave it "
            "out, or build with a smaller `pass_gap_s`"
        )
    return agreeing / hits if hits else None, notes


def survey_blocks(made: BlockMap) -> MapFacts:
    """Measure a map that is never there as a whole.

    Raises
    ------
    MapError
        A block cannot be read.
    """
    cells, found = np.zeros(4, np.int64), np.zeros(4, np.int64)
    for _, piece, of_piece in made.list_pieces(made.box):
        cells += count_cells(piece, made.options.writing)
        found += of_piece
    return MapFacts(made.resolution, made.extent, made.shape, cells, *sum_up(found))


def refuse_unsaved(outputs: Paths, overview: int | None) -> None:
    """Refuse, before evidence is read, outputs of what it does not hold.

    Raises
    ------
    UsageError
        One shows only where the robot went, or single cells where an overview is wanted.
    """
    for path in outputs:
        writer = writers.find_writer(path)
        if writer.needs_journey:
            found = "evidence does not say where the robot went, only the logs do"
            raise UsageError(found, where=path, fix="build it from the logs: `occmap build`")
        # No other format shows what was observed and the robot's way, too.
        is_page = writer.needs_evidence and writer.shows_journey
        if is_page and overview is not None:
            found = "shows single cells, and `overview` has none"
            raise UsageError(found, where=path, fix="leave out `overview`, or write a .png")


def publish(saved: Blocks, options: RenderOptions, outputs: Paths) -> Report:
    """Render evidence and write it, as a map or as evidence; the report sums up its builds.

    Where no output needs the whole map, it is never made: evidence is written block by block.

    Parameters
    ----------
    outputs
        That they can be written, and of evidence, was found before it was read.

    Raises
    ------
    OccmapError
        As `render_saved`, or an output cannot be written.
    """
    product = render_saved(saved, options, outputs)
    files = writers.write_outputs(outputs, product, options.writing)
    report: Report = replace(product.report, files=tuple(files))
    return report


def render_saved(saved: Blocks, options: RenderOptions, outputs: Paths = ()) -> Product:
    """Render evidence, and sum up its builds, for outputs that are to be written.

    Raises
    ------
    OccmapError
        The model cannot read the evidence or knows no visits, or nothing is left of the map or it
        would be too large.
    """
    model = evidence.choose_model_for(saved, options.model, options.min_passes)
    saved = replace(saved, manifest=replace(saved.manifest, model=describe_model(model)))
    grid, facts = paint_saved(saved, model, options, writers.want_whole(outputs))
    report = summarise(saved.manifest, facts, options, outputs)
    return Product(grid, cache(lambda: read_all(saved)), report=report, blocks=saved)


def paint_saved(
    saved: Blocks, model: SensorModel, options: RenderOptions, whole: bool, logs: Sequence[str] = ()
) -> tuple[Any, MapFacts]:
    """Paint a map, or the part of it that is wanted, measure it, and say what it is of.

    Parameters
    ----------
    whole
        Else a large map is a `BlockMap`, and never there as a whole.
    logs
        Names of those that the manifest does not have.

    Raises
    ------
    OccmapError
        Nothing is left of it, it would be too large, or there is no such overview.
    """
    notes = saved.whole.notes if saved.whole else ()
    lost: Sequence[str] = ()
    if options.overview is not None:
        shown = options.writing.edit(read_overview(saved, options.overview, options))
    else:
        made = replace(open_map(saved, model, options), logs=logs)
        if not whole and is_large(saved):
            if saved.whole and len(saved.whole.tiles) * TILE**2 > FULL * made.box.cells:
                refuse_large(made.box, Lattice(made.resolution), options.max_cells)
            facts = survey_blocks(made)
            return made, facts._replace(lost=[*notes, *facts.lost])
        shown, lost = made.paint_all()
    counted = shown.resolution, shown.extent, shown.shape, count_cells(shown, options.writing)
    return shown, MapFacts(*counted, shown.agreement, [*notes, *lost])


def read_overview(store: Blocks, side: int, options: RenderOptions) -> OccupancyMap:
    """Make a coarse map of the pictures in a store, in which a pixel is a square of cells.

    Raises
    ------
    UsageError
        It is no store, or has no picture of such squares or of what the user wants.
    MapError
        Nothing was observed or lies in the extent, the map would be too large, or the picture
        cannot be read.
    """
    if store.root is None:
        raise UsageError("`overview` goes with a store", where=store.where, fix="leave it out")
    chosen = options.model, options.min_passes, options.since, options.until
    if any(each is not None for each in chosen):
        found = "the pictures in a store show what its own model decided of all that was observed"
        raise UsageError(found, fix="leave out `overview`, or model, `min_passes` and times")
    with refuse_damage(Path(store.where)):
        arrays = {int(name): array for name, array in store.root["classes"].arrays()}
    if side not in arrays:
        found = f"`overview={side}`: there is no picture of squares of {side} x {side} cells"
        fix = f"there are those of {', '.join(map(str, sorted(arrays)))}"
        raise UsageError(found, where=store.where, fix=fix)
    if not store.blocks:
        refuse_nothing_left(store, options)
    fine = Lattice(store.manifest.resolution)
    coarse = Lattice(round(fine.resolution * side, 12))
    observed = reduce(CellBox.join, store.blocks.values())
    row, col = store.root.attrs["occmap"]["offset"]
    box = choose_box(observed, options.framing, fine).move(-row, -col).align(side).shrink(side)
    refuse_large(box, coarse, options.max_cells)
    whole = CellBox(0, 0, *arrays[side].shape)
    there = whole.clip(box)
    classes = np.full(box.shape, CellClass.NEITHER, np.uint8)
    with refuse_damage(Path(store.where)):
        classes[there.within(box)] = arrays[side][there.within(whole)]
    refuse_lost(store, side, there, classes[there.within(box)])
    origin = fine.to_metres(col + box.col * side), fine.to_metres(row + box.row * side)
    is_known = classes != CellClass.NEITHER
    about = describe_about(store.manifest, identify(store), options)
    return OccupancyMap(CLASS_LOG_ODDS[classes], is_known, coarse.resolution, origin, about=about)


def refuse_lost(store: Blocks, side: int, box: CellBox, classes: UInt8) -> None:
    """Refuse a picture that shows nothing of a block in which cells are free or occupied.

    Parameters
    ----------
    box
        What is shown of the picture, in its pixels.
    classes
        (H, W) of these.

    Raises
    ------
    MapError
        A file of the picture is missing, which reads as unknown.
    """
    row, col = store.root.attrs["occmap"]["offset"]
    for reach in store.blocks.values():
        shown = box.clip(reach.move(-row, -col).align(side).shrink(side))
        if not shown.cells or classes[shown.within(box)].any():
            continue
        cells = shown.scale(side).move(row, col)
        grid = evidence.to_grid(read_part(store, cells))
        if evidence.paint_box(grid, evidence.read_model(store), cells).classes.any():
            found = "a file of its pictures is missing"
            raise MapError(found, where=store.where, fix="leave out `overview`, or build it again")


def summarise(
    manifest: Manifest, facts: MapFacts, options: RenderOptions, outputs: Paths
) -> Report:
    """Sum up all builds of evidence, and the map that was made of it by the manifest's model."""
    beams = [build["scans"]["beams"] for build in manifest.builds]
    # An older occmap may have counted fewer kinds of beams, or others.
    kinds = {kind: sum(each.get(kind, 0) for each in beams) for kind in ReturnCounts._fields}
    return Report(
        logs=tuple(entry["name"] for build in manifest.builds for entry in build["inputs"]),
        scans=sum_scans(manifest.builds),
        builds=len(beams),
        beams=ReturnCounts(**kinds),
        map=results.MapSummary.describe(facts, manifest, options.min_passes),
        notes=(
            *list_doubts(manifest),
            *writers.list_idle(outputs, options.writing),
            *results.list_unwritten(facts, parse_model(manifest.model), options.writing, outputs),
            *facts.lost,
            *results.list_disagreement(facts, options.min_passes),
        ),
    )


def sum_scans(builds: Sequence[BuildRecord]) -> ScanCounts:
    """Add up what became of the scans of builds."""
    scans = [build["scans"] for build in builds]
    dropped: Counter[str] = Counter()
    for each in scans:
        dropped.update(each["dropped"])
    return ScanCounts(sum(s["read"] for s in scans), sum(s["used"] for s in scans), dict(dropped))
