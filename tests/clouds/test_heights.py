"""Peaks of columns of heights, which the ground is found from."""

import numpy as np
import pytest

from occmap.clouds.kernels.heights import BIN_MM, BINS, list_peaks, pack


@pytest.mark.parametrize(
    ("counts", "heights"),
    [
        ({5: 50}, [5]),  # a floor without noise fills a single bin
        ({5: 25, 6: 25}, [5]),  # or two
        ({4: 10, 5: 30, 6: 10}, [5]),
        ({2: 20, 12: 20}, [2, 12]),  # a floor and what lies on it
        (dict.fromkeys(range(16), 5), []),  # a wall
    ],
)
def test_peaks_of_a_column(counts: dict[int, int], heights: list[int]) -> None:
    bins = np.zeros((1, BINS), np.int32)
    for height, points in counts.items():
        bins[0, height] = points
    column, found_mm, weight = np.empty(8, np.int64), np.empty(8, np.int32), np.empty(8, np.int32)
    found = list_peaks(np.array([pack(0, 3, 4, 0)]), bins, column, found_mm, weight)
    # A peak lies in its bin, or up to half a bin from its middle towards its neighbour.
    low = np.array(heights) * BIN_MM
    assert len(heights) == found
    assert ((found_mm[:found] >= low) & (found_mm[:found] <= low + 1.5 * BIN_MM)).all()
