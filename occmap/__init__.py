"""occmap: 2D occupancy grid maps from recorded laser scans with known poses.

What is public is imported on first use: the command line imports this package, too, and its
`--help` must not wait for NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from occmap.api import build_map, read_log
    from occmap.errors import OccmapError
    from occmap.pipeline import Build, BuildOptions, build
    from occmap.readers import Log
    from occmap.types import OccupancyMap

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

_HOMES = {
    "Build": "occmap.pipeline",
    "BuildOptions": "occmap.pipeline",
    "Log": "occmap.readers",
    "OccmapError": "occmap.errors",
    "OccupancyMap": "occmap.types",
    "build": "occmap.pipeline",
    "build_map": "occmap.api",
    "read_log": "occmap.api",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
