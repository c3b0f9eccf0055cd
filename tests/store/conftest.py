"""Blocks of 256 cells for all tests here: a block is packed as a whole, however little is in it."""

from collections.abc import Iterator

import pytest

from occmap import store
from occmap.store import painting, writing


def shrink_blocks(patch: pytest.MonkeyPatch) -> None:
    """Make blocks a quarter as long as they are for users."""
    for module in (store, painting, writing):
        patch.setattr(module, "BLOCK", 256, raising=False)
        patch.setattr(module, "SIDE", 4, raising=False)


@pytest.fixture(autouse=True, scope="package")
def _small_blocks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        shrink_blocks(patch)
        yield
