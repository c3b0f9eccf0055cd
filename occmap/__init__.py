"""occmap: 2D occupancy grid maps from recorded laser scans with known poses."""

from pathlib import Path
from typing import Any

from occmap.errors import OccmapError
from occmap.pipeline import Build, BuildOptions, build
from occmap.readers import Log, open_log
from occmap.sensor.models import parse_model
from occmap.types import OccupancyMap, Update

__all__ = [
    "Build",
    "BuildOptions",
    "Log",
    "OccmapError",
    "OccupancyMap",
    "build",
    "build_map",
    "read_log",
]


def build_map(*logs: str | Path, **options: Any) -> OccupancyMap:
    """Build one occupancy map from all usable scans of one or more logs.

    Parameters
    ----------
    logs
        Paths to recordings of any installed format.
    options
        Fields of `BuildOptions`; `update` and `model` may be text, such as "beam" and
        "simple:p_hit=0.8".

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, or the map would be too large.
    """
    if "update" in options:
        options["update"] = Update(options["update"])
    if isinstance(options.get("model"), str):
        options["model"] = parse_model(options["model"])
    return build([Path(log) for log in logs], BuildOptions(**options)).map


def read_log(path: str | Path) -> Log:
    """Open a recording of any installed format; iterate over its `scans` and `poses`.

    Raises
    ------
    LogError
        The path cannot be read, or no reader knows what it is.
    """
    return open_log(Path(path))
