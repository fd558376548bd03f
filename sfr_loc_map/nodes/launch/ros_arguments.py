"""The ROS arguments of nodes: from the options of `sfr run`, and from an `sfr.yaml`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import yaml

from sfr_loc_map.configuration.nodes import node_parameters
from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import check_regular, refusing
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.nodes.launch.node_sections import check_sections
from sfr_loc_map.suite_names import MONITOR_NODE, Task
from sfr_loc_map.topics import COMPRESSED_END

ROS_ARGS = "--ros-args"
NODE_OF_RULE = re.compile(r"\w+:(?!=|//)")  #: Node to which a remapping rule is limited: `NODE:` in `NODE:FROM:=TO`.


def ros_arguments(
    more: Sequence[str],
    config: Path | None,
    written: Path,
    *,
    nodes: Sequence[str],
    parameter_files: Sequence[Path] = (),
    remaps: Sequence[str] = (),
    namespace: str = "",
    log_level: str = "info",
) -> list[str]:
    """Return the ROS arguments of `nodes`, `--ros-args` first and the further arguments `more` last.

    The parameters of an `sfr.yaml` are written to the file `written`. Later arguments override them.
    """
    arguments = [ROS_ARGS, *(arguments_of_config(config, written) if config is not None else ())]
    arguments += ["--log-level", log_level]
    for path in parameter_files:
        with refusing(f"cannot read '{path}'", "give a parameter file such as those in config/"):
            check_regular(path)
        check_sections(path, nodes, namespace)
        arguments += ["--params-file", str(path)]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    for rule in remaps:
        arguments += ["-r", rule]
    return [*arguments, *more]


def split_ros_arguments(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the words before `--ros-args` and those after it."""
    given = list(words)
    cut = given.index(ROS_ARGS) if ROS_ARGS in given else len(given)
    return given[:cut], given[cut + 1 :]


def arguments_of_config(config: Path, written: Path) -> list[str]:
    """Return the arguments of the nodes for an `sfr.yaml`, and write their parameters to a file.

    Settings that apply only to recordings raise a ConfigError, because a node receives topics as drivers publish them.
    """
    given = Configuration.read(config)
    how = SourceConfig.of(given)
    if how.calibration != CalibrationConfig() or how.sync.right_offset_s:
        raise ConfigError(
            f"'{config}': calibration and sync.right_offset_s apply only to recordings: publish camera_info "
            "for both cameras and stamp both images with one clock; to play a recording, convert it first (sfr convert)"
        )
    if "record" in (how.sync.stamps, how.truth.stamps):
        raise ConfigError(
            f"'{config}': 'sync.stamps: record' and 'truth.stamps: record' apply only to recordings: omit them, "
            "and stamp the messages when they are published"
        )
    found = node_parameters(
        {
            "localisation": changed(given.build(LocalisationConfig, "localisation")),
            "mapping": changed(given.build(MappingConfig, "mapping")),
            "monitor": given.section("monitor"),
            "truth": changed(replace(how.truth, source="", columns="")),
            "extrinsics": changed(how.extrinsics),
            "sync": {"stamp_tolerance_s": how.sync.stamp_tolerance_s},
        }
    )
    if how.frames.base:
        found[Task.LOCALISATION.node]["rb_frame"] = how.frames.base
    if limits := given.sections.get("limits"):
        found[MONITOR_NODE]["limits_file"] = str((given.folder / limits).resolve())
    if conditions := given.sections.get("conditions"):
        found[MONITOR_NODE]["score.trajectory.conditions"] = conditions
    for task in Task:
        raw = f"{task.rig}/left/image_raw"
        names = (name.removesuffix(COMPRESSED_END) for name in how.topics)
        found[task.node]["input.rectify"] = any(name.endswith(raw) for name in names)
    return [*write_parameters(found, written), *(word for rule in remaps_of(how) for word in ("-r", rule))]


def write_parameters(parameters: Mapping[str, Mapping[str, object]], path: Path) -> list[str]:
    """Write the parameters of each node to a file; return the arguments that name the file."""
    content = {f"/**/{node}": {"ros__parameters": dict(values)} for node, values in parameters.items()}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return ["--params-file", str(path)]


def remaps_of(how: SourceConfig) -> list[str]:
    """Return the topics of a configuration as remapping rules; topics of compressed images end in `/compressed`."""
    rules = []
    for name, topic in how.topics_and_truth.items():
        is_compressed = topic.endswith(COMPRESSED_END) and not name.endswith(COMPRESSED_END)
        rules.append(f"{name}{COMPRESSED_END if is_compressed else ''}:={topic}")
    return rules


def topic_rules(arguments: Sequence[str]) -> list[str]:
    """Return the remapping rules of topics in the arguments of nodes, as `FROM:=TO` without the name of a node."""
    given = [rule for word, rule in pairwise(arguments) if word in {"-r", "--remap"}]
    rules = [rule[found.end() :] if (found := NODE_OF_RULE.match(rule)) else rule for rule in given]
    return [rule for rule in rules if not rule.startswith("__")]
