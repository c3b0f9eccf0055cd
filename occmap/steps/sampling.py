"""A few hundred posed scans spread over a log: enough for what no single scan tells."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occmap.errors import MapError
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.readers import Log, read_recorded
from occmap.selection import Selection, Selector
from occmap.sensor.models import CountingModel
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import interpret
from occmap.steps.batching import batch_scans
from occmap.steps.engines import make_engine
from occmap.steps.opening import count_messages
from occmap.types import Float64, Int64, PosedScans

SAMPLE_SCANS = 300
"""About so many scans of each topic are kept, spread evenly over the log."""
MAX_SAMPLE_BEAMS = 1 << 19
"""No more scans are kept once their beams are so many: this bounds the memory."""
MOST_CELLS = 10**8
"""The largest map that is made of a sample"""


class Sample:
    """Takes every n-th scan of those that it is shown.

    Parameters
    ----------
    expected
        How many scans it will be shown, about; n follows from that.
    """

    def __init__(self, expected: int) -> None:
        self.parts: list[PosedScans] = []
        self._every = max(expected // SAMPLE_SCANS, 1)
        self._seen = 0
        self._beams = 0

    def take(self, posed: PosedScans) -> None:
        """Take scans of a batch."""
        scans, beams = posed.batch.ranges.shape
        rows = np.arange(-self._seen % self._every, scans, self._every)
        self._seen += scans
        if len(rows) and self._beams < MAX_SAMPLE_BEAMS:
            self._beams += len(rows) * beams
            self.parts.append(posed.take(rows))


def sample_scans(
    log: Log, topics: Sequence[str], poser: Poser, options: BuildOptions
) -> list[PosedScans]:
    """Pose some of the scans that a build uses, spread evenly over a log."""
    expected = expect_scans(count_messages(log, topics) // len(topics), options.selection)
    samples: defaultdict[str, Sample] = defaultdict(lambda: Sample(expected))
    selector = Selector(options.selection, options.posing.stamps)
    batches = batch_scans(read_recorded(log, topics), selector, RangeLimits(options.returns))
    for _, posed, _ in poser.attach(batches):
        if posed is not None:
            samples[posed.batch.topic].take(posed)
    return [part for sample in samples.values() for part in sample.parts]


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None


def expect_scans(scans: int, selection: Selection) -> int:
    """Estimate how many scans a sample will be shown; 0 for a part of a log, of which all are kept.

    How many scans lie between two times is not known before they are read.
    """
    is_part = math.isfinite(selection.start_s) or math.isfinite(selection.end_s)
    return 0 if is_part else scans // selection.stride


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) of a size (m) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    return np.asarray((cells[..., 0] << 32) + cells[..., 1])
