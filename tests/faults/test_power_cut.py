"""A power cut at any moment of a build that adds to evidence: what was not synced is gone."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.runner import occmap
from tests.faults.scene import read_folder, set_up

LOST = b""
"""A file whose content never reached the disk."""


class Disk:
    """What of a folder is on the disk: content by inode, and names, as they were last synced."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.content = {path.stat().st_ino: path.read_bytes() for path in folder.iterdir()}
        self.names = self.list_names()
        self.history: list[list[dict[str, bytes]]] = []

    def list_names(self) -> dict[str, int]:
        return {path.name: path.stat().st_ino for path in self.folder.iterdir()}

    def sync(self, descriptor: int) -> None:
        found = os.fstat(descriptor)
        if stat.S_ISDIR(found.st_mode):
            self.names = self.list_names()
        else:
            names = {inode: name for name, inode in self.list_names().items()}
            self.content[found.st_ino] = (self.folder / names[found.st_ino]).read_bytes()

    def remember(self) -> None:
        """Note what a power cut now could leave: names as synced, or as they have become since."""
        self.history.append(list(self.list_states()))

    def list_states(self) -> Iterator[dict[str, bytes]]:
        for names in (self.names, self.list_names()):
            yield {name: self.content.get(inode, LOST) for name, inode in names.items()}


@pytest.mark.parametrize("command", ["build resume", "build pgm", "merge"])
def test_no_power_cut_takes_a_file_and_none_takes_what_is_done(
    command: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, disk = set_up(here, command), Disk(here)
    plain_fsync, plain_replace = os.fsync, os.replace

    def fsync(descriptor: int) -> None:
        disk.remember()
        plain_fsync(descriptor)
        disk.sync(descriptor)
        disk.remember()

    def replace(old: Any, new: Any) -> None:
        disk.remember()
        plain_replace(old, new)
        disk.remember()

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    assert occmap(*scene.words).code == 0
    assert scene.is_done()
    disk.remember()
    targets = [name for name in scene.before if name.startswith("m.")]
    for states in disk.history:
        for state in states:
            for name in targets:
                assert state[name] in (scene.before[name], scene.after[name])
    assert disk.history[-1] == [read_folder(here)] * 2
    assert len(disk.history) > 4
