"""`sfr bench`: compare methods on the same input in the same run, and test our localiser with injected faults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from typer import Context, Option

from sfr_loc_map.cli.app import command_group, examples, propose
from sfr_loc_map.cli.options import (
    SCORE,
    ConditionOption,
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    SpacingOption,
    announced_config,
    option_names,
    refuse_given,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, claim_outputs, counting, progress_bar, say, show
from sfr_loc_map.cli.verdict import check_conditions
from sfr_loc_map.errors import FailedVerdictError, InputError, InterruptedRunError, NotJudgedError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.suite_names import Task

if TYPE_CHECKING:
    from sfr_loc_map.bench.method_benchmark import MethodBenchmark
    from sfr_loc_map.tables.model import Table

group = command_group("Compare methods on the same input in separate processes. Test ours with injected faults.")


MethodsOption = Annotated[
    list[str] | None,
    Option("--method", metavar="NAME|package.module:Class|lib:FILE.so", help="Additional method; repeatable."),
]
PeerOption = Annotated[
    Path | None, Option(metavar="PYTHON", help="Python interpreter with the optional reference methods.")
]
RepeatOption = Annotated[int, Option(min=1, metavar="N", help="Number of passes; medians are shown.")]


@group.command(epilog=examples("sfr bench localise data/ --repeat 3 --json bench.json"))
def localise(
    context: Context,
    source: SourceArgument,
    method: MethodsOption = None,
    peer_python: PeerOption = None,
    vocabulary: Annotated[
        Path | None, Option("--vocab", metavar="F.txt", help="ORB-SLAM3 vocabulary (text file).")
    ] = None,
    conditions: ConditionOption = None,
    spacing: SpacingOption = SCORE.trajectory.spacing,
    rate: Annotated[
        float | None,
        Option(
            min=0.01,
            metavar="HZ",
            help="Rate of the pairs for methods that work in the background; default: the recorded rate.",
        ),
    ] = None,
    repeat: RepeatOption = 3,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Compare our localiser with a plain OpenCV localiser, ORB-SLAM3 (pyorbslam3) if installed, and other methods."""
    from sfr_loc_map.bench.method_benchmark import compare_methods, methods_to_compare
    from sfr_loc_map.bench.trials import LocaliserTrial
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import drive_of
    from sfr_loc_map.runs.drive_start import true_start
    from sfr_loc_map.scoring.request import ScoreRequest

    propose("sfr localise SRC -o T.csv --stats S.csv --method NAME", why="runs one method, with files to score")
    if peer_python is None:
        refuse_given(context, ("vocabulary",), "is the vocabulary of ORB-SLAM3: give --peer-python PYTHON, too")
    scoring = ScoreRequest.of(conditions, spacing=spacing, called=option_names(context)).config.trajectory
    source_config = announced_config(source, config, remap)
    claim_outputs(json_path, inputs=(source, source_config.configuration.path, vocabulary), overwrite=overwrite)
    opened = open_source(source, source_config)
    parameters = source_config.configuration.build(LocalisationConfig, "localisation")
    sequence = drive_of(opened)
    check_conditions(sequence.ground_truth, scoring.conditions, lenient=lenient)
    methods, missing = methods_to_compare(Task.LOCALISATION, parameters, peer_python, vocabulary, method or ())
    trial = LocaliserTrial(
        sequence=sequence,
        T_ds_rb=true_start(sequence).T_ds_rb,
        scoring=scoring,
        rate_hz=rate,
        hidden=opened.truth_paths(),
    )
    with progress_bar("calls") as bar:
        advance = counting(bar, "calls measured", len(trial) * len(methods) * repeat)
        result = compare_methods(trial, methods, repeat=repeat, progress=advance)
    _present_methods(source, result, missing, json_path)


@group.command(name="map", epilog=examples("sfr bench map data/ --json bench.json"))
def map_(
    source: SourceArgument,
    method: MethodsOption = None,
    peer_python: PeerOption = None,
    repeat: RepeatOption = 3,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare our mapper with OpenCV's semi-global matching, Pandora if installed, and other methods."""
    from sfr_loc_map.bench.method_benchmark import compare_methods, methods_to_compare
    from sfr_loc_map.bench.trials import MapperTrial
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import panorama_of

    propose("sfr map SRC -o C.ply --stats S.csv --method NAME", why="runs one method, with files to score")
    source_config = announced_config(source, config, remap)
    claim_outputs(json_path, inputs=(source, source_config.configuration.path), overwrite=overwrite)
    opened = open_source(source, source_config)
    parameters = source_config.configuration.build(MappingConfig, "mapping")
    sequence = panorama_of(opened)
    methods, missing = methods_to_compare(Task.MAPPING, parameters, peer_python, added=method or ())
    trial = MapperTrial.of(sequence, parameters, opened.truth_paths())
    with progress_bar("calls") as bar:
        advance = counting(bar, "calls measured", len(trial) * len(methods) * repeat)
        result = compare_methods(trial, methods, repeat=repeat, progress=advance)
    _present_methods(source, result, missing, json_path)


@group.command(epilog=examples("sfr bench faults data/ --fault torn+noisy --json faults.json"))
def faults(
    context: Context,
    source: SourceArgument,
    fault: Annotated[
        list[str] | None,
        Option(
            metavar="KIND[:...]",
            help="Fault as in sfr simulate; + joins several faults; repeatable. Default: common faults.",
        ),
    ] = None,
    conditions: Annotated[
        str, Option("--condition", metavar="distance=M|time=S|frames=N", help="End of a sub-trajectory.")
    ] = SCORE.trajectory.conditions[0],
    spacing: SpacingOption = SCORE.trajectory.spacing,
    seed: Annotated[int, Option(min=0, metavar="N", help="Seed that selects the affected pairs.")] = 0,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Localise data with injected faults and compare the errors with the reported sigmas.

    Exit with 1 for silent errors, which no state reports, and with 3 if no pair with a fault has a ground truth.
    """
    from sfr_loc_map.bench.benchmark_tables import faults_table
    from sfr_loc_map.bench.fault_benchmark import FAULTS, benchmark_faults
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import drive_of, without_truth
    from sfr_loc_map.scoring.request import ScoreRequest

    propose("sfr simulate DST --from SRC --fault KIND:amount=A", why="writes the data with a single fault")
    source_config = announced_config(source, config, remap)
    claim_outputs(json_path, inputs=(source, source_config.configuration.path), overwrite=overwrite)
    wanted = tuple(fault or FAULTS)
    scoring = ScoreRequest.of([conditions], spacing=spacing, called=option_names(context)).config.trajectory
    opened = open_source(source, source_config)
    localiser = source_config.configuration.build(LocalisationConfig, "localisation")
    drive = drive_of(opened)
    if drive.ground_truth is None:
        raise without_truth(source)
    if not drive.ground_truth.has_attitude:
        raise InputError(f"the ground truth of '{source}' has only positions: give a source that has true attitudes")
    check_conditions(drive.ground_truth, scoring.conditions, lenient=lenient)
    with progress_bar("faults") as bar:
        advance = counting(bar, "drives localised", len(wanted) + 1)
        result = benchmark_faults(drive, wanted, localiser, scoring, seed, advance)
    content = {"source": str(source), **result.content()}
    _present(content, faults_table(result), json_path, missing=result.missing, interrupted=result.interrupted)
    if result.silent:
        raise FailedVerdictError(
            "with these faults the state remained 'tracking' although an error exceeded 5 times the reported 3 sigma: "
            f"{', '.join(result.silent)}"
        )
    if result.not_compared and not lenient:
        raise NotJudgedError(
            "with these faults no pair was compared, because no true pose has the stamp of a pair: "
            f"{', '.join(result.not_compared)}"
        )


@group.command(epilog=examples("sfr bench methods", "sfr bench methods --include-dir"))
def methods(
    context: Context,
    include_dir: Annotated[bool, Option("--include-dir", help="Print only the folder of sfr_candidate.h.")] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """List the registered methods under test with their versions; a class or a C library needs no registration."""
    from sfr_loc_map.bench.benchmark_tables import registered_methods_table
    from sfr_loc_map.methods.registry import header_folder, listed_methods

    propose("sfr localise SRC -o T.csv --method NAME", why="the same drive by another method")
    if include_dir:
        refuse_given(context, ("json_path",), "has no effect with --include-dir: omit one of them")
        say(str(header_folder()))
        return
    claim_outputs(json_path, overwrite=overwrite)
    found = listed_methods()
    show({"methods": found}, json_path, [registered_methods_table(found)])


def _present(
    content: dict[str, Any],
    table: Table,
    json_path: str | None,
    *,
    missing: Mapping[str, str],
    failed: Mapping[str, str] = MappingProxyType({}),
    findings: Mapping[str, list[str]] = MappingProxyType({}),
    interrupted: str,
) -> None:
    """Print table, missing reference methods and failures; write JSON; `--json -` prints only JSON."""
    show(content, json_path, [table])
    if json_path != STANDARD_OUTPUT:
        for name, reason in missing.items():
            say(f"skipped: {name}: {reason}")
        for name, reason in failed.items():
            say(f"failed: {name}: {reason}")
        for name, texts in findings.items():
            more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
            say(f"found: {name}: {texts[0]}{more}")
    if interrupted:
        raise InterruptedRunError(f"interrupted: {interrupted} are finished and reported")
    if wrong := dict.fromkeys((*failed, *findings)):
        raise FailedVerdictError(f"methods failed: {', '.join(wrong)}; the figures of the other methods are written")


def _present_methods(source: Path, result: MethodBenchmark, missing: Mapping[str, str], json_path: str | None) -> None:
    """Present a comparison of methods."""
    from sfr_loc_map.bench.benchmark_tables import methods_table

    _present(
        {"source": str(source), **result.content(), "missing": missing},
        methods_table(result),
        json_path,
        missing=missing,
        failed=result.failed,
        findings=result.findings,
        interrupted=result.interrupted,
    )
