"""`occmap compare`: several updates and sensor models in one read, scored on held-out scans."""

from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli import options
from occmap.cli.answers import Answer, answering, fail_if
from occmap.cli.console import Console, align, write_command
from occmap.cli.progress import show_progress
from occmap.cli.sections import join, option
from occmap.cli.streams import gather_logs
from occmap.gates import COMPARE
from occmap.options import BuildOptions
from occmap.pictures import compare_logs
from occmap.scoring.compare import SCORES, VariantComparison, list_scores
from occmap.scoring.variants import DEFAULT_MODELS, combine
from occmap.sensor.models import parse_model
from occmap.types import Update
from occmap.wording import count

VARIANTS = "What to compare"

variants = join(
    option(
        VARIANTS,
        "--update",
        "updates",
        type=click.Choice([update.value for update in Update]),
        multiple=True,
        show_default="all",
        help="How a scan becomes observations. May repeat.",
    ),
    option(
        VARIANTS,
        "--model",
        "model_texts",
        multiple=True,
        metavar="NAME[:KEY=NUMBER,...]",
        show_default="the default of each update, " + ", ".join(DEFAULT_MODELS),
        help="How evidence is weighed: see `occmap models`. May repeat.",
    ),
)
picture = options.one_output(
    "picture",
    "FILE",
    "Write all maps here: .png is a picture with where they disagree, .html a page.",
)


@answering("compare", VariantComparison)
@click.argument("logs", nargs=-1, required=True, type=options.PATH, metavar="LOG...")
@join(variants, picture, options.lattice, options.reading)
@join(fail_if(COMPARE, "share < 70%"), options.jobs, options.config, options.printing)
def command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Say which update and sensor model suits logs best.

    Every fifth scan is held out, and each map is scored on these scans: by the share of beams whose
    first occupied cell is within two cells of the measured range, by the log-likelihood of the
    range, and by the cross-entropy of the cells found free and found occupied. A share that is
    behind the best by less than two standard errors, or by less than half a percent, counts as
    equally good. Of those that are equally good the default is recommended. The one with the best
    log-likelihood is named, too: its probabilities are the ones to plan and localise with.

    A table says whether the probabilities of the recommended map mean what they say: for the cells
    of each tenth of probability, the share that beams found occupied.

      occmap compare drive.mcap
      occmap compare intel.log.gz -o compare.png --resolution 0.1
      occmap compare room.bag --update beam --model counting --model simple:p_hit=0.8
    """
    models = [parse_model(text) for text in values["model_texts"]]
    chosen = combine([Update(text) for text in values["updates"]], models)
    common = take(BuildOptions, values)
    found = gather_logs(console, logs, common)
    with show_progress(console) as progress:
        comparison = compare_logs(found, chosen, common, values["picture"], progress)
    return Answer(comparison, format_comparison(comparison))


def format_comparison(comparison: VariantComparison) -> list[str]:
    """Write the table, on what it rests, and the command line of the best."""
    best, scans = comparison.recommended, comparison.scans
    beams, held = count(best.score.beams, "beam"), count(scans.held_out, "held-out scan")
    bins = best.score.reliability
    reliability = [
        ("predicted occupied", *(f"{each.predicted:.3f}" for each in bins)),
        ("found occupied", *(f"{each.observed:.3f}" for each in bins)),
        ("looks", *(f"{each.looks:,}" for each in bins)),
    ]
    lines = [
        *align([SCORES, *map(list_scores, comparison.results)], labels=1),
        "",
        f"cells of {best.name}, as held-out beams look at them",
        *align(reliability, labels=1),
        "",
        f"scored by {beams} of {held}; {scans.used:,} of {scans.read:,} used",
        *(f"picture: {file}" for file in comparison.files),
    ]
    if comparison.preference:
        lines.append(f"as good within the error: {comparison.preference}")
    lines += [f"best: {best.name}", write_command(comparison.command)]
    if comparison.likeliest is not best:
        lines.append(f"where probabilities matter: {comparison.likeliest_name}")
        lines.append(write_command(comparison.likeliest_command))
    return lines
