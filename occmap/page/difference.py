"""The page of a difference: what changed, before, and after, by a switch."""

from pathlib import Path

import numpy as np

from occmap.difference import COLOURS, NEITHER, MapDifference
from occmap.evidence.manifest import describe_files
from occmap.grid.lattice import CellBox
from occmap.page.document import Block, Page, Section, Stage, describe_maker, write_page
from occmap.page.layers import CLASS_COLOURS, Layer, describe_rasters
from occmap.page.plots import plot_map
from occmap.page.raster import MOST_CELLS, Layers, Raster, pack, thin
from occmap.report.words import write_box

CLASSES = ("unknown", "free", "occupied")


def write_difference(path: Path, difference: MapDifference, maps: tuple[Path, Path]) -> None:
    """Write the page of a difference between two maps.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    before, after = maps
    changed = f"{difference.changed_cells:,} cells changed, {difference.share:.3%}"
    subtitle = f"{changed} of {difference.known:,} known ones"
    rows = [
        (name.replace("neither", CLASSES[NEITHER]), f"{cells:,}")
        for name, cells in difference.changed.items()
        if cells
    ]
    facts = [("before", str(before)), ("after", str(after))]
    facts.append((CLASSES[NEITHER], "or undecided: what is neither occupied nor free"))
    if blob := difference.largest:
        facts.append(("largest", f"{blob.cells:,} connected cells, {write_box(blob.extent)}"))
    blocks = [Block("facts", facts), Block("table", rows, ("what changed", "#cells"))]
    inputs = [entry for each in maps for entry in describe_files(each)]
    sections = [Section("Changes", blocks), describe_maker(inputs)]
    title = f"From {before.name} to {after.name}"
    write_page(path, Page(title, subtitle, sections, stage(difference)))


def stage(difference: MapDifference) -> Stage:
    """Set out the changes and both maps in one place."""
    table = np.zeros((3, 3), np.uint8)
    for code, pair in enumerate(COLOURS):
        table[pair] = code
    layers: Layers = {
        "change": table[difference.before, difference.after],
        "before": difference.before,
        "after": difference.after,
    }
    step = 1
    while layers["change"].size > MOST_CELLS * step**2:
        step *= 2
    place = difference.place
    shown = thin(layers | {"rank": layers["change"]}, step)  # of each block one that changed
    packed = {name: pack(shown[name]) for name in layers}
    raster = Raster(place.x, place.y, place.resolution * step, step, packed, 0.0)
    box = place.measure(CellBox(0, 0, *difference.before.shape))
    data, arrays = describe_rasters([raster], list_layers(), box)
    note = f"Of each {step} x {step} cells the one that changed most is shown."
    return Stage([plot_map(0)], [""], data, arrays, note=note if step > 1 else "")


def list_layers() -> list[Layer]:
    """How changes and classes are coloured."""
    names = [
        CLASSES[now] if was == now else f"{CLASSES[was]} to {CLASSES[now]}" for was, now in COLOURS
    ]
    of_classes = [CLASS_COLOURS[0], CLASS_COLOURS[1], CLASS_COLOURS[3]]
    changed = [
        "#{:02x}{:02x}{:02x}".format(*rgb) for (was, now), rgb in COLOURS.items() if was != now
    ]
    return [
        Layer("change", "change", "classes", [*of_classes, *changed], names),
        Layer("before", "before", "classes", of_classes, CLASSES),
        Layer("after", "after", "classes", of_classes, CLASSES),
    ]
