"""Evidence moved on its lattice by a small transform, so that it lies in the frame of another."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from occmap.cells import Evidence, Key, Slices, Tile, stack_tiles, view_tiles
from occmap.choices import format_mount, to_rpy
from occmap.evidence.manifest import write_value
from occmap.grid import tiles
from occmap.grid.tiles import TILE
from occmap.types import IDENTITY, Float64, Int64, Pose


class Transform(NamedTuple):
    """What moves points: a turn about the origin, and then a shift."""

    x: float
    """Shift along x (m)"""
    y: float
    """Shift along y (m)"""
    yaw: float
    """Turn, counter-clockwise (rad)"""

    def move(self, points: Float64) -> Float64:
        """Move points (N, 2), or a single one (2,)."""
        return np.asarray(points @ self.matrix.T + self[:2])

    def move_back(self, points: Float64) -> Float64:
        """Find which points (N, 2) are moved to given ones."""
        return np.asarray((points - self[:2]) @ self.matrix)

    def after(self, first: Pose) -> "Transform":
        """Make one of a planar move and, after it, this one."""
        x, y = self.move(np.array([first.x, first.y])).tolist()
        yaw = math.remainder(to_rpy(first)[2] + self.yaw, math.tau)
        return Transform(round(x, 5), round(y, 5), round(yaw, 6))

    @property
    def matrix(self) -> Float64:
        """The turn (2, 2)."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[cos, -sin], [sin, cos]])


STAY = Transform(0.0, 0.0, 0.0)


def add_move(first: Pose | None, then: Transform, align: float | None) -> Pose:
    """Make the `transform` that a user may type for one and, in a turned map, another after it."""
    turned = Transform(0.0, 0.0, -math.radians(align or 0.0))
    x, y = turned.move(np.array(then[:2])).tolist()
    moved = then._replace(x=x, y=y)  # what does the same before the map is turned
    given = format_mount(Pose.planar(*moved.after(first or IDENTITY)))
    return Pose.planar(*map(float, given.split(",")))


def move_evidence(evidence: Evidence, by: Transform) -> Evidence:
    """Move evidence on its lattice: each cell takes all that is known of the one it comes from.

    That is the cell in which its middle was before. So no cell between others stays empty, no wall
    is smeared, and numbers stay whole; a cell here and there is taken twice, or not at all.
    """
    manifest = evidence.manifest
    builds = tuple(_record_move(build, by, manifest.align) for build in manifest.builds)
    origins = list_origins(evidence.tiles, by, manifest.resolution)
    moved = _move_tiles(evidence.tiles, origins)
    slices = tuple(_move_slices(each, origins) for each in evidence.slices)
    manifest = replace(manifest, builds=builds)
    return replace(evidence, manifest=manifest, tiles=moved, slices=slices)


Origin: TypeAlias = tuple[list[Key], Int64, Int64]
"""Where the cells of a tile were before they moved: in these tiles, each cell (4096,) in which of
them, and at which place in that"""


def list_origins(keys: Iterable[Key], by: Transform, resolution: float) -> dict[Key, Origin]:
    """Find all tiles that some may reach when they move, and where their cells were."""
    side, beside = TILE * resolution, np.array(list(product((-1, 0, 1), repeat=2)))
    places = np.array(list(keys), np.float64).reshape(-1, 2)
    centres = by.move(places[:, ::-1] * side + side / 2) / side
    # No part of a tile reaches beyond the tiles beside that in which its centre lies.
    reached = np.floor(centres[:, np.newaxis, ::-1]).astype(np.int64) + beside
    rows, cols = np.indices((TILE, TILE)).reshape(2, -1)
    middles = np.column_stack([cols + 0.5, rows + 0.5]) * resolution
    origins: dict[Key, Origin] = {}
    for row, col in np.unique(reached.reshape(-1, 2), axis=0).tolist():
        before = by.move_back(middles + np.array([col, row]) * side)
        cells = np.floor(before[:, ::-1] / resolution).astype(np.int64)
        sources, which = np.unique(cells // TILE, axis=0, return_inverse=True)
        inside = cells % TILE @ np.array([TILE, 1])
        origins[row, col] = [(r, c) for r, c in sources.tolist()], which.ravel(), inside
    return origins


def _move_tiles(tiles: Mapping[Key, Tile], origins: Mapping[Key, Origin]) -> dict[Key, Tile]:
    """Move what tiles hold; empty ones are gone."""
    nothing = np.zeros((2, TILE, TILE), np.int8)
    made = {}
    for key, (sources, which, inside) in origins.items():
        if tiles.keys().isdisjoint(sources):
            continue
        held = np.stack([tiles.get(each, nothing).reshape(2, -1) for each in sources])
        tile = held[which, :, inside].T
        if tile.any():
            made[key] = tile.reshape(2, TILE, TILE)
    return made


def _move_slices(slices: Slices, origins: dict[Key, Origin]) -> Slices:
    """Move what slices say, one after the other."""
    parts = []
    for number in np.unique(slices.numbers).tolist():
        of_slice = tiles.take_tiles(slices, np.flatnonzero(slices.numbers == number))
        known = np.unpackbits(tiles.unpack_bits(of_slice), axis=-1).view(np.int8)
        moved = _move_tiles(view_tiles(of_slice.tiles, known), origins)
        places, cells = stack_tiles(moved)
        bits, numbers = np.packbits(cells != 0, axis=-1), np.full(len(places), number)
        parts.append(tiles.pack_bits(places, numbers, bits))
    return tiles.unite(parts)


def _record_move(build: dict[str, Any], by: Transform, align: float | None) -> dict[str, Any]:
    """Say of a build that its cells were moved, and with which `transform` it would lie there."""
    options = build["options"]
    given = options["posing"].get("transform")
    pose = add_move(given and Pose(*given), by, align)
    posing = {**options["posing"], "transform": write_value(pose)}
    return {**build, "options": {**options, "posing": posing}, "moved": list(by)}
