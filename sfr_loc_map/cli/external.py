"""Options of `sfr replay` for an external node in place of ours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.convention import read_correction
from sfr_loc_map.cli.output import say
from sfr_loc_map.constants import Task
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.nodes.replay.external_options import ExternalOptions
    from sfr_loc_map.nodes.replay.results import ReplayResults
    from sfr_loc_map.pipeline.external_run import ExternalRun
    from sfr_loc_map.pipeline.scoring import Correction

TASKS = ("localisation", "mapping")
METHODS = ("sfr", "external")
VALUES = ("command", "watch", "answers", "frames")
"""Options for external nodes alone."""

ExternalOption = Annotated[
    str | None,
    typer.Option(
        "--external",
        metavar="localisation|mapping",
        help="A node of anyone in place of ours is under test.",
        autocompletion=completion.words("localisation", "mapping"),
    ),
]
MethodOption = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="sfr|external",
        autocompletion=completion.words(*METHODS),
        help="external: --external of the only task that SRC has.",
    ),
]
CommandOption = Annotated[
    str, typer.Option("--command", metavar="CMD", help="Starts the external node, and is ended with the replay.")
]
WatchOption = Annotated[
    str,
    typer.Option("--watch", metavar="PID|NAME", help="External process whose CPU and memory are measured (of CMD)."),
]
AnswersOption = Annotated[
    str,
    typer.Option("--answers", metavar="TOPIC", help="What it publishes (localisation/odometry, mapping/points)."),
]
FramesOption = Annotated[
    str,
    typer.Option(
        "--frames", metavar="PARENT,CHILD", help="Frames that its answers name; others are left out (of the first one)."
    ),
]
AnswerTimeoutOption = Annotated[
    float, typer.Option("--answer-timeout", min=0.01, metavar="S", help="How long its answer to a pair is waited for.")
]


def read_external(
    source: Source,
    chosen: tuple[str | None, str],
    values: tuple[str, str, str, str],
    answer_timeout: float,
    correction: Correction,
) -> ExternalOptions | None:
    """Return the options of an external node, None where ours run.

    Args:
        source: What is replayed.
        chosen: Values of `--external` and `--method`.
        values: Those of `--command`, `--watch`, `--answers` and `--frames`.
        answer_timeout: Value of `--answer-timeout`.
        correction: How its poses are converted.

    Raises:
        ConfigError: If an option is not valid, or is given without an external node.
    """
    from sfr_loc_map.nodes.replay.external_options import RESULT_TOPICS, ExternalOptions

    name, given = _task(source, *chosen), dict(zip(VALUES, values, strict=True))
    if name is None:
        needless = [f"--{option}" for option, value in given.items() if value]
        needless += ["--convention or --apply-diagnosis"] if correction.is_wanted else []
        if needless:
            raise ConfigError(f"'{needless[0]}' is for external nodes: give --external {' or '.join(TASKS)} as well")
        return None
    task = Task(name)
    if task is Task.MAPPING and correction.apply_diagnosis:
        raise ConfigError("'--apply-diagnosis' is for poses: leave it out with --external mapping")
    return ExternalOptions(
        task=task,
        topic=given["answers"] or RESULT_TOPICS[task],
        command=given["command"],
        watch=given["watch"],
        frames=" -> ".join(given["frames"].split(",")),
        timeout_s=answer_timeout,
        convention=correction.declared,
    )


def _task(source: Source, external: str | None, method: str) -> str | None:
    if method not in METHODS:
        raise ConfigError(f"'--method {method}': nodes are {' or '.join(METHODS)}; sfr localise takes all methods")
    if external is not None and external not in TASKS:
        raise ConfigError(f"'--external {external}': must be {' or '.join(TASKS)}")
    if external is not None or method != "external":
        return external
    parts = zip(TASKS, (source.loc, source.nav), strict=True)
    present = [task for task, part in parts if part is not None]
    if len(present) != 1:
        raise ConfigError(f"'--method external': which task? give --external {' or '.join(TASKS)}")
    return present[0]


def external_run_of(results: ReplayResults, correction: Correction) -> ExternalRun | None:
    """Return what is known of the external node of a replay, None without one; name what was wrong."""
    from sfr_loc_map.metrics.method_record import MethodKind, MethodRecord
    from sfr_loc_map.metrics.score import ConventionRecord, ExternalScore
    from sfr_loc_map.pipeline.external_run import ExternalRun

    node, book = results.observed, results.answers
    if node is None or book is None:
        return None
    score = ExternalScore(
        task=node.options.task.value,
        topic=node.options.topic,
        frames=book.frames,
        answers=book.counts,
        latency_s=book.latency_s,
        process=node.usage,
        ended=book.ended,
    )
    method = MethodRecord(name=node.name, version=node.version, kind=MethodKind.EXTERNAL)
    say(f"external node {node.name}: {book.counts.answered} of {book.counts.pairs} pairs answered", err=True)
    declared = correction.declared.settings
    of_cloud = ConventionRecord(declared=declared) if score.task == TASKS[1] and declared else None  # poses: later
    return ExternalRun(method, score, book.findings, correction, node.log, convention=of_cloud)


def read_conversion(convention: list[str] | None, apply_diagnosis: bool) -> Correction:
    """Return how the poses of an external node are converted.

    Raises:
        ConfigError: If a setting is none.
    """
    return read_correction(convention, apply_diagnosis, has_poses=True)
