"""The whole tool on one page: logs in, an occupancy map and a report out."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from occmap import writers
from occmap.cells import Evidence, Manifest
from occmap.choices import take
from occmap.clouds import LOCAL
from occmap.errors import MapError, name_log, refuse_failures
from occmap.evidence import UNEVEN_SHARE, count_steady, refuse_other
from occmap.evidence import manifest as manifests
from occmap.options import BuildOptions
from occmap.readers import Role
from occmap.report import results
from occmap.report.results import Build, MapFacts, Report, Resumed
from occmap.scans import Keep
from occmap.scans.align import settle_align
from occmap.scans.logs import suit_kinds
from occmap.scans.tally import Tally, refuse_unseen, refuse_unused
from occmap.scans.tracing import Observe, Observed, Progress, ignore_progress
from occmap.scans.tracing import observe as observe_here
from occmap.store import Blocks, open_saved, read_all
from occmap.store.merging import add, refuse_unlike
from occmap.store.painting import RenderOptions, paint_saved, sum_scans
from occmap.types import Journey, Paths, Update
from occmap.writers.atomic import hold_alone


@refuse_failures()
def build(
    paths: Paths,
    options: BuildOptions,
    outputs: Paths = (),
    progress: Progress = ignore_progress,
    observe: Observe = observe_here,
) -> Build:
    """Build one map from all usable scans of one or more logs, and write it.

    Parameters
    ----------
    observe
        Who traces the scans: this process, or the workers of an `occmap.fleet.Fleet`.

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, the map would be too large, or an output
        cannot be written.
    """
    writers.check_outputs(outputs, list_input_files(paths, options), options.writing)
    with hold_alone(options.resume or options.resume_if_there, outputs):
        past, options, fitted = open_past(
            paths, options, lambda options: observe(paths, options, Keep(), progress)
        )
        options, unaligned = settle_align(paths, options)
        options, keep = choose_keep(options, outputs, past)
        seen, tally, options = observe(paths, options, keep, progress)
        evidence = add_past(seen, past, options)
        refuse_unused(tally)
        refuse_unseen(tally, evidence.tiles)

        with tally.time("render"):
            saved, how = Blocks.of(evidence), take(RenderOptions, vars(options))
            whole, names = writers.want_whole(outputs), [path.name for path in paths]
            grid, facts = paint_saved(saved, options.model, how, whole, names)
            facts = facts._replace(steady=count_steady(evidence.tiles if tally.points else {}))
        with tally.time("write"):  # to hash the logs takes time
            # Notes compare logs that may be one with another, and builds.
            is_compared = past or len(set(map(manifests.measure_files, paths))) < len(paths)
            is_told = writers.want_evidence(outputs) or is_compared
            logs = manifests.describe_files(*paths)
            made = [manifests.describe_build(logs, options, tally.to_json())] if is_told else []
        builds = *evidence.manifest.builds, *made
        evidence = replace(evidence, manifest=replace(evidence.manifest, builds=builds))
        tally.notes += unaligned + fitted
        report = replace(
            make_report(options, outputs, tally, facts, evidence.manifest),
            resumed=describe_past(past),
        )

        # A fleet's logs are not inspected: this process would have to read them all again.
        check = partial(inspect_logs, paths, options) if observe is observe_here else None
        with tally.time("write"):
            way = Journey(tuple(tally.trajectories), tuple(tally.shown)) if keep.journey else None
            product = writers.Product(grid, lambda: evidence, way, report, check)
            files = writers.write_outputs(outputs, product, options.writing)
        report = replace(report, files=tuple(files), seconds=tally.list_seconds())
        return Build(grid, report, evidence)


def list_input_files(paths: Paths, options: BuildOptions) -> list[Path]:
    """List the files that a build reads, which nothing may write over."""
    inputs = [*paths, *options.posing.files]
    bags = [path / "metadata.yaml" for path in inputs]  # of a folder that is a bag
    bags += [storage for path in inputs if path.is_dir() for storage in path.glob("*.mcap")]
    return [*inputs, *bags]


def open_past(
    paths: Paths, options: BuildOptions, observe: Callable[[BuildOptions], Observed]
) -> tuple[Evidence | None, BuildOptions, list[str]]:
    """Read the evidence that a build is to be added to, if there is any.

    Where the user names no angle, the options turn the map as that evidence is turned; where the
    logs are to be fitted to it, they move them, and a note says how.

    Raises
    ------
    OccmapError
        It cannot be read, or cannot be combined with what the build makes; or it is not sure where
        the logs lie on it.
    """
    there = options.resume_if_there
    path = options.resume or (there if there and there.exists() else None)
    if path is None:
        return None, options, []
    past = read_all(open_saved(path))
    if options.posing.align is None:
        options = replace(options, posing=replace(options.posing, align=past.manifest.align))
    if past.manifest.update == Update.CLOUD:
        options = suit_kinds({Role.CLOUD: past.where}, options)
    refuse_unlike(manifests.plan_manifest(options), past)
    if not options.fit:
        return past, options, []
    from occmap.scoring.matching import fit_logs  # noqa: PLC0415  late: few builds want it

    options, note = fit_logs(paths, options, past, observe)
    return past, options, [note]


def choose_keep(
    options: BuildOptions, outputs: Paths, past: Evidence | None
) -> tuple[BuildOptions, Keep]:
    """Choose what is kept of a build beside its tiles, and the ground that clouds are traced over.

    That ground is the one that the user names, or that of the evidence which the build is added to.
    Where the user names no angles, the options level the map as that one is levelled.

    Raises
    ------
    MapError
        The file of the ground cannot be read, has none, or another than the evidence.
    """
    slices = options.min_passes is not None or writers.want_evidence(outputs)
    path = options.clouds.file
    below = past if path is None else read_all(open_saved(path))
    ground = below.ground if below else None
    if path is not None and ground is None:
        raise MapError("has no ground: its evidence is not of clouds", where=path)
    if below and ground is not None and options.posing.level is None:
        builds = below.manifest.builds
        level = builds[0]["options"]["posing"].get("level") if builds else None
        options = replace(options, posing=replace(options.posing, level=level and tuple(level)))
    if past and past.ground and ground and path is not None:
        fix = f"leave out `ground`: that of {past.where} goes on by itself"
        with name_log(path):
            refuse_other(past.ground.measure_rise(ground), UNEVEN_SHARE, None, fix)
    return options, Keep(slices, writers.want_journey(outputs), ground)


def add_past(seen: Evidence, past: Evidence | None, options: BuildOptions) -> Evidence:
    """Add what a build observed to the evidence that it goes on from; notes say what does not fit.

    Raises
    ------
    MapError
        It is evidence of another kind: only the logs say if they hold clouds.
    """
    if past is None:
        return seen
    # Unless the user names another one, the ground of the build grew from that of the evidence.
    ground = None if options.clouds.ground in {None, LOCAL} else past.ground
    manifest = replace(past.manifest, model=seen.manifest.model)
    return add(replace(past, manifest=manifest, ground=ground), seen, options.model)


def inspect_logs(paths: Paths, options: BuildOptions) -> Any:
    """Inspect the logs as `occmap check` does."""
    from occmap.inspection import inspect  # noqa: PLC0415  late: few builds want it

    return inspect(paths, options)


def describe_past(past: Evidence | None) -> Resumed | None:
    """Describe the evidence that a build was added to, if there is any."""
    before = sum_scans(past.manifest.builds if past else ())
    return Resumed(past.where, before.read, before.used) if past else None


def make_report(
    options: BuildOptions, outputs: Paths, tally: Tally, facts: MapFacts, manifest: Manifest
) -> Report:
    """Sum up a build, of which evidence has this manifest, and say what there is to know of it."""
    hint = results.hint_at_tune(facts.agreement, tally.logs, options)
    told = *facts.lost, *manifests.list_doubts(manifest)
    return Report(
        logs=tuple(tally.logs),
        scans=tally.scans,
        beams=tally.beams,
        points=tally.points,
        map=results.MapSummary.describe(facts, manifest, options.min_passes),
        notes=(*tally.notes, *told, *results.list_notes(options, outputs, tally, facts)),
        seconds=tally.list_seconds(),
        hint=hint if tally.looked_up else "",
    )
