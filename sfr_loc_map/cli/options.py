"""Options that several subcommands share, and functions that interpret their values.

The help shows options without a panel first. Each panel has a title and contains options that apply to one subject, or
are less common. `of_panels` returns the options of panels, so that they can be refused together. The option `--live` is
in `live_option`. Options that only the commands of one group share are in the module of that group.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import yaml
from typer import Argument, Context, Option

from sfr_loc_map.cli.output import say
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError, MissingExtraError
from sfr_loc_map.json_yaml import parse_yaml
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.suite_names import OURS, Task

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.runs.under_test import UnderTest

TRAJECTORIES = "Trajectories"
ASSOCIATION = "Association of an estimated trajectory with the truth"
TABLES = "Text tables of poses"
CLOUDS = "Clouds"
METHOD = "Method under test"
CONVENTION = "Convention of an estimate other than poses of RB in DS"
_NAMESPACE = re.compile(r"/?|/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*/?")


def refuse_given(context: Context, names: Iterable[str], reason: str) -> None:
    """Raise ConfigError if one of the parameters was given on the command line, because it would have no effect."""
    for option, _ in _given(context, names):
        raise ConfigError(f"'{option}' {reason}")


def refuse_others(context: Context, allowed: Iterable[str], reason: str) -> None:
    """Raise ConfigError if a parameter other than the allowed ones was given on the command line."""
    refuse_given(context, context.params.keys() - set(allowed), reason)


def of_panels(context: Context, *panels: str) -> list[str]:
    """Return the names of those parameters of a command that the help shows in one of the given panels."""
    options = context.command.params
    return [str(option.name) for option in options if getattr(option, "rich_help_panel", None) in panels]


def given_words(context: Context, *names: str) -> list[str]:
    """Return the options that were given on the command line, as words of another command line."""
    words: list[str] = []
    for option, value in _given(context, names):
        for item in value if isinstance(value, list | tuple) else [value]:
            words += [option, str(item)]
    return words


def option_names(context: Context) -> dict[str, str]:
    """Return the names of the options of a command on the command line, such as `--max-gap`, by parameter."""
    return {str(option.name): max(option.opts, key=len) for option in context.command.params}


def _given(context: Context, names: Iterable[str]) -> Iterator[tuple[str, Any]]:
    """Yield the long name and the value of each of the parameters that was given, in the order of the help.

    The name of a flag that was switched off is that of its negation, such as `--no-fuse`.
    """
    wanted = set(names)
    parameters = {str(parameter.name): parameter for parameter in context.command.params}
    assert wanted <= parameters.keys(), f"{context.command_path} has no parameters {wanted - parameters.keys()}"
    for name, parameter in parameters.items():
        source = context.get_parameter_source(name)
        if name in wanted and source is not None and source.name == "COMMANDLINE":
            value = context.params[name]
            is_off = value is False and parameter.secondary_opts
            yield max(parameter.secondary_opts if is_off else parameter.opts, key=len), value


# ---- sources and their configuration


def checked_namespace(text: str) -> str:
    """Return a ROS namespace, the value of an option; raise ConfigError if it is invalid."""
    if not _NAMESPACE.fullmatch(text):
        raise ConfigError(
            f"'--namespace {text}' is not a ROS namespace: give names of letters, digits and _, separated by /, "
            "such as rover1 or site/rover1"
        )
    return text


SourceArgument = Annotated[
    Path, Argument(metavar="SRC", help="Data set folder, ROS 2 or ROS 1 bag, or KITTI or EuRoC sequence.")
]
RosRemapOption = Annotated[
    list[str] | None, Option("-r", metavar="FROM:=TO", help="ROS remapping rule of the nodes; repeatable.")
]
NamespaceOption = Annotated[str, Option(metavar="NS", callback=checked_namespace, help="Namespace of the rover.")]
ConfigOption = Annotated[
    Path | None,
    Option("--config", metavar="F.yaml", help="Configuration of SRC; default: the sfr.yaml in or beside SRC."),
]
GraphConfigOption = Annotated[
    Path | None,
    Option("--config", metavar="F.yaml", help="An sfr.yaml, of which the names of topics and other settings are used."),
]
RemapOption = Annotated[
    list[str] | None,
    Option(
        metavar="FOUND:=EXPECTED",
        help="Name of a topic in the data, and the name that sfr expects (docs/interfaces.md); repeatable.",
    ),
]
CalibrationOption = Annotated[
    Path | None,
    Option(metavar="F", help="Calibration file of Kalibr, OpenCV, ROS, COLMAP, EuRoC or ORB-SLAM, or a rig.json."),
]
SectionsOption = Annotated[
    list[str] | None,
    Option("--set", metavar="SECTION.KEY=VALUE", help="Set a value of sfr.yaml, for example truth.sigma_m=0.02."),
]
StartOption = Annotated[
    Literal["identity", "truth"],
    Option(help="Pose at which the localiser starts: the identity, or the true pose of the first pair."),
]
ColumnsOption = Annotated[
    list[str] | None,
    Option(
        "--columns",
        metavar="[estimate:|truth:]NAME=COLUMN,...",
        rich_help_panel=TABLES,
        help="Columns of a text table, by header (t=Time[s],x=East[mm],...) or by order "
        "(t[ns],x,y,z,qw,qx,qy,qz). Without a prefix, the columns apply to the estimate; repeatable.",
    ),
]


def parse_remaps(remaps: Sequence[str] | None) -> dict[str, str]:
    """Return remappings `FOUND:=EXPECTED` as a mapping; raise ConfigError if one has another form."""
    parsed: dict[str, str] = {}
    for item in remaps or ():
        found, _, expected = item.partition(":=")
        if not found or not expected or ":=" in expected:
            raise ConfigError(
                f"'--remap {item}': FOUND:=EXPECTED is required, such as /cam0/image:=loc/left/image_rect"
            )
        if found in parsed and parsed[found] != expected:
            raise ConfigError(f"'--remap {item}': '{found}' is already remapped to '{parsed[found]}': omit one")
        parsed[found] = expected
    return parsed


SETTING_FORM = "SECTION.KEY=VALUE is required, such as truth.sigma_m=0.02"


def parse_settings(settings: Sequence[str] | None, form: str = SETTING_FORM) -> dict[str, Any]:
    """Return settings `KEY=VALUE`, the values read as YAML; raise ConfigError if one has another form.

    `form` is the required form with an example of the command.
    """
    values: dict[str, Any] = {}
    for item in settings or ():
        key, separator, text = item.partition("=")
        if not separator or not key:
            raise ConfigError(f"'--set {item}': {form}")
        try:
            value = parse_yaml(text)
        except (yaml.YAMLError, ValueError) as error:
            raise ConfigError(
                f"'--set {item}': the value is not valid YAML; give a number, a word, or a list such as [1, 2]"
            ) from error
        if key in values and values[key] != value:
            raise ConfigError(f"'--set {item}': '{key}' is already set to {values[key]!r:.40}: omit one")
        values[key] = value
    return values


def columns_of(texts: Sequence[str] | None) -> tuple[str, str]:
    """Return the columns of the estimate and of the truth, joined if given several times; empty if not given."""
    found: dict[str, list[str]] = {"estimate": [], "truth": []}
    for text in texts or ():
        side, separator, columns = text.partition(":")
        if separator and side in found:
            found[side].append(columns)
        else:
            found["estimate"].append(text)
    return ",".join(found["estimate"]), ",".join(found["truth"])


def announced_config(source: Path, config: Path | None, remap: list[str] | None = None) -> SourceConfig:
    """Return how a source is read: by the file of `--config`, by default the file beside the source, and `--remap`.

    The use of the file beside the source is reported. A command calls this function before it checks its outputs, so
    that no output replaces the configuration file. `io.registry.open_source` then opens the source.
    """
    from sfr_loc_map.io.source_config import source_config

    how = source_config(source, config, parse_remaps(remap))
    if config is None and how.configuration.path is not None:
        say(f"configuration: {how.configuration.path}", err=True)
    return how


def configuration_of(
    source: Path, config: Path | None, calibration: Path | None, settings: list[str] | None, remap: list[str] | None
) -> Configuration:
    """Return a configuration of a source with the values of `--calibration`, `--set` and `--remap`.

    ConfigError if a section is invalid (`check_configuration`).
    """
    from sfr_loc_map.io.source_config import check_remap, with_settings

    remaps = parse_remaps(remap)
    check_remap(source, remaps)
    found = with_settings(Configuration.read(config), parse_settings(settings), calibration, remaps)
    check_configuration(found)
    return found


def check_configuration(given: Configuration) -> None:
    """Raise ConfigError for an invalid value in any section, except `monitor`, which the node checks at its start.

    The limits file is read.
    """
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.scoring.judgement import Judgement

    SourceConfig.of(given)
    given.build(LocalisationConfig, "localisation")
    given.build(MappingConfig, "mapping")
    Judgement.of(None, None, given)


# ---- methods under test

MethodOption = Annotated[
    str,
    Option(
        metavar="NAME|package.module:Class|lib:FILE.so",
        rich_help_panel=METHOD,
        help="Method under test (sfr bench methods lists them); --config then configures this method.",
    ),
]
CallTimeoutOption = Annotated[
    float, Option(metavar="S", rich_help_panel=METHOD, help="Timeout of a call of a method under test.")
]
MemoryLimitOption = Annotated[
    int, Option(metavar="MB", rich_help_panel=METHOD, help="Maximum resident memory of a method under test.")
]

OF_OUR_METHOD = {Task.LOCALISATION: ("video",), Task.MAPPING: ("refine_poses",)}
"""Options of the command of a task that apply only to our method."""


def method_under_test(
    context: Context, name: str, task: Task, source: Source, config: Path | None, call_timeout_s: float, memory_mb: int
) -> UnderTest | None:
    """Return the method with the name given by `--method`, its configuration and limits; None for our own method.

    MethodError if there is no such method. ConfigError if an option does not apply to the method.
    """
    from sfr_loc_map.methods.registry import MethodLimits, config_text, find_method
    from sfr_loc_map.metrics.figures.records import MethodKind
    from sfr_loc_map.runs.under_test import UnderTest

    if name == OURS:
        of_others = ("call_timeout", "memory_limit")
        reason = "applies to a method under test, not to the built-in method: give --method, too, or omit it"
        refuse_given(context, of_others, reason)
        return None
    values = {"call_timeout_s": call_timeout_s, "memory_mb": memory_mb}
    called = {"call_timeout_s": "--call-timeout", "memory_mb": "--memory-limit"}
    limits = build(MethodLimits, values, origin="", called=called)
    refuse_given(context, OF_OUR_METHOD[task], f"applies only to the built-in method: omit it with --method {name}")
    if name == MethodKind.EXTERNAL:
        raise ConfigError(
            f"'--method external' is a ROS node, which this command does not run: use sfr replay SRC --external {task}"
        )
    return UnderTest(find_method(name, task, config_text(config)), limits, hidden=source.truth_paths())


# ---- scores

SCORE = ScoreConfig()  #: Default settings of a score, which are the defaults of the options below.
Rebase = Literal["pose", "displacement", "position"]
Association = Literal["auto", "match", "interpolate"]
DEFAULT_REBASE = cast("Rebase", SCORE.trajectory.rebase)
DEFAULT_ASSOCIATION = cast("Association", SCORE.trajectory.association.truth)
LimitsOption = Annotated[Path | None, Option(metavar="F.yaml", help="Limits file; exit code 1 if a limit is missed.")]
ConditionOption = Annotated[
    list[str] | None,
    Option(
        "--condition",
        metavar="distance=M|time=S|frames=N",
        rich_help_panel=TRAJECTORIES,
        show_default=", ".join(SCORE.trajectory.conditions),
        help="Length at which a sub-trajectory ends; also displacement=M, turn=DEG. Conditions joined by a comma "
        "must all be met; repeatable.",
    ),
]
LenientOption = Annotated[bool, Option("--lenient", help="Exit with 0 instead of 3 if something could not be judged.")]
SpacingOption = Annotated[
    int,
    Option(
        min=1,
        metavar="FRAMES",
        rich_help_panel=TRAJECTORIES,
        help="Frames from one start of a sub-trajectory to the next.",
    ),
]
RebaseOption = Annotated[
    Rebase,
    Option(
        rich_help_panel=TRAJECTORIES,
        help="How the error at the start of a sub-trajectory is removed (docs/metrics.md).",
    ),
]
PartialOption = Annotated[
    bool,
    Option(
        "--partial",
        rich_help_panel=TRAJECTORIES,
        help="Judge the available part if the estimate does not cover the complete drive.",
    ),
]
ConventionOption = Annotated[
    list[str] | None,
    Option(
        metavar="NAME=VALUE",
        rich_help_panel=CONVENTION,
        help="frame=left_optical, world=first_pose, quaternion=wxyz, inverse=true, metres_per_unit=0.001, ... "
        "(docs/metrics.md); repeatable.",
    ),
]
ApplyDiagnosisOption = Annotated[
    bool,
    Option(
        "--apply-diagnosis",
        rich_help_panel=CONVENTION,
        help="If one convention mismatch explains the errors, correct it before scoring, and report it.",
    ),
]
Align = Literal["none", "origin", "se3", "sim3"]


# ---- outputs

JsonOption = Annotated[
    str | None, Option("--json", metavar="F", help="Write all figures as JSON; - for standard output.")
]
HtmlOption = Annotated[Path | None, Option(metavar="F.html", help="Write a page with figures.")]
OverwriteOption = Annotated[
    bool, Option("--overwrite/--no-overwrite", help="Replace existing outputs; by default, the command refuses to.")
]


# ---- ROS


def require_ros(command: str) -> None:
    """Raise MissingExtraError if ROS, which a subcommand requires, cannot be imported.

    Raise NodeError if the chosen middleware is not installed.
    """
    from sfr_loc_map.ros import environment

    try:
        environment.prepare()
        environment.check_middleware()
        from sfr_loc_map.nodes.lifecycle import endpoints  # noqa: F401 - does it import?
        from sfr_loc_map.ros import grid_messages, image_messages, point_messages, pose_messages  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"sfr {command} requires ROS 2 ({error}): source a ROS 2 installation, or pip install 'sfr_loc_map[ros]'"
        ) from error
