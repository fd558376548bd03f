"""Replay a source, score the results and write the files: the work of `sfr replay`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from sfr_loc_map.calls.call_record import states_text, tracking_warning
from sfr_loc_map.config import changed
from sfr_loc_map.errors import NodeError, SfrError, naming
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.replay.external_poses import with_converted_poses
from sfr_loc_map.replay.files import ReplayFiles, save_replay
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.replay.result import ReplayResult
from sfr_loc_map.replay.score import score_replay
from sfr_loc_map.replay.session import replay
from sfr_loc_map.scoring.inputs import Correction
from sfr_loc_map.suite_names import Task


@dataclass(frozen=True, slots=True)
class ScoredReplay:
    """The result of a replay."""

    result: ReplayResult
    score: Score
    remarks: tuple[str, ...]  #: Remarks for the user in addition to the score, one line each.
    warning: str | None  #: Warning that many poses are lost or degraded; None if few are.
    interrupted: str  #: Which part was played if a signal ended the replay; empty otherwise.


def replay_and_score(
    source: Source,
    options: ReplayOptions,
    correction: Correction,
    files: ReplayFiles | None,
    command: str,
    *,
    progress: Callable[[str], None],
    say: Callable[[str], None],
) -> ScoredReplay:
    """Replay a source, write the results to files if given, and score the results.

    `progress` is called with the rig of each played pair, `say` with a line about each step. The correction applies to
    the poses of an external localiser. If a signal ends the replay, the played part is scored; without any result, a
    KeyboardInterrupt is raised. If the replay or the conversion fails, the received results are written but not scored.
    """
    results = ReceivedResults(None if options.external is None else options.external.task)
    with naming(source.path):
        try:
            was_interrupted = replay(source, options, results, progress=progress, say=say)
            result = with_converted_poses(results.replay_result(), source, options.score, correction)
        except SfrError as error:
            if files is None or not results.count:
                raise
            _save(results.replay_result(), files, options)  # poses of an external node are saved as published
            raise type(error)(f"{error}; the received results are in '{files.folder}'") from error
        if was_interrupted and not results.count:
            raise KeyboardInterrupt
        if files is not None:
            _save(result, files, options)
        remarks = tuple(_remarks(results))
        _check_map(results)
    score = score_replay(
        source,
        result,
        options.score,
        options.limits,
        files=files,
        settings={Task.LOCALISATION: changed(options.localisation), Task.MAPPING: changed(options.mapping)},
        limits_file=options.limits_file,
        command=command,
    )
    localised = [record for record in result.records if record.task is Task.LOCALISATION]
    states = f"{len(result.estimate)} poses, {states_text(result.records)}"
    total = sum(len(part) for part in (source.loc, source.nav) if part is not None)
    interrupted = f"interrupted: {len(results.sent_pairs)} of {total} pairs were played and scored"
    return ScoredReplay(
        result,
        score,
        (*remarks, states),
        tracking_warning(localised, source.path),
        interrupted if was_interrupted else "",
    )


def _save(result: ReplayResult, files: ReplayFiles, options: ReplayOptions) -> None:
    """Write the results; the files of an earlier replay are removed, because it may have written more of them."""
    files.remove()
    if len(result.estimate):
        ours = record_of_ours(Task.LOCALISATION, changed(options.localisation))
    else:
        ours = record_of_ours(Task.MAPPING, changed(options.mapping))
    save_replay(result, files, ours)


def _remarks(results: ReceivedResults) -> Iterator[str]:
    """Yield remarks on missing results and on the answers of an external node."""
    theirs = results.external_task  # the score counts the answers of this task
    played = len(results.sent_stamps(Task.LOCALISATION.rig))
    if (missing := played - len(results.poses)) > 0 and theirs is not Task.LOCALISATION:
        yield f"{missing} of {played} pairs have no odometry: the nodes could not keep up"
    pairs = len(results.sent_stamps(Task.MAPPING.rig))
    if (missing := pairs - len(results.mapped_stamps)) > 0 and theirs is not Task.MAPPING:
        yield f"{missing} of {pairs} pairs are missing in the map: the nodes could not keep up"
    if (node := results.external) is not None:
        answers = node.score.answers
        yield f"external node {node.method.name}: {answers.answered} of {answers.pairs} pairs answered"


def _check_map(results: ReceivedResults) -> None:
    """Raise a NodeError if our mapper received pairs and published no cloud."""
    if results.sent_stamps(Task.MAPPING.rig) and not results.clouds and results.external_task is not Task.MAPPING:
        raise NodeError("mapping_node published no cloud: play slower (--rate) or in lock step (--rate 0)")
