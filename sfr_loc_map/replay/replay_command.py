"""Replay a source, score the results and write the files: the work of `sfr replay`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sfr_loc_map.calls.call_record import states_text, tracking_warning
from sfr_loc_map.errors import ConfigError, NodeError, SfrError, naming
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live.page_process import PageProcess
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.replay.external.external_poses import with_converted_poses
from sfr_loc_map.replay.files import ReplayFiles, save_replay
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.replay.played_pairs import pairs_between
from sfr_loc_map.replay.replay_score import files_of_source, score_replay
from sfr_loc_map.replay.result import ReplayResult
from sfr_loc_map.replay.session import Progress, Say, replay
from sfr_loc_map.suite_names import Task


@dataclass(frozen=True, slots=True)
class ScoredReplay:
    """The result of a replay."""

    result: ReplayResult
    score: Score
    remarks: tuple[str, ...]  #: Remarks for the user in addition to the score, one line each.
    warning: str | None  #: Warning that many poses are lost or degraded; None if few are.
    interrupted: str  #: Text that states the played part if a signal ended the replay; empty otherwise.


def replay_and_score(
    source: Source,
    options: ReplayOptions,
    files: ReplayFiles | None,
    command: str,
    page: PageProcess | None = None,
    *,
    progress: Progress,
    say: Say,
) -> ScoredReplay:
    """Replay a source, write the results to files if given, and score the results; `page` shows the replay.

    `progress` is called with the rig of each played pair, `say` with a line about each step. If a signal ends the
    replay, the played part is scored; without any result, a KeyboardInterrupt is raised. If the replay or the
    conversion fails, the received results are written but not scored. ConfigError if a diagnosis of the poses is
    requested for a source without ground truth.
    """
    _check_diagnosis(source, options)
    read = files_of_source(source, options.limits_file)
    with naming(source.path):
        result = _converted_results(source, options, files, page, progress, say)
        if files is not None:
            save_replay(result, files)
        _check_map(result)
    score = score_replay(
        source, result, options.request.config, options.request.limits, read=read, files=files, command=command
    )
    localised = [record for record in result.records if record.task is Task.LOCALISATION]
    states = [f"{len(result.estimate)} poses, {states_text(localised)}"] if result.loc_pairs.sent else []
    return ScoredReplay(
        result,
        score,
        remarks=(*_remarks(result), *states),
        warning=tracking_warning(localised, source.path, is_ours=options.external_task is not Task.LOCALISATION),
        interrupted=_played_part(source, options, result) if result.was_interrupted else "",
    )


def _played_part(source: Source, options: ReplayOptions, result: ReplayResult) -> str:
    """Return how many of the pairs that the options select were played before the replay was interrupted."""
    played = result.loc_pairs.sent + result.nav_pairs.sent
    total = pairs_between(source, options.offset_s, options.offset_s + options.duration_s)
    return f"interrupted: {played} of {total} pairs were played and scored"


def _converted_results(
    source: Source,
    options: ReplayOptions,
    files: ReplayFiles | None,
    page: PageProcess | None,
    progress: Progress,
    say: Say,
) -> ReplayResult:
    """Replay a source and return the results, with the poses of an external localiser as poses of RB in DS.

    If an error ends the replay or prevents the conversion, the received results are saved before the error is raised.
    The poses of an external node are then saved as published.
    """
    received = ReplayResult.empty()

    def keep(results: ReplayResult) -> None:
        nonlocal received
        received = results

    try:
        replay(source, options, page, progress=progress, say=say, on_results=keep)
        if received.was_interrupted and received.is_empty:
            raise KeyboardInterrupt
        return with_converted_poses(received, source, options.request.config, options.request.correction)
    except SfrError as error:
        if files is None or received.is_empty:
            raise
        save_replay(received, files)
        raise type(error)(f"{error}; the received results are in '{files.folder}'") from error


def _remarks(result: ReplayResult) -> Iterator[str]:
    """Yield remarks on missing results of our nodes, and on the answers of an external node."""
    external_task = None if result.external is None else result.external.task
    slower = "give a smaller --rate, or --rate 0, which waits for each pair"
    if result.loc_pairs.missing and external_task != Task.LOCALISATION:
        missing, pairs = result.loc_pairs.missing, result.loc_pairs.sent
        yield f"{missing} of {pairs} pairs have no odometry: the nodes could not keep up; {slower}"
    if result.nav_pairs.missing and external_task != Task.MAPPING:
        missing, pairs = result.nav_pairs.missing, result.nav_pairs.sent
        yield f"{missing} of {pairs} pairs are missing in the map: the nodes could not keep up; {slower}"
    if (node := result.external) is not None:
        answers = node.score.answers
        yield f"external node {node.method.name}: {answers.answered} of {answers.pairs} pairs answered"
        if refused := result.refused_calls:
            yield f"external node {node.method.name}: {refused} of its calls ignored, the first: {result.first_refusal}"


def _check_diagnosis(source: Source, options: ReplayOptions) -> None:
    """Raise a ConfigError if a diagnosis of an external node is requested and the source has no ground truth."""
    if options.external_task is not Task.LOCALISATION or not options.request.correction.apply_diagnosis:
        return
    if source.loc is None or source.loc.ground_truth is None or not len(source.loc.ground_truth):
        raise ConfigError("'--apply-diagnosis' requires ground truth, which the source does not have: omit the option")


def _check_map(result: ReplayResult) -> None:
    """Raise a NodeError if our mapper received pairs and published no cloud."""
    is_ours = result.external is None or result.external.task is not Task.MAPPING
    if is_ours and result.nav_pairs.sent and not result.clouds:
        raise NodeError("mapping_node published no cloud: play slower (--rate) or in lock step (--rate 0)")
