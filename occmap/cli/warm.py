"""Compile all kernels ahead, to ship them: `python -m occmap.cli.warm`."""

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.scoring import make_scans, score_map
from occmap.sensor.models import CountingModel, QuadraticModel, SensorModel
from occmap.types import BEAM_UPDATES

HEADER = "# angle_min: 0\n# angle_increment: 1\n# time_increment: 0.0001\nstamp,r0,r1\n"


def compile_kernels() -> None:
    """Build maps of few scans and of many by every update and kind of model, and score one."""
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


if __name__ == "__main__":
    compile_kernels()
