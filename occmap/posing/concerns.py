"""What spoils a map, said in one sentence, and the options that mend it."""

from collections.abc import Mapping
from typing import NamedTuple


class Concern(NamedTuple):
    """Something that its user should know before the map is used."""

    text: str
    remedy: Mapping[str, str] | None = {}
    """Options with the values that mend it; empty where the map is of use all the same, None where
    it is not and no option that is known makes it so"""
