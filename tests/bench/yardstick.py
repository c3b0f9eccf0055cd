"""The yardstick: the beam update cell by cell in dense arrays, in C++.

It begins with ranges and poses, as occmap's stages do, and must give occmap's own counts.
"""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from occmap.cells import CellBox
from tests.bench.workloads import Sensor, Workload

Counts = NDArray[np.int32]
Trace = Callable[[Workload, CellBox], tuple[Counts, Counts]]
"""From scans and the box that they lie in to (H, W) hits and misses."""

SOURCE = Path(__file__).with_name("yardstick.cpp")
PLAIN, TUNED = "C++ -O3", "C++ -O3 tuned"
AVX2 = "haswell"
"""What numba calls the processor of 2013 whose instructions (x86-64-v3) nearly all have since"""
ARCH = "-march=x86-64-v3" if os.environ.get("NUMBA_CPU_NAME") == AVX2 else "-march=native"
FLAGS = {PLAIN: ("-O3",), TUNED: ("-O3", ARCH, "-fno-math-errno")}
"""As a distribution builds its packages; and with the instructions that numba uses."""
LIBRARY_FLAGS = ("-ffp-contract=off", "-shared", "-fPIC")
"""A fused multiply-add would round differently from occmap and find other cells."""


def find_box(workload: Workload) -> CellBox:
    """The cells that no beam leaves: what a plain program is told beforehand."""
    reach = float(workload.ranges[workload.ranges < workload.sensor.range_max].max())
    low = (workload.poses[:, :2].min(axis=0) - reach) / workload.resolution
    high = (workload.poses[:, :2].max(axis=0) + reach) / workload.resolution
    (col, row), (col_end, row_end) = np.floor(low).astype(int) - 1, np.ceil(high).astype(int) + 2
    return CellBox(int(row), int(col), int(row_end), int(col_end))


def limits(sensor: Sensor) -> tuple[float, float]:
    """The nearest range that counts, and the first that no longer does, as float32."""
    nearest = np.maximum(np.float32(sensor.range_min), np.finfo(np.float32).tiny)
    return float(nearest), float(np.float32(sensor.range_max))


def compile_cpp(folder: Path) -> dict[str, Trace]:
    """Compile the C++ yardstick into a folder, with each set of flags; none where there is no g++.

    Raises
    ------
    subprocess.CalledProcessError
        The compiler is there and refuses.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        return {}
    traces = {}
    for name, flags in FLAGS.items():
        library = folder / f"{name.replace(' ', '')}.so"
        command = [compiler, *flags, *LIBRARY_FLAGS, str(SOURCE), "-o", str(library)]
        subprocess.run(command, check=True)
        traces[name] = _load(library)
    return traces


def _load(library: Path) -> Trace:
    trace = ctypes.CDLL(str(library)).trace
    pointer, whole, real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    of_sensor = (whole, real, real, ctypes.c_float, ctypes.c_float)
    of_grid = (real, whole, whole, whole, pointer, pointer)
    trace.argtypes, trace.restype = (pointer, pointer, whole, *of_sensor, *of_grid), None

    def trace_in_cpp(workload: Workload, box: CellBox) -> tuple[Counts, Counts]:
        ranges, poses = map(np.ascontiguousarray, (workload.ranges, workload.poses))
        hits, misses = np.zeros((2, *box.shape), np.int32)
        sensor = workload.sensor
        beams = sensor.beams, sensor.angle_min, sensor.angle_increment, *limits(sensor)
        place = workload.resolution, box.row, box.col, box.cols
        scans = ranges.ctypes.data, poses.ctypes.data, workload.scans
        trace(*scans, *beams, *place, hits.ctypes.data, misses.ctypes.data)
        return hits, misses

    return trace_in_cpp
