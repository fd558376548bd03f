"""Options that several subcommands share, alone or in groups."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from sfr_loc_map.cli.output import HTML_SUFFIXES, check_outputs, check_suffix
from sfr_loc_map.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from sfr_loc_map.inputs import Task
    from sfr_loc_map.io.sequence import LocSequence, NavSequence
    from sfr_loc_map.methods.registry import Method, MethodLimits
    from sfr_loc_map.metrics.config import Condition
    from sfr_loc_map.metrics.limits import Limits
    from sfr_loc_map.pipeline.scoring import Correction

OURS = "sfr"  #: Name of the suite's own localiser and mapper, which run in the process of the command.
_NAMESPACE = re.compile(r"/?([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?/?")


def checked_namespace(text: str) -> str:
    """Return a namespace of ROS, the value of an option; raise ConfigError if it is none."""
    if not _NAMESPACE.fullmatch(text):
        raise ConfigError(f"--namespace '{text}' is none of ROS: give names of letters, digits and _ joined by /")
    return text


SourceArgument = Annotated[
    Path, typer.Argument(metavar="SRC", help="Data set folder, bag of ROS 2 or 1, or sequence of KITTI or EuRoC.")
]
NamespaceOption = Annotated[
    str, typer.Option("--namespace", metavar="NS", callback=checked_namespace, help="Namespace of the rover.")
]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="P.yaml", help="File with parameters.")]
RemapOption = Annotated[
    list[str] | None,
    typer.Option("--remap", metavar="FOUND:=EXPECTED", help="Topic of a bag under another name; repeatable."),
]
ConditionOption = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        metavar="distance=M|time=S|frames=N",
        show_default="distance=5",
        help="End of a sub-trajectory; also displacement=M, turn=DEG; commas: all at once; repeatable.",
    ),
]
StartOption = Annotated[
    Literal["identity", "truth"], typer.Option("--start", help="First pose: the identity, or the true one.")
]
Align = Literal["none", "origin", "se3", "sim3"]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="F", help="Write all figures as JSON; - for standard output.")
]
HtmlOption = Annotated[Path | None, typer.Option("--html", metavar="F.html", help="Write a page with figures.")]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite/--no-overwrite", help="Replace outputs that exist; without it they are refused.")
]
LenientOption = Annotated[
    bool, typer.Option("--lenient", help="Exit 0 rather than 3 where something could not be judged.")
]
SpacingOption = Annotated[int, typer.Option(metavar="FRAMES", help="Frames from one start to the next.")]
RebaseOption = Annotated[
    Literal["pose", "displacement", "position"],
    typer.Option(help="Reading of the document: how error from before a start is kept out."),
]
PartialOption = Annotated[bool, typer.Option("--partial", help="Judge an estimate of a part of the drive, and say so.")]


LimitsOption = Annotated[
    Path | None, typer.Option("--limits", metavar="F.yaml", help="Limits; exit code 1 if one is missed.")
]


@dataclass(frozen=True, slots=True)
class MethodOptions:
    """Which localiser or mapper runs, and what it may take."""

    method: Annotated[
        str,
        typer.Option(
            metavar="NAME|package.module:Class|lib:FILE.so",
            help="Method under test (sfr methods); --config is then the file with its configuration.",
        ),
    ] = OURS
    call_timeout: Annotated[float, typer.Option(metavar="S", help="Longest time of a call of a method under test.")] = (
        120.0
    )
    memory_limit: Annotated[
        int, typer.Option(metavar="MB", help="Resident memory at which a method under test is ended.")
    ] = 4000
    config: ConfigOption = None

    @property
    def is_ours(self) -> bool:
        """Whether the suite's own method runs."""
        return self.method == OURS

    @property
    def limits(self) -> MethodLimits:
        """What a method may take; raises ConfigError if an option is out of range."""
        from sfr_loc_map.config import build
        from sfr_loc_map.methods.registry import MethodLimits

        values = {"call_timeout_s": self.call_timeout, "memory_mb": self.memory_limit}
        return build(MethodLimits, values, origin="'--call-timeout', '--memory-limit'")

    def find(self, task: Task) -> Method:
        """Return the method under test with the text of `--config`; raise MethodError or ConfigError."""
        from sfr_loc_map.inputs import read_text
        from sfr_loc_map.methods.registry import EXTERNAL, find_method

        if self.method == EXTERNAL:
            raise ConfigError("'--method external': a node is scored by sfr replay SRC --external TASK")
        try:
            text = "" if self.config is None else read_text(self.config)
        except (OSError, ValueError) as error:
            raise ConfigError(f"'--config {self.config}' cannot be read ({error}): give a text file") from error
        return find_method(self.method, task, text)


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Where figures are written."""

    json_path: JsonOption = None
    html: HtmlOption = None
    overwrite: OverwriteOption = False

    def check(self, *more: Path | None, inputs: Sequence[Path] = ()) -> None:
        """Check these and more outputs before the work for them is done; raise OutputError if one cannot be."""
        check_suffix(self.html, HTML_SUFFIXES)
        check_outputs(self.json_path, self.html, *more, overwrite=self.overwrite, inputs=inputs)


@dataclass(frozen=True, slots=True)
class JudgeOptions:
    """By what a run is judged."""

    limits: LimitsOption = None
    condition: ConditionOption = None
    lenient: LenientOption = False

    def read(self) -> tuple[Limits | None, tuple[Condition, ...]]:
        """Return the limits, None without a file, and the conditions that the user named in options or limits."""
        from sfr_loc_map.metrics.config import Condition
        from sfr_loc_map.metrics.limits import load_limits

        limits = load_limits(self.limits) if self.limits is not None else None
        named = tuple(map(Condition.parse, self.condition or ()))
        return limits, (*named, *(limits.conditions if limits is not None else ()))


@dataclass(frozen=True, slots=True)
class ConventionOptions:
    """How an estimate is written, where not as poses of RB in DS."""

    convention: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="How the estimate is written, where not as poses of RB in DS: frame=left_optical, world=first_pose, "
            "quaternion=wxyz, inverse=true, metres_per_unit=0.001, ... (docs/metrics.md); repeatable.",
        ),
    ] = None
    apply_diagnosis: Annotated[
        bool,
        typer.Option("--apply-diagnosis", help="Correct the convention mismatch that explains the errors, and say so."),
    ] = False

    def read(self, *, has_poses: bool = True) -> Correction:
        """Return how an estimate is converted; raise ConfigError if a setting is none, or there are no poses."""
        from sfr_loc_map.geometry.pose_convention import PoseConvention
        from sfr_loc_map.pipeline.scoring import Correction

        correction = Correction(PoseConvention.parse(self.convention or ()), self.apply_diagnosis)
        if not has_poses and correction != Correction():
            raise ConfigError("'--convention' and '--apply-diagnosis' are for trajectories: leave them out for a cloud")
        return correction


def require_ros(command: str) -> None:
    """Raise MissingExtraError if ROS, which a subcommand needs, cannot be imported."""
    try:
        from sfr_loc_map.nodes import messages  # noqa: F401
        from sfr_loc_map.nodes.lifecycle import endpoints  # noqa: F401 - does it import?
    except ImportError as error:
        raise MissingExtraError(
            f"sfr {command} needs ROS 2 ({error}): source a ROS 2 installation, or pip install 'sfr_loc_map[ros]'"
        ) from error


def open_drive(source: Path, remap: list[str] | None) -> LocSequence:
    """Return the localisation pairs of a source; raise InputError if it has none."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import drive_of

    return drive_of(open_source(source, parse_remaps(remap)))


def open_panorama(source: Path, remap: list[str] | None) -> NavSequence:
    """Return the mapping pairs of a source; raise InputError if it has none."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import panorama_of

    return panorama_of(open_source(source, parse_remaps(remap)))


def parse_remaps(remaps: list[str] | None) -> dict[str, str]:
    """Return remappings `FOUND:=EXPECTED` as a mapping; raise ConfigError if one has another form."""
    parsed: dict[str, str] = {}
    for item in remaps or []:
        found, _, expected = item.partition(":=")
        if not found or not expected:
            raise ConfigError(f"'--remap {item}': must have the form FOUND:=EXPECTED")
        parsed[found] = expected
    return parsed
