"""The check that a score was made with the data set that its limits name by hashes (`data_set_sha256`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sfr_loc_map.metrics.figures.records import InputFile
from sfr_loc_map.metrics.score.score import Score

DATA_SET_ROLES = {
    "truth": "the ground truth of the drive",
    "truth_file": "the file of truth.source",
    "images": "the stamps and the rig of the images",
    "map_truth": "the source of the map",
}
"""Inputs that belong to the data set, by role in the provenance, and their words in a message.

The hash of a bag covers its images. The hash of the ground truth in a folder covers only the file of the true poses.
"""


def fault_of_data_set(score: Score) -> str | None:
    """Return why a score was not made with the data set of its rules; None if it was, or if they name no data set.

    Each input of the data set must have one of the hashes. At least one of these inputs is required.
    """
    accepted = score.active_rules.data_set_sha256
    if not accepted:
        return None
    return fault_of_inputs(accepted, {} if score.provenance is None else score.provenance.inputs)


def fault_of_inputs(accepted: Sequence[str], inputs: Mapping[str, InputFile]) -> str | None:
    """Return why inputs, by role, are not those of a data set with the `accepted` hashes; None if they are."""
    required = f"the limits require one of {', '.join(accepted)} (data_set_sha256)"
    present = [role for role in DATA_SET_ROLES if role in inputs]
    if not present:
        return f"the data set is unknown, because the score states no hash of a ground truth or of images: {required}"
    for role in present:
        file = inputs[role]
        if file.sha256 not in accepted:
            found = f"the SHA-256 of {DATA_SET_ROLES[role]} ('{file.path}') is {file.sha256}"
            return f"another data set: {found}, but {required}"
    return None
