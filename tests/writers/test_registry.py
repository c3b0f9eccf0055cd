from pathlib import Path

import pytest

from occmap import writers
from occmap.errors import UsageError
from occmap.writers import MapMode, Product, WriteOptions, find_writer, write_outputs
from occmap.writers.geotiff import GeoTiffWriter, GroundWriter
from occmap.writers.pgm import PgmWriter
from occmap.writers.png import PngWriter
from tests.writers.maps import map_of


@pytest.mark.parametrize(
    ("name", "writer", "targets"),
    [
        ("maps/a.b.pgm", PgmWriter, ["maps/a.b.pgm", "maps/a.b.yaml"]),
        ("MAP.PNG", PngWriter, ["MAP.PNG"]),
        ("a.ground.TIF", GroundWriter, ["a.ground.TIF"]),
        ("ground.tif", GroundWriter, ["ground.tif"]),
        ("a.underground.tif", GeoTiffWriter, ["a.underground.tif"]),
    ],
)
def test_the_longest_suffix_picks_the_writer_and_its_targets(
    name: str, writer: type, targets: list[str]
) -> None:
    found = find_writer(Path(name))
    assert isinstance(found, writer)
    assert found.targets(Path(name)) == tuple(map(Path, targets))


@pytest.mark.parametrize(
    ("name", "found"),
    [("map.jpg", "unknown suffix '.jpg'"), ("map", "no suffix"), ("map.", "no suffix")],
)
def test_unknown_suffix_lists_the_known_ones(name: str, found: str) -> None:
    with pytest.raises(UsageError, match=rf"{name}: .*{found}; occmap writes \.csv, \.ground\."):
        find_writer(Path(name))


def test_a_writer_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "load_plugin", lambda _group, _name: None)
    with pytest.raises(UsageError, match=r"the writer for \.png does not load"):
        find_writer(Path("map.png"))


class Foreign:
    """A plugin's writer that needs no class of occmap."""

    description = "a page"
    needs_evidence = True

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> tuple[Path, ...]:
        path.write_text(str(product.report))
        return (path,)


@pytest.mark.usefixtures("here")
def test_what_a_plugin_does_not_say_is_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "load_plugin", lambda _group, _name: Foreign)
    path, product = Path("m.png"), Product(map_of([[0.5]]), lambda: None, report=7)  # type: ignore[arg-type, return-value]
    writer = find_writer(path)
    assert writer.targets(path) == (path,)
    assert (writer.needs_evidence, writer.shows_journey, writer.is_folder) == (True, True, False)
    assert write_outputs([path], product, WriteOptions()) == ["m.png"]
    assert path.read_text() == "7"


@pytest.mark.parametrize(
    ("occupied", "free"),
    [(0.2, 0.6), (0.5, 0.5), (1.0, 0.2), (0.65, 0.0), (float("nan"), 0.2), (0.65, -1.0)],
)
def test_thresholds_out_of_order_name_the_options(occupied: float, free: float) -> None:
    with pytest.raises(UsageError, match=r"`occupied_thresh`.*`free_thresh`.*0 < free < occ"):
        WriteOptions(occupied_thresh=occupied, free_thresh=free)


def test_scale_needs_a_grey_between_the_thresholds() -> None:
    WriteOptions(MapMode.TRINARY, 0.5001, 0.5)
    with pytest.raises(UsageError, match=r"at least 0\.008 apart"):
        WriteOptions(MapMode.SCALE, 0.5001, 0.5)
