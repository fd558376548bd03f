"""Were two scores made of the same data? By the hash of the truth, and by the stamps of the sub-trajectories."""

from __future__ import annotations

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.records.score_details import SubTrajectoryRows
from sfr_loc_map.metrics.score import InputFile, Score

TRUTH_ROLES = ("truth", "map_truth")
"""Names of inputs in the provenance that must be alike."""


def check_same_data(first: Score, other: Score, names: tuple[str, str]) -> None:
    """Check that two scores were made with the same truth.

    Args:
        first: A score.
        other: Another one.
        names: Their names, for the message.

    Raises:
        MetricsError: If not.
    """
    for role in TRUTH_ROLES:
        mine, theirs = _input(first, role), _input(other, role)
        if mine is not None and theirs is not None and not _alike(mine, theirs):
            raise MetricsError(
                f"different data: the {role.replace('_', ' ')} of '{names[0]}' is '{mine.path}', that of '{names[1]}' "
                f"is '{theirs.path}', and their values differ; compare scores of the same data"
            )
    if _stamps_differ(first, other):
        raise MetricsError(
            f"different data: '{names[0]}' and '{names[1]}' have no sub-trajectory of the same stamps; compare scores "
            "of the same data"
        )


def sub_trajectories_of(score: Score) -> tuple[SubTrajectoryRows, ...]:
    """Return the sub-trajectories of each condition of a score, empty if it has none."""
    details = None if score.details is None else score.details.trajectory
    return () if details is None else details.sub_trajectories


def _input(score: Score, role: str) -> InputFile | None:
    return None if score.provenance is None else score.provenance.inputs.get(role)


def _alike(mine: InputFile, theirs: InputFile) -> bool:
    """Compare the values, or the files of scores that do not have the hash of the values."""
    if mine.data_sha256 is None or theirs.data_sha256 is None:
        return mine.sha256 == theirs.sha256
    return mine.data_sha256 == theirs.data_sha256


def _stamps_differ(first: Score, other: Score) -> bool:
    """Tell whether both have sub-trajectories of a common condition, and none of them has the same stamps."""
    theirs = {part.condition: part for part in sub_trajectories_of(other) if part.start_stamp_ns}
    mine = [part for part in sub_trajectories_of(first) if part.start_stamp_ns and part.condition in theirs]
    return bool(mine) and not any(_spans(part) & _spans(theirs[part.condition]) for part in mine)


def _spans(part: SubTrajectoryRows) -> set[tuple[int, int]]:
    return set(zip(part.start_stamp_ns, part.end_stamp_ns, strict=True))
