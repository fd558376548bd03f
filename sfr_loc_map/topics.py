"""The topics of the suite: role, message type, whether a topic is recorded, and whether it is read from a bag.

Names are relative, so that a namespace or a remapping applies to them. `names` returns the topics of a role.

A topic is added in these places: its row in `TOPICS`, which determines what `sfr record` records, what is read from a
bag and what the doctor expects; the node in `nodes` that publishes or receives the topic; `docs/interfaces.md`,
`docs/nodes.md` and `config/sros2_policy.xml`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map import message_types
from sfr_loc_map.suite_names import SIDES, Task

RECTIFIED, RAW = "image_rect", "image_raw"
COMPRESSED_END = "/compressed"  #: Suffix of topics with compressed images, in ROS and in the suite.
IMAGES = {
    f"{image}{end}": kind
    for image in (RECTIFIED, RAW)
    for end, kind in (("", message_types.IMAGE), (COMPRESSED_END, message_types.COMPRESSED))
}
"""Message types of a camera's images by the last part of the topic. If several are published, the live page shows the
first."""
CAMERAS = tuple(f"{task.rig}/{side}" for task in Task for side in SIDES)
NAV_POSE, INITIAL_POSE, MOTION_PRIOR, JOINTS = "nav/pose", "initialpose", "motion_prior", "joint_states"
TRUE_POSES, TRUE_POINTS = "ground_truth/odometry", "ground_truth/points"
ESTIMATE, ESTIMATED_PATH, TRACKS = "localisation/odometry", "localisation/path", "localisation/tracks"
INITIAL_POSE_SET, DEBUG_IMAGE = "localisation/initialpose_set", "localisation/debug_image"
CLOUD, DISPARITY, ELEVATION, HAZARD = "mapping/points", "mapping/disparity", "mapping/elevation", "mapping/hazard"
METRICS, REPORT, BOOKMARK = "metrics", "metrics/report", "bookmark"
DIAGNOSTICS, TF, TF_STATIC, CLOCK = "/diagnostics", "/tf", "/tf_static", "/clock"


class Role(StrEnum):
    """Purpose of a topic."""

    INPUT = "input"  #: Required by a node.
    OPTIONAL = "optional input"
    TRUTH = "truth"
    RESULT = "result"  #: Result of localisation or mapping.
    REPORT = "report"  #: Report of a node about itself, the run or its configuration.


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of the suite."""

    name: str
    msgtype: str  #: Message type; for true poses the first of several types.
    role: Role
    is_recorded: bool = True  #: Whether `sfr record` records the topic by default.
    is_read: bool = False  #: Whether the topic is read from a bag.


def call_topic(task: Task) -> str:
    """Return the topic of the call records of a task's node."""
    return f"{task.node}/call"


def configuration_topic(task: str) -> str:
    """Return the topic of the parameters of `localisation`, `mapping` or `monitor`."""
    return f"{task}/configuration"


def rectified_beside(name: str) -> list[str]:
    """Return the topics of rectified images that replace a topic of raw images; empty for every other topic."""
    camera, raw, _ = name.rpartition(f"/{RAW}")
    return [f"{camera}/{RECTIFIED}", f"{camera}/{RECTIFIED}{COMPRESSED_END}"] if raw else []


_TOPICS = (
    *(Topic(f"{camera}/{name}", kind, Role.INPUT, is_read=True) for camera in CAMERAS for name, kind in IMAGES.items()),
    *(Topic(f"{camera}/camera_info", message_types.CAMERA_INFO, Role.INPUT, is_read=True) for camera in CAMERAS),
    Topic(NAV_POSE, message_types.POSE, Role.INPUT, is_read=True),
    Topic(INITIAL_POSE, message_types.POSE_WITH_COVARIANCE, Role.OPTIONAL),
    Topic(MOTION_PRIOR, message_types.ODOMETRY, Role.OPTIONAL),
    Topic(JOINTS, message_types.JOINTS, Role.OPTIONAL, is_recorded=False, is_read=True),
    Topic(TRUE_POSES, message_types.ODOMETRY, Role.TRUTH, is_read=True),
    Topic(TRUE_POINTS, message_types.POINTS, Role.TRUTH, is_read=True),
    Topic(ESTIMATE, message_types.ODOMETRY, Role.RESULT, is_read=True),
    Topic(ESTIMATED_PATH, message_types.PATH, Role.RESULT),
    Topic(TRACKS, message_types.POINTS, Role.RESULT, is_recorded=False),
    Topic(DEBUG_IMAGE, message_types.IMAGE, Role.RESULT, is_recorded=False),
    Topic(INITIAL_POSE_SET, message_types.POSE_WITH_COVARIANCE, Role.RESULT, is_recorded=False),
    Topic(CLOUD, message_types.POINTS, Role.RESULT),
    Topic(DISPARITY, message_types.DISPARITY, Role.RESULT),
    Topic(ELEVATION, message_types.POINTS, Role.RESULT),
    Topic(HAZARD, message_types.GRID, Role.RESULT),
    Topic(METRICS, message_types.DIAGNOSTICS, Role.REPORT),
    Topic(REPORT, message_types.STRING, Role.REPORT),
    Topic(BOOKMARK, message_types.STRING, Role.REPORT),
    Topic(call_topic(Task.LOCALISATION), message_types.STRING, Role.REPORT, is_read=True),
    Topic(call_topic(Task.MAPPING), message_types.STRING, Role.REPORT),
    Topic(configuration_topic("localisation"), message_types.STRING, Role.REPORT, is_read=True),
    Topic(configuration_topic("mapping"), message_types.STRING, Role.REPORT),
    Topic(configuration_topic("monitor"), message_types.STRING, Role.REPORT),
    Topic(DIAGNOSTICS, message_types.DIAGNOSTICS, Role.REPORT),
    Topic(TF, message_types.TF, Role.OPTIONAL, is_read=True),
    Topic(TF_STATIC, message_types.TF, Role.OPTIONAL, is_read=True),
    Topic(CLOCK, message_types.CLOCK, Role.OPTIONAL),
)
TOPICS = {topic.name: topic for topic in _TOPICS}
"""All topics except those of single figures for plots (`metrics/position/mean`). `REPORT` contains these figures."""
RESULTS = {Task.LOCALISATION: ESTIMATE, Task.MAPPING: CLOUD}
"""Topics that carry the results of a task."""


def names(*roles: Role, recorded: bool | None = None, read: bool | None = None) -> tuple[str, ...]:
    """Return the names of the topics with one of the roles (default: all), filtered by `recorded` and `read`."""
    found = []
    for topic in TOPICS.values():
        is_asked = recorded in (None, topic.is_recorded) and read in (None, topic.is_read)
        if is_asked and (not roles or topic.role in roles):
            found.append(topic.name)
    return tuple(found)
