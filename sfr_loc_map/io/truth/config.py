"""The section `truth` of a configuration: origin and tracked body of the truth (docs/formats.md, "Truth")."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.configuration.parameters import changed, param
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.transform import Transform

NO_LEVER = (0.0, 0.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)
TOPIC = re.compile(r"(/[A-Za-z_]\w*)+")  #: The absolute name of a topic.
ORIGIN_SETTINGS = ("truth.source", "truth.frame")  #: Settings of the origin of the truth.


def _check_unit(quat_xyzw: tuple[float, ...]) -> None:
    if abs(float(np.linalg.norm(quat_xyzw)) - 1.0) > 1e-2:
        raise ConfigError(f"{list(quat_xyzw)} is not a rotation: a unit quaternion is required")


@dataclass(frozen=True, slots=True)
class TrackedBodyConfig:
    """The body that a truth tracks, and the accuracy of the truth."""

    lever_arm_m: tuple[float, float, float] = param(
        NO_LEVER, unit="m", doc="Position of the tracked body (prism, antenna, marker) in RB.", low=-100.0, high=100.0
    )
    lever_quat_xyzw: tuple[float, float, float, float] = param(
        NO_TURN,
        doc="Orientation of the tracked body in RB, as in ROS messages.",
        low=-1.01,
        high=1.01,
        check=_check_unit,
    )
    clock_offset_s: float = param(
        0.0, unit="s", doc="Offset that is added to the stamps of the truth.", low=-4e9, high=4e9
    )
    sigma_m: float = param(
        0.0,
        unit="m",
        doc="Standard deviation of a true position along each axis. 0: from the messages, otherwise exact.",
        low=0.0,
        high=1000.0,
    )
    sigma_deg: float = param(
        0.0, unit="deg", doc="Standard deviation of a true attitude about each axis, like sigma_m.", low=0.0, high=180.0
    )
    attitude: str = param(
        "auto", doc="Whether the truth has attitudes: inferred (auto), yes or no.", choices=("auto", "yes", "no")
    )
    unknown: str = param(
        "auto",
        doc=(
            "Unknown components of the truth: none, the height, roll and pitch (tilt), or all three (planar). auto: "
            "components that its variances mark as unknown, or that never change along its path."
        ),
        choices=("auto", "none", "height", "tilt", "planar"),
    )

    @property
    def has_lever(self) -> bool:
        """Whether the pose of the tracked body in RB differs from the identity."""
        return (self.lever_arm_m, self.lever_quat_xyzw) != (NO_LEVER, NO_TURN)

    @property
    def declared(self) -> tuple[str, ...]:
        """The settings `truth.NAME=VALUE` that change poses, without `ORIGIN_SETTINGS`."""
        values = changed(self, "truth.").items()
        return tuple(f"{name}={value}" for name, value in values if name not in ORIGIN_SETTINGS)


@dataclass(frozen=True, slots=True)
class LiveTruthConfig(TrackedBodyConfig):
    """The tracked body of a truth on a ROS graph, and its frame on /tf."""

    frame: str = param(
        "",
        doc="Frame whose poses on /tf are the truth, as PARENT:CHILD; in a recording also as CHILD (in the root of its "
        "tree). Empty: the truth is a topic or file.",
    )


@dataclass(frozen=True, slots=True)
class TruthConfig(LiveTruthConfig):
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

    @property
    def file(self) -> Path | None:
        """The existing file or folder that `source` names by its absolute path; None if there is none.

        `SourceConfig.of` makes the paths of files absolute, so that a relative name is that of a topic.
        """
        path = Path(self.source)
        return path if path.is_absolute() and path.exists() else None

    @property
    def changed_content(self) -> dict[str, object]:
        """The settings that change the true poses or their stated accuracy, by dotted name, without a named file."""
        settings = changed(self, "truth.")
        if self.file is not None:
            del settings["truth.source"]
        return settings

    @property
    def topic(self) -> str:
        """The absolute name of a topic that `source` gives; empty if there is none."""
        return self.source if self.file is None and TOPIC.fullmatch(self.source) else ""


def with_lever_of(config: TrackedBodyConfig, T_rb_body: Transform | None) -> TrackedBodyConfig:
    """Return the configuration with the source's pose of the tracked body, unless a pose is configured."""
    if config.has_lever or T_rb_body is None:
        return config
    x, y, z = T_rb_body.translation.tolist()
    qx, qy, qz, qw = T_rb_body.quat_xyzw.tolist()
    return replace(config, lever_arm_m=(x, y, z), lever_quat_xyzw=(qx, qy, qz, qw))


DEFAULT_TRUTH = TruthConfig()  #: The truth of the source itself, which tracks RB.
RB_ITSELF = TrackedBodyConfig()  #: The tracked body is RB; the accuracy is that in the messages.
