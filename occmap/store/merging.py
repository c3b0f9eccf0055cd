"""Evidence added up and taken apart again, exactly, over one ground, and moved onto other."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.cells import Evidence, Ground, Key, Manifest, Slices, Tile, stack_tiles, view_tiles
from occmap.choices import format_place, to_rpy
from occmap.errors import MapError, name_log
from occmap.evidence import UNEVEN_SHARE, Described, list_misfit, read_model, refuse_other, to_grid
from occmap.evidence.manifest import MEANING, BuildRecord, leave_out, write_value
from occmap.grid import tiles
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid
from occmap.report import count
from occmap.sensor.models import SensorModel
from occmap.store import Block, Blocks, join_blocks, open_saved, read_all
from occmap.types import COLUMN_MM, IDENTITY, NO_GROUND, Float64, Int64, Paths, Pose


def join_grounds(ground: Ground | None, evidence: Evidence) -> Ground | None:
    """Extend a ground by that of evidence where it has none.

    Raises
    ------
    MapError
        They differ where both were measured.
    """
    other = evidence.ground
    if ground is None or other is None:
        return ground or other
    builds = evidence.manifest.builds
    placed = (builds[-1]["options"]["posing"]["transform"] if builds else None) or IDENTITY
    fix = "build it over the ground of the other one, `ground=first.npz`"
    with name_log(evidence.where):
        refuse_other(ground.measure_rise(other), UNEVEN_SHARE, Pose(*placed), fix)
    blocks = np.unique(np.concatenate([ground.blocks, other.blocks]), axis=0)
    mine, its = ground.lay_out(blocks), other.lay_out(blocks)
    known = mine.measured | ((mine.height_mm > its.height_mm) & ~its.measured)
    height = np.where(known, mine.height_mm, its.height_mm)
    return Ground(blocks, height, mine.measured | its.measured)


Lay: TypeAlias = Callable[[Evidence, Evidence], Evidence]
"""Moves evidence onto other evidence"""


def combine(added: Paths, taken: Paths = (), lay: Lay | None = None) -> Blocks:
    """Add saved evidence and take some away, block by block where any of it is in a store.

    Parameters
    ----------
    lay
        For each part that is added, and the sum of those before it, all of them in memory; None:
        they are in one frame.

    Raises
    ------
    MapError
        As `add` and `subtract`; of blocks, maybe only when they are read.
    """
    parts = [open_saved(path) for path in (*added, *taken)]
    if lay is None and not all(each.whole for each in parts):
        return combine_blocks(parts, len(added))
    held, model = list(map(read_all, parts)), None
    with suppress(MapError):  # without a model, no note says what does not fit
        model = read_model(held[0])
    return Blocks.of(merge(held[: len(added)], held[len(added) :], model, lay))


def combine_blocks(parts: Sequence[Blocks], added: int) -> Blocks:
    """Combine evidence as `merge` does, but block by block, each only when it is read.

    Raises
    ------
    MapError
        The parts do not go together.
    """
    nothing = [join_blocks(each, ()) for each in parts]
    whole = merge(nothing[:added], nothing[added:])  # what differs is refused at once

    def read_block(block: Block) -> Evidence:
        pairs = zip(parts, nothing, strict=True)
        found = [of.read_block(block) if block in of.blocks else none for of, none in pairs]
        return merge(found[:added], found[added:])

    blocks = sorted({block for part in parts for block in part.blocks})
    reach = {block: block.box for block in blocks}
    return Blocks(whole.manifest, "", reach, read_block, whole.ground)


def merge(
    added: Sequence[Evidence],
    taken: Sequence[Evidence] = (),
    model: SensorModel | None = None,
    lay: Lay | None = None,
) -> Evidence:
    """Add evidence, and take some away; the cells are those of a build of all logs that are left.

    Parameters
    ----------
    model
        Notes say where parts do not fit those before them, by this model; None: no such notes.

    Raises
    ------
    MapError
        As `add` and `subtract`.
    """
    total, *others = added
    for other in others:
        total = add(total, lay(other, total) if lay else other, model)
    return reduce(subtract, taken, total)


def add(evidence: Evidence, other: Evidence, model: SensorModel | None) -> Evidence:
    """Add evidence to other evidence, over one ground.

    Raises
    ------
    MapError
        Their resolutions, updates or kinds differ, or their grounds.
    """
    mine, its = evidence.manifest, other.manifest
    refuse_unlike(mine, other)
    ground, notes = join_grounds(evidence.ground, other), [*evidence.notes, *other.notes]
    if model is not None:
        found = list_misfit(to_grid(evidence), other.tiles, model, "the evidence before it")
        notes += (f"{other.where}: {text}" for text in found)
    both = {name: getattr(mine, name) + getattr(its, name) for name in ("builds", "subtracted")}
    whole, slices = tiles.add_tiles(evidence.tiles, other.tiles), evidence.slices + other.slices
    return Evidence(replace(mine, **both), whole, slices, notes=tuple(notes), ground=ground)


def subtract(evidence: Evidence, other: Evidence) -> Evidence:
    """Take evidence away: what is left is as if `other` had never been added.

    Its logs and scans go with it, and the slices of whole builds. Of a part of a build it is not
    known which slices it alone observed; then all of them stay, and the numbers of visits are upper
    bounds. Logs and scans stay, too, where the part is not of whole logs.

    Raises
    ------
    MapError
        As `add`, or `other` holds something that is not there.
    """
    refuse_unlike(evidence.manifest, other)
    less = {key: -tile.astype(np.int64) for key, tile in other.tiles.items()}
    grid = to_grid(evidence).like(tiles.drop_empty(tiles.add_tiles(evidence.tiles, less)))
    refuse_negative(grid, evidence, other)
    builds, slices = list(evidence.manifest.builds), list(evidence.slices)
    unknown = list(evidence.manifest.subtracted)
    for build in other.manifest.builds:
        rests = [(rest, at) for at, of in enumerate(builds) if (rest := leave_out(of, build))]
        if not rests or other.manifest.subtracted:
            unknown.append(build)
            continue
        rest, place = min(rests, key=lambda each: len(each[0]["inputs"]))
        if rest["inputs"]:
            builds[place] = rest
        else:
            del builds[place], slices[place]
    manifest = replace(evidence.manifest, builds=tuple(builds), subtracted=tuple(unknown))
    left = tuple(tiles.restrict(each, grid) for each in slices)
    return Evidence(manifest, grid.tiles, left, notes=evidence.notes, ground=evidence.ground)


def refuse_negative(grid: TileGrid, evidence: Evidence, other: Evidence) -> None:
    """Refuse a difference that no observation can have made.

    Raises
    ------
    MapError
        Saying in how many cells too much was taken away.
    """
    first, second = np.moveaxis(stack_tiles(grid.tiles)[1], 1, 0)
    lacking = second < 0
    if grid.kind is EvidenceKind.COUNTS:
        lacking |= first < 0
    else:  # log-odds may be negative, but not without an observation
        lacking |= (second == 0) & (first != 0)
    if wrong := np.count_nonzero(lacking):
        minuend = evidence.where or "the sum"
        found = f"holds observations of {count(int(wrong), 'cell')} that {minuend} lacks"
        builds, logs = evidence.manifest.builds, [each["inputs"] for each in other.manifest.builds]
        fix = "subtract only what was merged before"
        if any("moved" in each and each["inputs"] in logs for each in builds):
            fix = "`fit` moved what it holds, to other cells: merge the others again, without it"
        raise MapError(found, where=other.where, fix=fix)


def refuse_unlike(manifest: Manifest, other: Described) -> None:
    """Refuse evidence that cannot be combined with other evidence.

    Raises
    ------
    MapError
        Naming what differs, and the option to give where it is one number.
    """
    for name in MEANING:
        mine, its = getattr(manifest, name), getattr(other.manifest, name)
        if mine != its:
            given = f"`{name}={mine}`, or both with `{name}={its}`"
            raise MapError(
                f"its {name} is {'none' if its == '' else its}, that of what it is to be combined "
                f"with is {'none' if mine == '' else mine}",
                where=other.where,
                fix=f"build both with {given if isinstance(mine, float) else 'the same options'}",
            )


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


def add_move(first: Pose | None, then: Transform, align: float | None, lift: float = 0.0) -> Pose:
    """Make the `transform` that a user may type for one and, in a turned map, another after it."""
    turned = Transform(0.0, 0.0, -math.radians(align or 0.0))
    x, y = turned.move(np.array(then[:2])).tolist()
    moved = then._replace(x=x, y=y)  # what does the same before the map is turned
    first = first or IDENTITY
    given = Pose.planar(*moved.after(first))._replace(z=round(first.z + lift, 3))
    x, y, yaw, *z = map(float, format_place(given).split(","))
    return Pose.planar(x, y, yaw)._replace(z=sum(z, 0.0))


def move_evidence(evidence: Evidence, by: Transform, lift: float = 0.0) -> Evidence:
    """Move evidence on its lattice: each cell takes all that is known of the one it comes from.

    That is the cell in which its middle was before. So no cell between others stays empty, no wall
    is smeared, and numbers stay whole; a cell here and there is taken twice, or not at all.
    """
    manifest = evidence.manifest
    builds = tuple(_note_move(build, by, manifest.align, lift) for build in manifest.builds)
    origins = list_origins(evidence.tiles, by, manifest.resolution)
    moved = _move_tiles(evidence.tiles, origins)
    slices = tuple(_move_slices(each, origins) for each in evidence.slices)
    manifest = replace(manifest, builds=builds)
    ground = evidence.ground and move_ground(evidence.ground, by, lift)
    return replace(evidence, manifest=manifest, tiles=moved, slices=slices, ground=ground)


def move_ground(ground: Ground, by: Transform, lift: float) -> Ground:
    """Move ground: each column takes the height of the one in which its middle was before.

    All of it is lifted (m).
    """
    layers = np.stack([ground.height_mm - NO_GROUND, ground.measured], axis=1)  # 0: nothing
    tiles = view_tiles(ground.blocks, layers.reshape(-1, 2, TILE, TILE))
    places, moved = stack_tiles(_move_tiles(tiles, list_origins(tiles, by, COLUMN_MM / 1000)))
    height, measured = moved.reshape(-1, 2, TILE * TILE).swapaxes(0, 1)
    lifted = np.where(height, height + NO_GROUND + round(lift * 1000), NO_GROUND)
    return Ground(places, lifted.astype(np.int32), measured > 0)


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


def _note_move(build: BuildRecord, by: Transform, align: float | None, lift: float) -> BuildRecord:
    """Say of a build that its cells were moved, and with which `transform` it would lie there."""
    options = build["options"]
    given = options["posing"].get("transform")
    pose = add_move(given and Pose(*given), by, align, lift)
    posing = {**options["posing"], "transform": write_value(pose)}
    return {**build, "options": {**options, "posing": posing}, "moved": list(by)}
