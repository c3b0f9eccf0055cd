"""What a sample of posed scans tells that no single scan does."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occmap.errors import MapError
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.sampling import encode_cells
from occmap.sensor.models import CountingModel
from occmap.sensor.returns import NoReturn, ReturnOptions, interpret
from occmap.tracing import make_engine
from occmap.types import Bool, Float64, Int64, Kind, PosedScans, as_float32

HIT_CELL_M = 0.2
MAX_REACH_M = 30.0
MAX_CROSSING_BEAMS = 2000
MIN_CROSSING_BEAMS = 50

MOST_CELLS = 10**8


def measure_crossing(parts: Sequence[PosedScans], options: ReturnOptions) -> float | None:
    """Measure how many beams without return would call free what other beams hit.

    Returns
    -------
    float or None
        Their share; None where there are too few such beams, or no distance up to which they would
        call space free.
    """
    options = replace(options, no_return=NoReturn.CLEAR)
    hits, origins, directions, reaches = [], [], [], []
    for part in parts:
        rays, _ = interpret(part, options)
        lost = (rays.kind == Kind.FREE) & is_lost(part, options)
        hits.append(rays.end[rays.kind == Kind.HIT])
        origins.append(np.broadcast_to(rays.origin, rays.direction.shape)[lost])
        directions.append(rays.direction[lost])
        reaches.append(rays.distance[lost])
    reach = np.concatenate(reaches or [np.zeros(0)])
    if len(reach) < MIN_CROSSING_BEAMS:
        return None
    some = np.linspace(0, len(reach) - 1, min(len(reach), MAX_CROSSING_BEAMS)).astype(np.int64)
    walls = encode_cells(np.concatenate(hits), HIT_CELL_M)
    ways = walk(np.concatenate(origins)[some], np.concatenate(directions)[some], reach[some])
    return float(np.isin(ways, walls).any(axis=1).mean())


def is_lost(part: PosedScans, options: ReturnOptions) -> Bool:
    """(S, B) whether nothing came back to a beam."""
    limit = part.batch.range_max if options.range_max is None else options.range_max
    lost: Bool = part.batch.ranges >= as_float32(limit)
    return lost


def walk(origin: Float64, direction: Float64, reach: Float64) -> Int64:
    """Number the cells (N, K) that beams (N,) pass; short beams repeat their last one."""
    far = np.minimum(reach, MAX_REACH_M)
    steps = np.minimum(np.arange(HIT_CELL_M, MAX_REACH_M, HIT_CELL_M), far[:, None] - HIT_CELL_M)
    return encode_cells(origin[:, None] + steps[..., None] * direction[:, None], HIT_CELL_M)


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    if not parts:
        return None
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None
