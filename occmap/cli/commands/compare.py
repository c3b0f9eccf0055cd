"""`occmap compare`: several updates and sensor models in one read, scored on held-out scans."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.cli import COMMANDS, limits, log_options, options
from occmap.cli.console import Console, write_command
from occmap.cli.progress import show_progress
from occmap.cli.sections import SectionCommand, join, option
from occmap.cli.streams import gather_logs
from occmap.cli.values import PATH
from occmap.gates.measures import COMPARE
from occmap.keywords import take
from occmap.options import BuildOptions
from occmap.scoring.compare import VariantComparison, compare
from occmap.scoring.trials import Result
from occmap.scoring.variants import DEFAULT_MODELS, combine
from occmap.sensor.models import parse_model
from occmap.types import Update
from occmap.wording import count

HELP = f"""{COMMANDS["compare"]}

Every fifth scan is kept from the maps. Each map is then asked what these scans will see: the share
of beams whose first occupied cell is within two cells of the measured range, the log-likelihood of
the range, and the cross-entropy of the cells found free and found occupied. A share that is behind
by two standard errors or half a percent counts as good as the best; of those the default is named,
or the best log-likelihood. Where that is another one, it is named as well: its probabilities are
the ones to plan and localise with.

A table says whether the probabilities of the recommended map mean what they say: for cells of each
tenth of probability, the share that beams found occupied.

\b
  occmap compare drive.mcap
  occmap compare intel.log.gz -o compare.png --resolution 0.1
  occmap compare room.bag --update beam --model counting --model simple:p_hit=0.8
"""

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
        show_default="the usual one of each update, " + ", ".join(DEFAULT_MODELS),
        help="How evidence is weighed: see `occmap models`. May repeat.",
    ),
)
picture = options.one_output(
    "picture",
    "FILE",
    "Write all maps here: .png is a picture with where they disagree, .html a page.",
)


@click.command("compare", cls=SectionCommand, help=HELP, short_help=COMMANDS["compare"])
@click.argument("logs", nargs=-1, required=True, type=PATH, metavar="LOG...")
@join(variants, picture, options.lattice, log_options.ranges)
@join(log_options.selection, log_options.posing)
@join(limits.fail_if(COMPARE), options.jobs, options.config, options.as_json, options.verbosity)
@click.pass_obj
def command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> None:
    """Compare variants, and print the table."""
    models = [parse_model(text) for text in values["model_texts"]]
    chosen = combine([Update(text) for text in values["updates"]], models)
    common = take(BuildOptions, values)
    found = gather_logs(console, logs, common)
    with show_progress(console) as progress:
        comparison = compare(found, chosen, common, values["picture"], progress)
    console.note(*comparison.notes)
    lines = format_comparison(comparison)
    limits.leave(limits.answer(console, "compare", comparison, lines, values))


def format_comparison(comparison: VariantComparison) -> list[str]:
    """Write the table, on what it rests, and the command line of the best."""
    best, likeliest = comparison.recommended, comparison.likeliest
    preference = comparison.preference
    held = count(comparison.scans.held_out, "held-out scan")
    rest = f"scored by {count(best.score.beams, 'beam')} of {held}"
    lines = [
        *format_table(comparison.results),
        "",
        *format_reliability(best),
        "",
        f"{rest}; {comparison.scans.used:,} of {comparison.scans.read:,} used",
        *(f"picture: {file}" for file in comparison.files),
        *([f"as good within the error: {preference}"] if preference else []),
        f"best: {best.variant.name}",
        write_command(comparison.build_command(best)),
    ]
    if likeliest is not best:
        lines.append(f"where probabilities matter: {likeliest.variant.name}")
        lines.append(write_command(comparison.build_command(likeliest)))
    return lines


def format_reliability(result: Result) -> Iterator[str]:
    """Write what a map says of its cells over what beams found in them, a column for each bin."""
    yield f"cells of {result.variant.name}, as held-out beams look at them"
    columns = [
        ("predicted occupied", "found occupied", "looks"),
        *(
            (f"{each.predicted:.3f}", f"{each.observed:.3f}", f"{each.looks:,}")
            for each in result.score.reliability
        ),
    ]
    for row in range(3):
        cells = [f"{column[row]:>{max(map(len, column))}}" for column in columns]
        yield "  ".join([columns[0][row].ljust(len(cells[0])), *cells[1:]])


def format_table(results: Sequence[Result]) -> Iterator[str]:
    """Write a line for each variant, the best share first; entropy as free / occupied cells."""
    width = max(len(result.variant.name) for result in results)
    costs = "entropy (free, occupied)"
    yield f"{'variant':<{width}}   share   error  log-lik  {costs}    time   memory"
    for result in results:
        score = result.score
        costs = f"{score.cross_entropy:7.3f} ({score.free_cost:.3f}, {score.occupied_cost:.3f})"
        spent = f"{result.seconds:5.2f} s {result.bytes / 1e6:5.1f} MB"
        error = f"{score.share_error:.4f}" if math.isfinite(score.share_error) else "-"
        shares = f"{score.share:7.4f}  {error:>6}  {score.log_likelihood:7.3f}"
        yield f"{result.variant.name:<{width}} {shares}  {costs:<24} {spent:>16}"
