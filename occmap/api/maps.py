"""The map that a notebook gets: an occupancy map that knows how it came about and can be saved."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import Any, Self

from occmap.cells import Evidence, OccupancyMap
from occmap.choices.values import read_value
from occmap.errors import UsageError, refuse_exhaustion
from occmap.grid.lattice import CellBox
from occmap.grid.tiles import CellNumbers, EvidenceKind, TileGrid
from occmap.report.results import Build, Report
from occmap.types import Float64
from occmap.writers import Product, WriteOptions
from occmap.writers.outputs import check_outputs, write_outputs


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Map(OccupancyMap):
    """An occupancy map with its report and what was observed."""

    report: Report
    """Scans, beams, shares, and `notes`: what the command line prints beside the map"""
    writing: WriteOptions
    """How it is saved"""
    inputs: tuple[Path, ...]
    """The files it was made of, which are never written over"""
    tiles: TileGrid
    """What was observed, in tiles"""
    evidence: Evidence | None
    """What an .npz of it holds; None where the build was not asked for one"""

    @classmethod
    def of(cls, made: Build, writing: WriteOptions, inputs: Sequence[Path]) -> Self:
        """Add to a map what was found beside it, and how and over what it may be saved."""
        found: dict[str, Any] = {
            each.name: getattr(made.map, each.name) for each in fields(OccupancyMap)
        }
        found |= {"report": made.report, "tiles": made.observed, "evidence": made.evidence}
        return cls(**found, writing=writing, inputs=tuple(inputs))

    @property
    def hits(self) -> Float64:
        """(H, W): how many beams ended in each cell.

        The polygon update counts scans rather than beams. The beams that the surface update adds
        between two neighbours count as fractions of one.

        Raises
        ------
        UsageError
            The map was made with a model that sums up log-odds.
        """
        hits, _ = self._read_counts()
        return hits

    @property
    def misses(self) -> Float64:
        """(H, W): how many beams went through each cell; as `hits` otherwise."""
        _, misses = self._read_counts()
        return misses

    @refuse_exhaustion()
    def save(self, path: str | Path) -> tuple[Path, ...]:
        """Write the map; the suffix picks the format, such as .pgm (with its YAML).

        Returns
        -------
        tuple of Path
            The files that were written.

        Raises
        ------
        UsageError, OutputError
            No writer has that suffix, the path is an input of the map, the evidence was not kept
            (.npz), or the file cannot be written.
        """
        outputs = [read_value("path", Path, path)]
        check_outputs(outputs, self.inputs)
        product = Product(self, self._take_evidence, report=self.report)
        return tuple(map(Path, write_outputs(outputs, product, self.writing)))

    def __repr__(self) -> str:
        grid, scans = self.report.map, self.report.scans
        return (
            f"<Map of {grid.columns} x {grid.rows} cells of {grid.resolution:g} m: "
            f"{grid.occupied:.1%} occupied, {grid.free:.1%} free, {grid.unknown:.1%} unknown; "
            f"{scans.used:,} of {scans.read:,} scans used>"
        )

    def _repr_html_(self) -> str:
        """Show the probability as a small picture, dark is occupied, and the notes under it."""
        from occmap.scoring.picture import Frame, paint_map  # noqa: PLC0415  late: brings pillow
        from occmap.writers.images import encode_png  # noqa: PLC0415  late: likewise

        png = b64encode(encode_png(paint_map(self, Frame([self])))).decode()
        lines = [repr(self).strip("<>"), *self.report.notes]
        return f'<img src="data:image/png;base64,{png}"><br>' + "<br>".join(map(escape, lines))

    def _take_evidence(self) -> Evidence:
        if self.evidence is None:
            found = "this map did not keep when its cells were seen, which an .npz holds"
            raise UsageError(found, fix='build it with outputs="map.npz"')
        return self.evidence

    def _read_counts(self) -> CellNumbers:
        if self.tiles.kind is not EvidenceKind.COUNTS:
            name, _, _ = self.report.map.model.partition(":")
            found = f"the model {name} sums up log-odds: it keeps no hits and misses"
            raise UsageError(found, fix='build with model="counting" or model="simple"')
        return self.tiles.read(CellBox.of(self))
