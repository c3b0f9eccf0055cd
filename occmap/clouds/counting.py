"""What clouds show of the ground: heights of their points, counted in columns, and their path."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from operator import itemgetter
from threading import Lock
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from occmap.cells import Ground
from occmap.clouds import draw
from occmap.clouds.kernels import heights
from occmap.clouds.kernels.heights import Cloud, Histogram, list_clouds
from occmap.clouds.kernels.laying import lay_cloud, lay_columns
from occmap.clouds.robot import BODY_MM, BODY_PLACES, Place, find_body, list_filled
from occmap.posing import Drift
from occmap.sensor import AROUND_M, Sensor, Voxels
from occmap.types import Float64, Int64, PosedScans

POINTS_A_CLOUD = 12_500
"""About so many points of each cloud are counted, or an eighth: whichever is more."""
LEAST_SHARE = 0.125
FEWEST_CLOUDS = 100
"""About so many clouds of a build are counted at least, if it has them."""
FIRST_SIZE = 1 << 14
"""Of a table, which grows"""
UPRIGHT_CLOUDS, UPRIGHT_POINTS = 20, 20_000
"""So many clouds, and about so many points of each, show if walls stand upright"""
LOG_CLOUDS = 5
"""So many of each log at least: many logs of one way have the same"""
PLACE_MM, AREA_MM = 1000, 30_000
"""Clouds of one square see walls alike, so one of them is enough; those of one area see the same"""
SHORT_MM = 150
"""The path is taken at steps of about this length."""


Drawn: TypeAlias = tuple[float, float]
"""Numbers for the area, and for the square in it, where a cloud was made"""
View: TypeAlias = tuple[int, str, str, str, int, int, int]
"""When a cloud was made (ns), by which sensor, and where that was (mm)"""

Kept = TypeVar("Kept")


class Counted(NamedTuple):
    """What clouds show of the ground."""

    table: Histogram
    paths: dict[Sensor, Int64]
    """(P, 3) where each sensor went (mm)"""
    views: dict[Drawn, tuple[View, Float64]]
    """A few clouds, and (N, 3) where some of their points lie (m)"""
    drifts: dict[str, Drift]
    """By what heights are corrected, by log"""
    bodies: dict[Sensor, Voxels]
    """Where the robot itself is around a sensor: its points are not counted"""

    @property
    def path(self) -> Int64:
        """(P, 3) where any sensor went (mm)."""
        return np.concatenate([np.zeros((0, 3), np.int64), *self.paths.values()])

    @property
    def sharpness(self) -> float:
        """How few bins of heights the points fill: a floor that lies well fills few."""
        many = self.table.counts[: int(self.table.used[0])].ravel()
        squares = np.einsum("i,i", many, many, dtype=np.float64)  # which copies nothing
        return float(squares / max(int(many.sum(dtype=np.int64)), 1))


class Counter:
    """Counts heights of points in columns; any number of threads may call `add`."""

    def __init__(
        self,
        clouds: int,
        log: str = "",
        ground: Ground | None = None,
        kept: tuple[int, int] = (UPRIGHT_CLOUDS, BODY_PLACES),
        min_range: float = 0.0,
    ) -> None:
        """Make one for a build of so many clouds, those of a log, that are laid on some ground.

        Parameters
        ----------
        kept
            How many of them show if walls stand upright, and how many where the robot itself is.
        min_range
            Points nearer than this, on the map, show no ground (m).
        """
        self._log, self._nearest = log, float(min_range)
        # Where clouds are laid on ground, both are known.
        self._most_views, self._most_places = (0, 0) if ground else kept
        self._floor = ground and lay_columns(ground)
        self._least_share = max(LEAST_SHARE, FEWEST_CLOUDS / max(clouds, 1))
        # Points around a sensor may be the robot itself: they have tables of their own.
        self._idle: defaultdict[Sensor | None, list[Histogram]] = defaultdict(list)
        self._places: defaultdict[Sensor, dict[Drawn, tuple[View, Place]]] = defaultdict(dict)
        self._ways: defaultdict[Sensor, list[tuple[int, int, int, int]]] = defaultdict(list)
        """Where each sensor was (mm), and when (ns)"""
        self._views: dict[Drawn, tuple[View, Cloud]] = {}
        """The earliest clouds of those squares for which the lowest numbers were drawn"""
        self._lock = Lock()

    def wants(self, stamp_ns: int, points: int) -> bool:
        """Whether a cloud is among those that are counted, however logs are cut into parts."""
        return draw(stamp_ns) < max(POINTS_A_CLOUD / max(points, 1), self._least_share)

    def add(self, posed: PosedScans) -> None:
        """Count the points of some clouds."""
        sensor = self._log, posed.batch.topic, posed.batch.frame if posed.origin is None else ""
        is_looked = self._most_places > 0 and posed.origin is None
        nearest = self._nearest, AROUND_M if is_looked else 0.0
        with self._lock:
            idle = [self._idle[each] for each in (None, sensor)]
            far, around = (each.pop() if each else make_table(FIRST_SIZE) for each in idle)
        room = np.empty((3, heights.SOME)), np.empty((2, heights.SOME), np.int64)
        for stamp_ns, cloud in zip(posed.batch.stamp_ns.tolist(), list_clouds(posed), strict=True):
            start, points = 0, len(cloud.points) // 3
            laid = lay_cloud(cloud, self._floor) if self._floor else cloud
            while start < points:
                start = heights.count_heights(laid, (far, around), start, nearest, room)
                far, around = grow_table(far), grow_table(around)
            view = stamp_ns, *sensor, *np.rint(1000 * cloud.origin).astype(np.int64).tolist()
            self._see(sensor, view, cloud)
            if is_looked:
                self._look_around(sensor, view, cloud)
        with self._lock:
            idle[0].append(far)
            idle[1].append(around)

    def _look_around(self, sensor: Sensor, view: View, cloud: Cloud) -> None:
        """Keep which voxels around its sensor a cloud fills, if it is the first of its place."""
        square = draw_square(view, BODY_MM), 0.0
        with self._lock:
            places = self._places[sensor]
            is_kept = would_keep(places, square, view, self._most_places)
        if is_kept:
            place = list_filled(cloud), cloud.poses[len(cloud.poses) // 2]
            with self._lock:
                keep_view(places, square, (view, place), self._most_places)

    def _see(self, sensor: Sensor, view: View, cloud: Cloud) -> None:
        """Keep where a cloud was made, and the cloud if it may show whether walls stand upright."""
        drawn = draw_square(view, AREA_MM), draw_square(view, PLACE_MM)
        with self._lock:
            self._ways[sensor].append((*view[4:], view[0]))
            keep_view(self._views, drawn, (view, cloud), self._most_views)

    def count(self) -> Counted:
        """Give what was counted; the tables are handed over."""
        paths = {sensor: thin_path(np.array(way)) for sensor, way in sorted(self._ways.items())}
        views = {drawn: (view, sample_points(it)) for drawn, (view, it) in self._views.items()}
        idle, self._idle = self._idle, defaultdict(list)
        far, bodies = add_tables(idle.pop(None, [])), dict[Sensor, Voxels]()
        for sensor, places in sorted(self._places.items()):
            seen = [place for _, (_, place) in sorted(places.items())]
            if body := find_body(far, np.array(self._ways[sensor]), seen):
                bodies[sensor] = body
        around = (it for sensor, some in idle.items() if sensor not in bodies for it in some)
        return Counted(add_tables([far, *around]), paths, views, {}, bodies)

    @property
    def way(self) -> Int64:
        """(N, 4) where the sensor with most clouds was (mm), and when (ns)."""
        ways = (way for _, way in sorted(self._ways.items()))
        return np.array(max(ways, key=len, default=[]), np.int64).reshape(-1, 4)


def count_clouds(
    clouds: Iterable[PosedScans], ground: Ground | None = None, min_range: float = 0.0
) -> Counted:
    """Count all clouds of some batches, laid on some ground, without points that are nearer (m)."""
    some = list(clouds)
    many = sum(each.batch.scans for each in some)
    counter = Counter(many, ground=ground, min_range=min_range)
    for each in some:
        counter.add(each)
    return counter.count()


def join_counted(parts: Iterable[Counted]) -> Counted:
    """Add up what was counted of different logs, maybe by several processes."""
    tables = list[Histogram]()
    paths, drifts = dict[Sensor, Int64](), dict[str, Drift]()
    bodies = dict[Sensor, Voxels]()
    views: dict[Drawn, tuple[View, Float64]] = {}
    for each in parts:
        tables.append(each.table)
        paths |= each.paths
        drifts |= each.drifts
        bodies |= each.bodies
        for drawn, seen in each.views.items():
            keep_view(views, drawn, seen, UPRIGHT_CLOUDS)
    return Counted(add_tables(tables), dict(sorted(paths.items())), views, drifts, bodies)


def draw_square(view: View, side_mm: int) -> float:
    """Draw a number for the square, of such a side, in which a cloud was made."""
    x, y = view[4:6]
    return draw((x // side_mm << 32) + y // side_mm)


def would_keep(
    views: Mapping[Drawn, tuple[View, Kept]], drawn: Drawn, view: View, most: int
) -> bool:
    """Say if `keep_view` keeps a view, by those that there are."""
    if drawn in views:
        return view < views[drawn][0]
    return len(views) < most or drawn < max(views)


def keep_view(
    views: dict[Drawn, tuple[View, Kept]], drawn: Drawn, seen: tuple[View, Kept], most: int
) -> None:
    """Keep the earliest view of a square, if it is among so many with the lowest numbers."""
    # The least, not the first: threads and logs hand them over in any order.
    views[drawn] = min(views.get(drawn, seen), seen, key=itemgetter(0))
    if len(views) > most:
        del views[max(views)]


def list_apart(views: Mapping[Drawn, tuple[View, Float64]]) -> list[Float64]:
    """List points of those views that are not of one place, which may lie in several squares."""
    kept = list[tuple[View, Float64]]()
    for _, (view, points) in sorted(views.items()):
        if all(math.dist(view[-3:], other[-3:]) >= PLACE_MM / 2 for other, _ in kept):
            kept.append((view, points))
    return [points for _, points in kept]


def make_table(size: int) -> Histogram:
    """Make an empty table for half as many pieces as its size, which is a power of two."""
    slots, keys = np.full(size, heights.EMPTY, np.int32), np.empty(size // 2, np.int64)
    counts = np.zeros((size // 2, heights.BINS), np.uint16)
    return Histogram(slots, keys, counts, np.zeros(1, np.int64))


def grow_table(table: Histogram) -> Histogram:
    """Copy a table that is nearly full to one with room for twice as much."""
    if table.used[0] + heights.SOME <= len(table.keys):
        return table
    grown = make_table(2 * len(table.slots))
    heights.add_histogram(table, grown, 0)
    return grown


def add_tables(tables: Iterable[Histogram]) -> Histogram:
    """Add tables to the first of them, or to a larger copy of it."""
    first, *others = [*tables] or [make_table(2)]
    for other in others:
        start = 0
        while (start := heights.add_histogram(other, first, start)) < other.used[0]:
            first = grow_table(first)
    return first


def sample_points(cloud: Cloud) -> Float64:
    """Place some points (N, 3) of a cloud, those that came back (m)."""
    points, pose = heights.pose_points(cloud, UPRIGHT_POINTS)
    with np.errstate(invalid="ignore"):
        apart = np.abs(points).sum(axis=1)
        is_real = (apart > 0) & (apart < heights.FARTHEST_M)
    points, pose = points[is_real], pose[is_real]
    return np.asarray(np.einsum("nij,nj->ni", pose[:, :, :3], points) + pose[:, :, 3])


def thin_path(way: Int64) -> Int64:
    """Take one place of a sensor (N, 3) of each column and height, in ascending order (mm)."""
    # Of several the least counts, not the first: threads hand them over in any order.
    every = np.unique(way[:, :3], axis=0)
    _, first = np.unique(every // SHORT_MM, axis=0, return_index=True)
    return every[first]
