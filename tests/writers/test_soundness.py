"""Evidence with a checksum that fits, but of something that occmap never writes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import Evidence
from occmap.errors import MapError
from occmap.grid.tiles import EvidenceKind
from occmap.writers.npz import read_evidence
from occmap.writers.soundness import COUNTS, LOG_ODDS, list_faults
from tests.writers.test_npz import BUILD, MANIFEST, NO_SLICES, SELECTION, SMALL, write

LAYER = SMALL.slices[0]


def test_the_kinds_are_those_of_the_grid() -> None:
    assert list(EvidenceKind) == [COUNTS, LOG_ODDS]


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"resolution": 1},
        {"update": "polygon"},
        {"kind": "log_odds", "profile": "quadratic:epsilon=0.1"},
        {"subtracted": (BUILD,)},
        {"builds": ({**BUILD, "more": 1}, BUILD)},
    ],
)
def test_what_occmap_may_write_is_sound(changed: dict[str, Any]) -> None:
    cells = SMALL.cells.copy()
    cells[:, 1][cells[:, 0] != 0] += 1  # log-odds are those of an observation
    assert not list(list_faults(replace(SMALL, manifest=replace(MANIFEST, **changed), cells=cells)))


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"resolution": 0}, "its resolution is 0"),
        ({"resolution": -0.05}, "its resolution is -0.05"),
        ({"resolution": "0.05"}, "its resolution is '0.05'"),
        ({"kind": None}, "its kind is None"),
        ({"pass_gap_s": 0}, "its pass_gap_s is 0"),
        ({"pass_gap_s": "10"}, "its pass_gap_s is '10'"),
        ({"hit_offset": -0.5}, "its hit_offset is -0.5"),
        ({"align": None}, "its align is None"),
        ({"align": 400}, "its align is 400"),
        ({"update": "ray"}, "its update is 'ray'"),
        ({"model": 3}, "its model is 3"),
        ({"profile": "quadratic"}, "its profile is 'quadratic', and its kind counts"),
        ({"kind": "log_odds"}, "its profile is '', and its kind log_odds"),
        *(
            ({"builds": (build, BUILD)}, "its manifest does not say what it was made of")
            for build in (
                3,
                {},
                {**BUILD, "inputs": []},
                {**BUILD, "inputs": [{"name": "log.csv"}]},
                {**BUILD, "inputs": {"name": "log.csv", "sha256": "ab"}},
                {**BUILD, "options": {"selection": SELECTION, "posing": {"poses": 1}}},
                {**BUILD, "options": {"selection": {}, "posing": {"poses": None}}},
                {
                    **BUILD,
                    "options": {
                        "selection": {**SELECTION, "end_s": "soon"},
                        "posing": {"poses": None},
                    },
                },
                {**BUILD, "scans": {"read": 2, "used": 1, "dropped": {"x": "y"}, "beams": {}}},
                {**BUILD, "scans": {"read": 2, "used": 1, "dropped": [], "beams": {}}},
            )
        ),
        ({"subtracted": ("?",)}, "its manifest does not say what it was made of"),
    ],
)
def test_a_manifest_that_occmap_cannot_use_is_refused(
    tmp_path: Path, changed: dict[str, Any], fault: str
) -> None:
    refuse(tmp_path, replace(SMALL, manifest=replace(MANIFEST, **changed)), fault)


def refuse(folder: Path, evidence: Evidence, fault: str) -> None:
    path = write(folder / "m.npz", evidence)
    with pytest.raises(MapError) as caught:
        read_evidence(path)
    assert str(caught.value) == f"{path}: is not what occmap writes: {fault}; build it again"


@pytest.mark.parametrize(
    "tiles",
    [
        [[2, 3], [-1, 0]],
        [[2, 3], [2, 3]],
        [[2, 4], [2, 3]],
        [[-1, 0], [2, 2**38]],
        [[-(2**63), 0], [2, 3]],
    ],
)
def test_tiles_that_no_map_holds_or_that_come_twice_are_refused(
    tmp_path: Path, tiles: list[list[int]]
) -> None:
    fault = "its tiles are not in ascending order, or too far away"
    refuse(tmp_path, replace(SMALL, tiles=np.array(tiles)), fault)


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [("counts", (-1, 5)), ("counts", (1, -5)), ("log_odds", (1, -5)), ("log_odds", (-7, 0))],
)
def test_numbers_that_no_observation_makes_are_refused(
    tmp_path: Path, kind: str, numbers: tuple[int, int]
) -> None:
    cells = SMALL.cells.copy()
    cells[:, 1][cells[:, 0] != 0] += 1
    cells[0, :, 0, 0] = numbers
    manifest = replace(MANIFEST, kind=kind, profile="quadratic" if kind == "log_odds" else "")
    fault = "its cells hold what no observation makes"
    refuse(tmp_path, replace(SMALL, manifest=manifest, cells=cells), fault)


@pytest.mark.parametrize(
    "changed",
    [
        {"numbers": np.array([300, -7, 5])},
        {"numbers": np.array([300, 300, 5])},
        {"tiles": LAYER.tiles[::-1]},
        {"tiles": LAYER.tiles + np.array([0, 2**38])},
    ],
)
def test_slices_that_are_not_in_order_are_refused(tmp_path: Path, changed: dict[str, Any]) -> None:
    slices = (NO_SLICES, replace(LAYER, **changed))
    refuse(tmp_path, replace(SMALL, slices=slices), "its slices of time are not in order")


def test_a_tile_that_no_slice_observed_is_refused(tmp_path: Path) -> None:
    slices = (NO_SLICES, replace(LAYER, tiles=LAYER.tiles + np.array([0, 1])))
    refuse(tmp_path, replace(SMALL, slices=slices), "it lacks slices of time of some tiles")
