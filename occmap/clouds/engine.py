"""The engine of clouds: hits and misses of cells, cloud by cloud, over ground that is known."""

import math
from functools import partial

import numpy as np

from occmap.cells import CellBox, Ground, Key, Tile, view_tiles
from occmap.clouds import CloudOptions
from occmap.clouds.kernels import tracing
from occmap.clouds.kernels.growth import BLOCK, Blocks
from occmap.clouds.kernels.heights import SOME, Cloud, find_reach, list_clouds
from occmap.clouds.kernels.laying import SHORTEST_M, Columns, lay_cloud, lay_columns
from occmap.clouds.kernels.tracing import COUNTS, NOBODY_LOOKED, Band, Canvas
from occmap.grid import Lattice, refuse_long
from occmap.grid.engine import Engine
from occmap.grid.kernels import NEAR_WEIGHT
from occmap.grid.tiles import MAX_CELLS, TILE, EvidenceKind, TileGrid, refuse_large
from occmap.sensor import ReturnOptions
from occmap.types import COLUMN_MM, PosedScans

SLACK_M = 0.096
"""The clearance grows from where poses that are off put the floor this high: 8 m by default."""
MANY_TILES = 1 << 12
"""A sheet has room for so many, which is memory only once they are written to"""
TILE_BYTES = TILE * TILE * 7
"""What a tile takes: two counts, the ground, and what a cloud says of each cell"""
MOST_CLOUDS = np.iinfo(np.int16).max // NEAR_WEIGHT
"""So many fit the counts of a sheet, which are as narrow as they may be: memory is what is slow"""
POINT_KINDS = ("ground", "obstacle", "above", "below", "too far", "no return")
"""What becomes of points, in the order of the kernel's counts"""


class Sheet:
    """A canvas of one thread: the tiles that clouds of late reached and that have ground."""

    def __init__(self, lattice: Lattice, columns: Columns, box: CellBox) -> None:
        """Make one for tiles of a box, which counts tiles."""
        self.box, self._lattice, self._columns = box, lattice, columns
        self.points = np.zeros(COUNTS, np.int64)
        """How many points were of each kind"""
        self.number, self.clouds = 0, 0
        """The slice of time of what it holds, and how many clouds that is"""
        self.room = tracing.make_room(0)
        self.clear(MANY_TILES)

    def clear(self, tiles: int) -> None:
        """Begin anew, with room for so many tiles."""
        table = np.full(self.box.shape, NOBODY_LOOKED, np.int32)
        blocks = Blocks(table, np.array(self.box[:2], np.int64), np.zeros((tiles, 2), np.int64))
        base, cells = np.zeros(tiles, np.int32), tiles * TILE * TILE
        ground, state = np.zeros(cells, np.int16), np.zeros(cells, np.uint8)
        counts, used = np.zeros(2 * cells, np.int16), np.zeros(1, np.int64)
        layers = base, ground, state, np.zeros(tiles, np.uint8), counts, used, self.points
        self.canvas = Canvas(self._columns, blocks, *layers, self._lattice.resolution)

    @property
    def used(self) -> int:
        """How many tiles it has."""
        return int(self.canvas.used[0])

    def reach(self, cloud: Cloud, farthest: float) -> CellBox:
        """The box of tiles around a sensor, up to so far away or up to the farthest point."""
        metres = min(find_farthest(cloud), farthest)
        around = self._lattice.enclose(cloud.origin[None, :2], metres)
        return self.box.clip(around.align(TILE).shrink(TILE))

    def lay_out(self, box: CellBox) -> bool:
        """Lay out the tiles of a box that are not yet; say whether it has room for them."""
        if (self.canvas.tiles.table[box.within(self.box)] != NOBODY_LOOKED).all():
            return True
        inside = np.array(box.move(-self.box.row, -self.box.col))
        return bool(tracing.lay_ground(self.canvas, inside, np.empty(TILE * TILE, np.int32)))

    def observe(self, cloud: Cloud, band: Band) -> None:
        """Observe the cells of a cloud, of which all tiles are laid out."""
        if len(self.room.floor) < len(cloud.points) // 3:
            self.room = tracing.make_room(len(cloud.points) // 3)
        laid, self.clouds = lay_cloud(cloud, self.canvas.columns), self.clouds + 1
        tracing.trace_cloud(laid, band, self.canvas, self.room)

    def empty(self) -> tuple[dict[Key, Tile], int]:
        """Give the tiles in which something was observed, as narrow as may be, and their bound."""
        cells = self.canvas.counts.reshape(-1, 2, TILE, TILE)[: self.used]
        seen = cells.any(axis=(1, 2, 3))
        most = int(cells.max(initial=0))
        taken = cells[seen].astype(np.min_scalar_type(-1 - most))
        cells[seen] = 0
        self.clouds = 0
        return view_tiles(self.canvas.tiles.places[: self.used][seen], taken), most


def find_farthest(cloud: Cloud) -> float:
    """How far from the sensor no point of a cloud is, by whichever of its poses (m)."""
    turn, start = np.split(cloud.poses, [3], axis=2)
    middle = len(turn) // 2
    # The sensor in the frame of the points, which may be far away from the zero of that.
    centre = (turn[middle].T @ (cloud.origin - start[middle, :, 0])).astype(np.float32)
    moved = np.linalg.norm(turn @ centre + start[:, :, 0] - cloud.origin, axis=1)
    return find_reach(cloud.points, centre) + float(moved.max())


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
        numbers = self._number(posed.batch.stamp_ns).tolist()
        with self._lock:
            sheet = self._idle.pop() if self._idle else self._make_sheet()
        for number, cloud in zip(numbers, list_clouds(posed), strict=True):
            if self._box.cells > self._max_cells:
                self._refuse_large(cloud)
            if sheet.number != number or sheet.clouds == MOST_CLOUDS:
                self._empty(sheet)
                sheet.number = number
            box = sheet.reach(cloud, self._band.farthest)
            if not sheet.lay_out(box):
                self._empty(sheet)
                # With room to go on, or the next cloud begins anew, too.
                sheet.clear(max(MANY_TILES, box.cells * 3 // 2))
                sheet.lay_out(box)
            sheet.observe(cloud, self._band)
        with self._lock:
            self._idle.append(sheet)

    def _refuse_large(self, cloud: Cloud) -> None:
        """Refuse a map that is surely too large before tiles are laid out for it."""
        lattice = self.grid.lattice
        refuse_long(min(find_farthest(cloud), self._band.farthest), lattice.resolution)
        with self._lock:
            self._extent.add(cloud)
            box = self._extent.box
        # What lies at the edge may be hidden beneath a thing.
        if box and (surely := box.grow(-TILE)).rows > 0:
            refuse_large(surely, lattice, self._max_cells)

    def _empty(self, sheet: Sheet) -> None:
        tiles, most = sheet.empty()
        if tiles:
            self._keep(tiles, most, sheet.number)

    @property
    def points(self) -> dict[str, int]:
        """As of `Engine`."""
        counts = sum((sheet.points for sheet in self._idle), np.zeros(COUNTS, np.int64))
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
