"""The outputs that a user names: found to be writable before the work starts, written after it."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

from occmap.errors import OutputError, UsageError
from occmap.plugins import list_plugins, load_plugin
from occmap.writers import (
    AnyWriter,
    EvidenceWriter,
    FolderWriter,
    MapMode,
    Product,
    ProductWriter,
    Shade,
    WriteOptions,
)
from occmap.writers.atomic import check_parent, check_target, follow_links


def find_writer(path: Path) -> AnyWriter:
    """Find the writer for a file name by its suffix, upper or lower case.

    Raises
    ------
    UsageError
        No installed writer has that suffix, or it does not load.
    """
    known = [entry.name for entry in list_plugins("occmap.writers")]
    name = path.suffix.lower().removeprefix(".")
    listing = "occmap writes " + ", ".join(f".{each}" for each in known)
    if name not in known:
        found = f"unknown suffix {path.suffix!r}" if name else "the file name has no suffix"
        raise UsageError(found, where=path, fix=listing)
    writer_class = load_plugin("occmap.writers", name)
    if writer_class is None:
        raise UsageError(f"the writer for .{name} does not load", where=path, fix=listing)
    return cast(AnyWriter, writer_class())


def check_outputs(outputs: Sequence[Path], inputs: Sequence[Path] = ()) -> None:
    """Find out before the work starts what could not be written after it.

    Raises
    ------
    UsageError, OutputError
        A suffix that no writer has, two outputs that are one file, a file that cannot be made, or
        one that is an input.
    """
    writers = [(path, find_writer(path)) for path in outputs]
    targets = [(target, writer) for path, writer in writers for target in writer.targets(path)]
    files = [follow_links(target) for target, _ in targets]
    for (target, writer), file in zip(targets, files, strict=True):
        if not isinstance(writer, FolderWriter):
            check_target(target)
        elif file.exists() and not (file.is_dir() and writer.owns(file)):
            found = "is there already, and not as occmap writes it"
            raise OutputError(found, where=target, fix="give another name")
        else:
            check_parent(target, file.parent)
        refuse_input(target, inputs)
        if files.count(file) > 1:
            found = "would be written twice"
            raise UsageError(found, where=target, fix="give each output its own name")


def check_picture(
    path: Path | None, inputs: Sequence[Path], suffixes: Sequence[str] = (".png", ".html")
) -> None:
    """Find out before the work starts whether a picture, if there is one, cannot be written.

    Raises
    ------
    UsageError, OutputError
        It is to be something else, cannot be made, or is an input.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        names = " or ".join(suffixes)
        raise UsageError("is not a picture", where=path, fix=f"give it a name that ends in {names}")
    check_outputs([path], inputs)


def refuse_input(target: Path, inputs: Sequence[Path]) -> None:
    """Refuse to write over what the same command reads.

    Raises
    ------
    UsageError
        The target is an input, under whatever name.
    """
    for path in inputs:
        if path.exists() and target.exists() and target.samefile(path):
            found = "is an input: it would be overwritten"
            raise UsageError(found, where=target, fix="give another name")


def want_evidence(outputs: Sequence[Path]) -> bool:
    """Whether any output is of what was observed, or shows when it was."""
    return any(
        isinstance(writer, EvidenceWriter)
        or (isinstance(writer, ProductWriter) and writer.needs_evidence)
        for writer in map(find_writer, outputs)
    )


def want_journey(outputs: Sequence[Path]) -> bool:
    """Whether any output shows where the robot went."""
    return any(isinstance(find_writer(path), ProductWriter) for path in outputs)


def list_idle(outputs: Sequence[Path], options: WriteOptions) -> Iterator[str]:
    """Say which options do nothing, since no output is of the format that they are for."""
    if not outputs:  # a map that is saved later, in whatever format
        return
    suffixes = {path.suffix.lower() for path in outputs}
    if options.mode is not MapMode.TRINARY and suffixes.isdisjoint({".pgm", ".mcap"}):
        yield f"`mode={options.mode}` does nothing: it is for .pgm and .mcap, and no output ends so"
    if options.shade is not Shade.DARK_OCCUPIED and ".png" not in suffixes:
        yield "`shade` does nothing: it is for a PNG, and no output ends in .png"


def write_outputs(outputs: Sequence[Path], product: Product, options: WriteOptions) -> list[str]:
    """Write a map, or its evidence, in the formats of these suffixes; return the files written.

    Raises
    ------
    OutputError
        A file cannot be written; the one at fault is not left behind.
    """
    files: list[Path] = []
    for path in outputs:
        writer = find_writer(path)
        if isinstance(writer, EvidenceWriter):
            files += writer.write_evidence(path, product.evidence())
        elif isinstance(writer, ProductWriter):
            files += writer.write_product(path, product, options)
        else:
            files += writer.write(path, product.grid, options)
    return [str(file) for file in files]
