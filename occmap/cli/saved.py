"""What the commands on saved evidence share: writing what it makes, and saying so."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli.answers import Answer
from occmap.cli.console import Console, label_first, write_rows
from occmap.cli.options import Values, collect_model
from occmap.cli.streams import hide_sent, place_outputs
from occmap.errors import UsageError
from occmap.evidence import Described, read_model
from occmap.sensor.models import PARAMETERS, SensorModel
from occmap.store.publishing import RenderOptions, publish
from occmap.store.reading import Saved
from occmap.summary import tell_map, tell_scans
from occmap.writers.outputs import check_outputs


def put_out(
    console: Console, inputs: Sequence[Path], read: Callable[[], Saved], values: dict[str, Any]
) -> Answer:
    """Render evidence, write it as the user wants, and sum it up.

    Raises
    ------
    OccmapError
        No output is given, or, before anything is read, one that cannot be made or is an input;
        or the evidence cannot be rendered.
    """
    if not values["outputs"]:
        command = click.get_current_context().info_name
        example = "merged.npz" if command == "merge" else "map.pgm"
        raise UsageError("where to write is not given", fix=f"add -o {example}")
    outputs = place_outputs(console, values["outputs"], inputs[0])
    check_outputs(outputs, inputs)
    evidence = read()
    options = take(RenderOptions, {**values, "model": choose_saved_model(evidence, values)})
    report = hide_sent(publish(evidence, options, outputs))
    rows = [*tell_map(report.map), *tell_scans(report), *label_first("files", report.files)]
    return Answer(report, write_rows(rows))


def choose_saved_model(evidence: Described, values: Values) -> SensorModel | None:
    """Make the model that the user wants, if any; a shorthand changes the one of the evidence.

    Raises
    ------
    UsageError
        No such model, or a parameter that it does not have or allow.
    """
    if all(values.get(name) is None for name in ("model", *PARAMETERS)):
        return None
    return collect_model(values, read_model(evidence))
