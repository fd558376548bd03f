"""What to tell a user of the states of a drive: how many pairs are lost or degraded, why, and what to do next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.pipeline.call_record import CallRecord

MANY: Final = 0.05
"""Share of pairs without a good pose from which there is a warning."""
SEE_SOURCE = "sfr doctor {source}"
SEE_TRACKS = "sfr localise {source} -o again.csv --video tracks.avi"
SEE_CALLS = "sfr localise {source} -o again.csv --stats stats.csv"
CAUSES: Mapping[str, tuple[str, str]] = {
    StateReason.UNSEEN_MOTION: ("the images before showed nothing that was known", SEE_TRACKS),
    StateReason.REPEATED_IMAGES: ("images are those of the pair before", SEE_SOURCE),
    StateReason.UNTEXTURED_IMAGES: ("images show nothing: black, white or blinded", SEE_TRACKS),
    StateReason.TORN_IMAGES: ("parts of images are of different moments", SEE_TRACKS),
    StateReason.NO_STEREO: (
        "left and right are not a stereo pair of the rig: equal, swapped, or of different moments",
        SEE_SOURCE,
    ),
    StateReason.FEW_LANDMARKS: ("too few landmarks were found again", SEE_TRACKS),
    StateReason.MOVING_REGIONS: ("large parts of the images do not move with the ground", SEE_TRACKS),
    StateReason.CALIBRATION_DRIFT: ("the right camera moves against the left one", SEE_CALLS),
    StateReason.IMPLAUSIBLE_MOTION: ("no rover moves like what was found", SEE_CALLS),
}
"""In words, and the command that shows more, by reason of the state."""


def states_text(records: Sequence[CallRecord]) -> str:
    """Return how many calls of the localiser are lost, and degraded if any is."""
    counts = Counter(record.state for record in records)
    degraded = counts[TrackingState.DEGRADED]
    return f"{counts[TrackingState.LOST]} lost" + (f", {degraded} degraded" if degraded else "")


def tracking_warning(records: Sequence[CallRecord], source: object) -> str | None:
    """Return a warning with cause and next command if many pairs are lost or degraded, None otherwise.

    Args:
        records: Calls of the localiser.
        source: What was localised, as the user named it.
    """
    bad = [record for record in records if record.state in (TrackingState.LOST, TrackingState.DEGRADED)]
    if not bad or len(bad) < MANY * len(records):
        return None
    reasons = Counter(record.reason for record in bad)
    reason, count = reasons.most_common(1)[0]
    cause, command = CAUSES.get(reason, ("the reason is not known", SEE_CALLS))
    return (
        f"{states_text(records)} of {len(records)} pairs; {count} of them because {cause} ({reason or 'no reason'}): "
        f"look with {command.format(source=source)}"
    )
