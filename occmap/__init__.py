"""occmap: 2D occupancy grid maps from recorded laser scans with known poses.

Public names are imported when they are first used: the command line imports this package as well,
and its help must not wait for NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from occmap.api import (
        Map,
        build_map,
        check,
        compare,
        diff,
        explain,
        merge,
        read_log,
        score,
        tune,
    )
    from occmap.cells import OccupancyMap
    from occmap.errors import OccmapError
    from occmap.options import BuildOptions
    from occmap.pipeline import build
    from occmap.readers import Log
    from occmap.report.results import Build

    __version__: str

__all__ = [
    "Build",
    "BuildOptions",
    "Log",
    "Map",
    "OccmapError",
    "OccupancyMap",
    "__version__",
    "build",
    "build_map",
    "check",
    "compare",
    "diff",
    "explain",
    "merge",
    "read_log",
    "score",
    "tune",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name == "__version__":
        value: Any = import_module("importlib.metadata").version("occmap")
    elif name in __all__:
        home = "errors" if name == "OccmapError" else "api"  # which imports all the others
        value = getattr(import_module(f"occmap.{home}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
