"""Options of a replay, and how the options of the command determine them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.configuration.sections import NOTHING_GIVEN, Configuration, is_ros_parameter_file
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.replay.played_pairs import begin_of
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.scoring.inputs import Correction
from sfr_loc_map.scoring.request import ScoreRequest
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import RESULTS

CONVERTED = "external/converted"
"""Topic of converted results if the external node publishes on the topic of the suite."""


@dataclass(frozen=True, slots=True)
class ExternalOptions:
    """An external node in place of one of the suite's nodes."""

    task: Task  #: Task of the node.
    topic: str  #: Topic of its results.
    command: str = ""  #: Command that starts the node; empty: the user starts it.
    #: Process whose CPU and memory are measured in addition to that of `command`: process id or part of a command line.
    watch: str = ""
    #: Required frame ids of answers: `parent -> child` of a pose, `parent` of a cloud. None: as in the first answer.
    frames: str | None = None
    timeout_s: float = 5.0  #: Timeout of the answer to a pair, also the wait in lock step; later answers are late.
    start_timeout_s: float = 60.0  #: Timeout of the node's subscription to images.
    #: Convention of the node's poses relative to RB in DS, or of the points of its clouds relative to LM.
    convention: PoseConvention = field(default_factory=PoseConvention)

    @property
    def converted_topic(self) -> str:
        """Topic on which the converted results are published for the monitor."""
        own = RESULTS[self.task]
        return CONVERTED if self.topic == own else own


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of a replay."""

    localisation: LocalisationConfig  #: Parameters of the localiser.
    mapping: MappingConfig  #: Parameters of the mapper.
    #: Settings and limits of the scores of replay and monitor; its correction applies to an external localiser.
    request: ScoreRequest
    limits_file: Path | None  #: File of the limits of the request.
    start: StartPose | None  #: Pose of RB in DS at the start, with its stamp; None: identity.
    rate: float | None  #: Multiple of the recorded speed; None: lock step, which waits for the results of each pair.
    offset_s: float  #: Start of the replay, s after the first message.
    duration_s: float  #: Duration of the played interval of the source, s.
    paused: bool  #: Whether the replay waits for the service ~/resume before the first pair.
    #: Configuration with the parameters of the monitor besides score and limits. If its file is a ROS parameter file,
    #: the nodes also read this file; the parameters above override it.
    configuration: Configuration = NOTHING_GIVEN
    external: ExternalOptions | None = None  #: External node under test; None: only nodes of the suite.

    @property
    def external_task(self) -> Task | None:
        """Task of the external node; None without one."""
        return None if self.external is None else self.external.task

    @property
    def parameter_file(self) -> Path | None:
        """The ROS parameter file of the nodes; None without one."""
        path = self.configuration.path
        return path if path is not None and is_ros_parameter_file(path) else None

    @property
    def changed_settings(self) -> dict[Task, dict[str, Any]]:
        """Parameters of localiser and mapper that differ from the defaults, by name."""
        return {Task.LOCALISATION: changed(self.localisation), Task.MAPPING: changed(self.mapping)}


def first_pose(source: Source, start: str, offset_s: float) -> StartPose | None:
    """Return the pose at which a localiser starts if a source is played from an offset; None for the identity."""
    if source.loc is None or start == "identity":
        return None
    with naming(source.path):
        begin_ns = begin_of(source, source.loc) if offset_s else 0
        return start_pose(source.loc, start, begin_ns + round(offset_s * NS_PER_S))


def task_under_test(source: Source, external: str | None, method: str) -> Task | None:
    """Return the task of an external node, None without one; raise a ConfigError if the task is ambiguous."""
    if external is not None:
        return Task(external)
    if method != "external":
        return None
    if source.loc is not None and source.nav is not None:
        raise ConfigError(
            "'--method external': the source has pairs for both tasks; give --external localisation or mapping"
        )
    return Task.LOCALISATION if source.nav is None else Task.MAPPING


def node_under_test(
    task: Task | None, *, answers: str, command: str, watch: str, frames: str, timeout_s: float, correction: Correction
) -> ExternalOptions | None:
    """Return the options of an external node, None without one.

    `answers`, `command`, `watch` and `frames` are the values of the options of the command; empty if not given.
    ConfigError if a diagnosis is requested for a map, or if the frames are invalid.
    """
    if task is None:
        return None
    if task is Task.MAPPING and correction.apply_diagnosis:
        raise ConfigError("'--apply-diagnosis' applies only to poses: omit it with --external mapping")
    return ExternalOptions(
        task=task,
        topic=answers or RESULTS[task],
        command=command,
        watch=watch,
        frames=_required_frames(task, frames) if frames else None,
        timeout_s=timeout_s,
        convention=correction.declared,
    )


def _required_frames(task: Task, text: str) -> str:
    """Return the frame ids in `PARENT,CHILD` (poses) or `PARENT` (clouds) in the form of `AnswerConverter.frames_of`.

    ConfigError for another number of frames, and for an empty frame id.
    """
    form = "PARENT,CHILD" if task is Task.LOCALISATION else "PARENT"
    frames = [name.strip() for name in text.split(",")]
    if len(frames) != len(form.split(",")) or not all(frames):
        raise ConfigError(f"'--frames {text}': {form} is required with --external {task}")
    return " -> ".join(frames)
