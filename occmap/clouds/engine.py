"""The engine of clouds: hits and misses of cells, cloud by cloud, over ground that is known."""

import math
from collections.abc import Sequence
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from occmap.cells import CellBox, Ground, view_tiles
from occmap.clouds import CloudOptions
from occmap.clouds.kernels import tracing
from occmap.clouds.kernels.growth import BLOCK, Blocks
from occmap.clouds.kernels.heights import SOME, Cloud, find_reach, list_clouds
from occmap.clouds.kernels.laying import SHORTEST_M, Columns, lay_cloud, lay_columns
from occmap.clouds.kernels.tracing import COUNTS, Band, Canvas
from occmap.grid import Lattice, refuse_long
from occmap.grid.engine import Engine
from occmap.grid.kernels.units import NEAR_WEIGHT
from occmap.grid.tiles import MAX_CELLS, TILE, EvidenceKind, TileGrid, refuse_large
from occmap.sensor import ReturnOptions
from occmap.types import COLUMN_MM, Float64, Int32, Int64, PosedScans

SLACK_M = 0.096
"""The clearance grows from where poses that are off put the floor this high: 8 m by default."""
FIRST_TILES = 64
TILE_BYTES = TILE * TILE * 11
"""What a tile takes: two counts, the ground, and what a cloud says of each cell"""
POINT_KINDS = ("ground", "obstacle", "above", "below", "too far", "no return")
"""What becomes of points, in the order of the kernel's counts"""


class Sheet:
    """A canvas of one thread: it grows by the tiles that clouds reach and that have ground."""

    def __init__(self, lattice: Lattice, columns: Columns, box: CellBox) -> None:
        self.lattice = lattice
        table, corner = np.full(box.shape, -2, np.int32), np.array(box[:2], np.int64)
        tiles = Blocks(table, corner, np.zeros((FIRST_TILES, 2), np.int64))
        of_tiles, of_cells = FIRST_TILES, FIRST_TILES * TILE * TILE
        base, ground = np.zeros(of_tiles, np.int32), np.zeros(of_cells, np.int16)
        state, counts = np.zeros(of_cells, np.uint8), np.zeros(2 * of_cells, np.int32)
        used, points = np.zeros(1, np.int64), np.zeros(COUNTS, np.int64)
        layers = base, ground, state, counts
        self.canvas = Canvas(columns, tiles, *layers, used, points, lattice.resolution)
        self.number = 0
        """The slice of time of what it holds"""
        self.room = tracing.make_room(0, 0)

    @property
    def used(self) -> int:
        """How many tiles it has."""
        return int(self.canvas.used[0])

    def reach(self, origins: Float64, metres: float) -> None:
        """Lay out the tiles up to so far from places (N, 3)."""
        box = self.lattice.enclose(origins[:, :2], metres).align(TILE).shrink(TILE)
        table, corner, _ = self.canvas.tiles
        low = np.maximum(np.array(box[:2]) - corner, 0)
        high = np.minimum(np.array(box[2:]) - corner, table.shape) - 1
        inside, heights = np.concatenate([low, high]), np.empty(TILE * TILE, np.int32)
        while not tracing.lay_ground(self.canvas, inside, heights):
            names = "base", "ground", "state", "counts"
            layers: dict[str, Any] = {name: double(getattr(self.canvas, name)) for name in names}
            tiles = self.canvas.tiles._replace(places=double(self.canvas.tiles.places))
            self.canvas = self.canvas._replace(tiles=tiles, **layers)

    def observe(self, clouds: Sequence[Cloud], band: Band) -> None:
        """Observe the cells of some clouds."""
        farthest = min(max(map(find_farthest, clouds)), band.farthest)
        self.reach(np.array([cloud.origin for cloud in clouds]), farthest)
        points = max(len(cloud.points) // 3 for cloud in clouds)
        beams = tracing.SECTORS * 2 * (int(farthest / self.lattice.resolution) + 2)
        cells = min(points + beams, self.used * TILE * TILE)
        most_points, most_cells = len(self.room.floor), len(self.room.touched) - 1
        if most_points < points or most_cells < cells:
            self.room = tracing.make_room(max(points, most_points), max(cells, most_cells))
        for cloud in clouds:
            laid = lay_cloud(cloud, self.canvas.columns)
            tracing.trace_cloud(laid, band, self.canvas, self.room)

    def empty(self) -> tuple[Int64, Int32]:
        """Give the places of tiles in which something was observed, and their cells."""
        cells = self.canvas.counts.reshape(-1, 2, TILE, TILE)[: self.used]
        seen = cells.any(axis=(1, 2, 3))
        places, taken = self.canvas.tiles.places[: self.used][seen], cells[seen]
        cells[seen] = 0
        return places, taken


def find_farthest(cloud: Cloud) -> float:
    """How far from the sensor no point of a cloud is (m)."""
    return find_reach(cloud.points) + math.dist(cloud.poses[0, :, 3], cloud.origin)


def make_band(options: CloudOptions, returns: ReturnOptions) -> Band:
    """Say which heights, and which distances from the sensor, count."""
    level = SLACK_M / options.range_margin if options.range_margin else math.inf
    margin = options.range_margin * 1000
    nearest = max(returns.min_range, SHORTEST_M)
    farthest = min(returns.max_range, returns.range_max or math.inf)
    return Band(*options.band_mm, margin, level, nearest, farthest)


class Extent:
    """The box around all points that observe their cells; it grows by the clouds that it sees."""

    def __init__(self, lattice: Lattice, columns: Columns, band: Band) -> None:
        self._lattice, self._columns, self._band = lattice, columns, band
        self._edges = np.array([np.inf, np.inf, -np.inf, -np.inf])
        self._place = np.empty((3, SOME))

    def add(self, cloud: Cloud) -> None:
        """Take in a cloud."""
        laid = lay_cloud(cloud, self._columns)
        tracing.widen(self._edges, laid, self._band, self._columns, self._place)

    @property
    def box(self) -> CellBox | None:
        """The cells; None: no point observes any."""
        low, high = self._edges[:2], self._edges[2:]
        return self._lattice.enclose(np.stack([low, high])) if low[0] <= high[0] else None


def double(layer: NDArray[Any]) -> NDArray[Any]:
    """Make room for twice as many tiles in a layer of a canvas."""
    return np.concatenate([layer, np.zeros_like(layer)])


class CloudEngine(Engine):
    """Adds up what clouds observe over the ground.

    Parameters
    ----------
    max_cells
        A map of more is refused as soon as some points of clouds show it.
    slice_ns
        As of `Engine`.
    """

    def __init__(
        self,
        lattice: Lattice,
        band: Band,
        ground: Ground,
        max_cells: int = MAX_CELLS,
        slice_ns: int | None = None,
    ) -> None:
        super().__init__(TileGrid(lattice, EvidenceKind.COUNTS, NEAR_WEIGHT), slice_ns)
        columns = lay_columns(ground)
        # A table of its own for each thread, of tiles around all ground.
        places = columns.blocks.places
        corners = np.stack([places.min(axis=0), places.max(axis=0) + 1])
        self._box = lattice.enclose(corners[:, ::-1] * (BLOCK * COLUMN_MM / 1000)).align(TILE)
        self._make_sheet = partial(Sheet, lattice, columns, self._box.shrink(TILE))
        self._band, self._max_cells = band, max_cells
        self._extent = Extent(lattice, columns, band)

    def add(self, posed: PosedScans) -> None:
        """Observe the cells of some clouds; raises MapError where the map gets too large."""
        clouds = list(list_clouds(posed))
        if self._box.cells > self._max_cells:
            self._refuse_large(clouds)
        numbers = self._number(posed.batch.stamp_ns).tolist()
        with self._lock:
            sheet = self._idle.pop() if self._idle else self._make_sheet()
        for number, some in groupby(range(len(clouds)), numbers.__getitem__):
            if sheet.number != number:
                self._empty(sheet)
                sheet.number = number
            sheet.observe([clouds[i] for i in some], self._band)
        with self._lock:
            self._idle.append(sheet)

    def _refuse_large(self, clouds: Sequence[Cloud]) -> None:
        """Refuse a map that is surely too large before tiles are laid out for it."""
        lattice = self.grid.lattice
        for cloud in clouds:
            refuse_long(min(find_farthest(cloud), self._band.farthest), lattice.resolution)
            with self._lock:
                self._extent.add(cloud)
                box = self._extent.box
            # What lies at the edge may be hidden beneath a thing.
            if box and (surely := box.grow(-TILE)).rows > 0:
                refuse_large(surely, lattice, self._max_cells)

    def _empty(self, sheet: Sheet) -> None:
        places, cells = sheet.empty()
        if len(places):
            self._keep(view_tiles(places, cells), int(cells.max()), sheet.number)

    @property
    def points(self) -> dict[str, int]:
        """As of `Engine`."""
        counts = sum((sheet.canvas.points for sheet in self._idle), np.zeros(COUNTS, np.int64))
        return dict(zip(POINT_KINDS, counts.tolist(), strict=True))

    @property
    def bytes_held(self) -> int:
        """As of `Engine`, and what the sheets take."""
        tiles: int = sum(sheet.used for sheet in self._idle)
        return super().bytes_held + tiles * TILE_BYTES

    def finish(self) -> TileGrid:
        """Give the evidence; more may be added later."""
        for sheet in self._idle:
            self._empty(sheet)
        return self.grid
