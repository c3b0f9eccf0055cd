"""The page of one map, as `build` and `render` make it."""

from dataclasses import replace
from typing import Any

import numpy as np

from occmap.cells import Evidence
from occmap.evidence.manifest import list_inputs
from occmap.page.document import (
    Block,
    Page,
    Section,
    Stage,
    describe_maker,
    name_logs,
    tell_findings,
    tell_notes,
)
from occmap.page.raster import Packed, Raster, make_raster, pack
from occmap.page.views import (
    WAY_COLOURS,
    add_scan,
    add_way,
    describe_rasters,
    name_layers,
    plot_map,
)
from occmap.report.results import tell_beams, tell_map, tell_scans
from occmap.types import Journey
from occmap.writers import Product, WriteOptions

HIT_UNIT_M = 0.02
"""The hits of single scans are rounded to this."""


def describe_product(product: Product, options: WriteOptions) -> Page:
    """Lay out all that there is to show of a map, and all that is known beside it."""
    evidence, report = product.evidence(), product.report
    builds = evidence.manifest.builds
    logs = [entry["name"] for build in builds for entry in list_inputs(build)]
    rows, cols = product.grid.shape
    size = product.grid.resolution
    spread = f"{cols * size:.4g} x {rows * size:.4g} m"
    used = sum(build["scans"]["used"] for build in builds)
    subtitle = f"{spread}, {cols:,} x {rows:,} cells of {size:g} m, {used:,} scans"
    sections = []
    if report is not None:
        made = tell_map(report.map, report.looked_up)
        scans = [*tell_scans(report), *tell_beams(report)]
        sections += [
            Section("The map", [Block("facts", made)], wide=False),
            Section("Scans and beams", [Block("facts", scans)], wide=False),
            tell_notes(report),
        ]
    if product.inspect:
        sections += tell_findings(product.inspect())
    sections.append(describe_maker(entry for build in builds for entry in build["inputs"]))
    stage = stage_map(product, evidence, options)
    return Page(f"Map of {name_logs(logs)}", subtitle, sections, stage)


def stage_map(product: Product, evidence: Evidence, options: WriteOptions) -> Stage:
    """Set out a map, and what was recorded over it."""
    grid = replace(product.grid, decision=options.decide(product.grid.decision))
    raster = make_raster(grid, evidence)
    data, arrays = describe_rasters([raster], name_layers([raster]), grid.extent)
    plot = plot_map(0)
    journey = product.journey or Journey((), ())
    starts = [each.stamp_ns.min() for each in journey.trajectories if each.stamp_ns.size]
    start_ns = int(min(starts, default=raster.start_s * 1e9))
    if journey.trajectories:
        add_way(plot, journey.trajectories, start_ns)
        ends = [int(each.stamp_ns.max()) for each in journey.trajectories if each.stamp_ns.size]
        marks = f"{start_ns / 1e9:.3f} s", f"{max(ends) / 1e9:.3f} s"
        data["journey"] = {"ramp": (WAY_COLOURS[::4], *marks)}  # colours, and what is at their ends
    if journey.scans:
        add_scan(plot)
        scans, packed = pack_scans(journey)
        data["journey"] |= scans | {name: each.to_json() for name, each in packed.items()}
        arrays = {**arrays, **{name: each.text for name, each in packed.items()}}
    return Stage(
        plots=[plot],
        titles=[""],
        data=data,
        arrays=arrays,
        note=" ".join(list_losses(raster, product, evidence)),
    )


def list_losses(raster: Raster, product: Product, evidence: Evidence) -> list[str]:
    """Say what the page does not show as it is."""
    losses = []
    if raster.step > 1:
        losses.append(
            f"The map is too large for a page: of each {raster.step} x {raster.step} cells the one "
            "most likely occupied is shown."
        )
    if raster.rounding:
        losses.append(
            f"So that the page stays small, counts are off by up to {raster.rounding:.0%}."
        )
    if product.journey is None:
        losses.append("This map is of saved evidence, which does not keep where the robot went.")
    elif len(evidence.manifest.builds) > 1:
        losses.append(
            "The way and the scans are those of this build, without what it was added to."
        )
    return losses


def pack_scans(journey: Journey) -> tuple[dict[str, Any], dict[str, Packed]]:
    """Pack the hits of scans, and say when and where each was taken."""
    scans = sorted(journey.scans, key=lambda each: each.stamp_ns)
    hits = [np.concatenate([getattr(each, axis) for each in scans]) for axis in ("x", "y")]
    origin = [float(axis.min(initial=0)) for axis in hits]
    packed = {
        name: pack(np.rint((axis - low) / HIT_UNIT_M).astype(np.int64)[None])
        for name, axis, low in zip(("scan-x", "scan-y"), hits, origin, strict=True)
    }
    known = {
        "t": [round(each.stamp_ns / 1e9, 3) for each in scans],
        "ends": np.cumsum([len(each.x) for each in scans]).tolist(),
        "x": [round(each.origin[0], 3) for each in scans],
        "y": [round(each.origin[1], 3) for each in scans],
    }
    return {"scans": known, "origin": origin, "unit": HIT_UNIT_M}, packed
