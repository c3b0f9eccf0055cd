"""Evidence added up and taken apart again, exactly, over one ground."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import TypeAlias

import numpy as np

from occmap.cells import Evidence, Ground, Manifest, stack_tiles
from occmap.errors import MapError, name_log
from occmap.evidence import Described, list_misfit, read_model, refuse_other, to_grid
from occmap.evidence.manifest import MEANING, leave_out
from occmap.grid import tiles
from occmap.grid.tiles import EvidenceKind, TileGrid
from occmap.report import count
from occmap.sensor.models import SensorModel
from occmap.store import Blocks, join_blocks, open_saved, read_all
from occmap.store.layout import Block
from occmap.types import Pose

UNEVEN_SHARE = 0.05
"""Noise of poses makes some such columns; more than this share of them is a different ground."""


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
    placed = builds[-1]["options"]["posing"]["transform"] if builds else None
    fix = "build it over the ground of the other one: `ground=first.npz`"
    with name_log(evidence.where):
        refuse_other(ground.measure_rise(other), UNEVEN_SHARE, placed and Pose(*placed), fix)
    blocks = np.unique(np.concatenate([ground.blocks, other.blocks]), axis=0)
    mine, its = ground.lay_out(blocks), other.lay_out(blocks)
    known = mine.measured | ((mine.height_mm > its.height_mm) & ~its.measured)
    height = np.where(known, mine.height_mm, its.height_mm)
    return Ground(blocks, height, mine.measured | its.measured)


Lay: TypeAlias = Callable[[Evidence, Evidence], Evidence]
"""Moves evidence onto other evidence"""


def combine(added: Sequence[Path], taken: Sequence[Path] = (), lay: Lay | None = None) -> Blocks:
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
    refuse_different(mine, other)
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
    refuse_different(evidence.manifest, other)
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
    return Evidence(manifest, grid.tiles, left, ground=evidence.ground)


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


def refuse_different(manifest: Manifest, other: Described) -> None:
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
