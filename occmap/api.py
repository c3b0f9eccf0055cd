"""What a notebook or a program calls: a map in one line, or a log to look into."""

from pathlib import Path
from typing import Any

from occmap.errors import UsageError
from occmap.pipeline import DEFAULT_UPDATE, BuildOptions, build, choose_model
from occmap.plugins import suggest
from occmap.readers import Log, open_log
from occmap.sensor.models import parse_model
from occmap.types import OccupancyMap, Update


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
        A log cannot be read, has no scans or no poses, an option is out of its range, or the map
        would be too large.
    """
    if not logs:
        raise UsageError("no log is given", fix='try build_map("drive.mcap")')
    if "update" in options:
        options["update"] = parse_update(options["update"])
    if isinstance(options.get("model"), str):
        options["model"] = parse_model(options["model"])
    elif "model" not in options:
        options["model"] = choose_model(options.get("update", DEFAULT_UPDATE))
    return build([Path(log) for log in logs], BuildOptions(**options)).map


def parse_update(name: str) -> Update:
    """Find an update by its name.

    Raises
    ------
    UsageError
        No update has that name.
    """
    known = [update.value for update in Update]
    if name not in known:
        fix = suggest(name, known, "occmap build --help")
        raise UsageError(f"no update is called {name!r}", fix=fix)
    return Update(name)


def read_log(path: str | Path) -> Log:
    """Open a recording of any installed format; iterate over its `scans` and `poses`.

    Raises
    ------
    LogError
        The path cannot be read, or no reader knows what it is.
    """
    return open_log(Path(path))
