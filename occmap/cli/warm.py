"""Compile all kernels ahead, to ship them: `python -m occmap.cli.warm`."""

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.scoring import score_map
from occmap.scoring.compare import make_scans
from occmap.sensor.models import CountingModel, QuadraticModel, SensorModel
from occmap.types import BEAM_UPDATES

HEADER = "# angle_min: 0\n# angle_increment: 1\n# time_increment: 0.0001\nstamp,r0,r1\n"


def compile_kernels() -> None:
    """Build maps of few scans and of many by every update and kind of model, and score one."""
    compile_for_clouds()
    models: tuple[SensorModel, ...] = CountingModel(), QuadraticModel()
    choices = product((1, 500), BEAM_UPDATES, models, Deskew)
    with TemporaryDirectory(prefix="occmap-") as name:
        log, poses = Path(name) / "drive.csv", Path(name) / "drive.tum"
        for scans, update, model, deskew in choices:
            log.write_text(HEADER + "".join(f"{at / 1000},1,1\n" for at in range(scans)))
            poses.write_text("".join(f"{at / 1000} 0 0 0 0 0 0 1\n" for at in range(scans + 1)))
            posing = PosingOptions(poses=str(poses), deskew=deskew)
            options = BuildOptions(update=update, model=model, posing=posing, jobs=1)
            made = build([log], options, [Path(name) / "map.npz"])
    score_map(made.map, [make_scans(1)], jobs=1)


def compile_for_clouds() -> None:
    """Check clouds that show a wide floor and something on it, and build a map of them."""
    across, along = np.mgrid[-50:50, -50:50].reshape(2, -1) * 0.15
    points = np.stack([across, along, np.where(across > 7, 0.0, -0.6)], axis=1)
    with TemporaryDirectory(prefix="occmap-") as name:
        log, poses = Path(name) / "clouds", Path(name) / "drive.tum"
        log.mkdir()
        for at in range(2):
            np.save(log / f"{at}.npy", points.astype(np.float32))
        poses.write_text("".join(f"{at} 0 {at} 0 0 0 0 1\n" for at in range(2)))
        options = BuildOptions(posing=PosingOptions(poses=str(poses)), jobs=1)
        inspect([log], options)
        build([log], options, [Path(name) / "map.npz"])


if __name__ == "__main__":
    compile_kernels()
