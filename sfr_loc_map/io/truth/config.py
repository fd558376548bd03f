"""The section `truth` of a configuration: origin and tracked body of the truth (docs/formats.md, "Truth")."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sfr_loc_map.config import param
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.truth.tracked_body import TrackedBody


@dataclass(frozen=True, slots=True)
class LiveTruth(TrackedBody):
    """The tracked body of a truth on a ROS graph, and its frame on /tf."""

    frame: str = param(
        "",
        doc="Frame whose poses on /tf are the truth, as PARENT:CHILD; in a recording also as CHILD (in the root of its "
        "tree). Empty: the truth is a topic or file.",
    )


@dataclass(frozen=True, slots=True)
class TruthConfig(LiveTruth):
    """The origin of the truth, and its tracked body."""

    source: str = param("", doc="Topic of the bag, or file, with the truth; empty: the truth of the source itself.")
    stamps: str = param(
        "header",
        doc="Stamps of the messages of a bag: those of the headers, or the times of recording.",
        choices=("header", "record"),
    )
    columns: str = param(
        "",
        doc="Columns of a text table without a known header: NAME=HEADER[UNIT], separated by commas, where NAME is t "
        "(or sec and nsec), x, y, z, qx, qy, qz or qw; or NAME[UNIT] in the order of the columns, with _ for others.",
    )

    def at(self, T_rb_body: Transform) -> TruthConfig:
        """Return the configuration with the source's pose of the tracked body, unless a pose is configured."""
        if self.has_lever:
            return self
        lever_arm_m, lever_quat_xyzw = (tuple(part.tolist()) for part in (T_rb_body.translation, T_rb_body.quat_xyzw))
        return replace(self, lever_arm_m=lever_arm_m, lever_quat_xyzw=lever_quat_xyzw)


DEFAULT_TRUTH = TruthConfig()  #: The truth of the source itself, which tracks RB.
