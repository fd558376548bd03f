"""The arguments of the nodes that an `sfr.yaml` describes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.config import changed, read_config, read_sections, section
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.topics import COMPRESSED_END


def run_arguments(config: Path, written: Path) -> list[str]:
    """Return the arguments of the nodes that an `sfr.yaml` comes to; their parameters are written to a file.

    ConfigError for what only a recording can be read with: a node takes topics as their drivers publish them.
    """
    sections = read_sections(config)
    how = SourceConfig.of(sections, config)
    if how.calibration != CalibrationConfig() or how.sync.right_offset_s:
        raise ConfigError(
            f"'{config}': calibration and sync.right_offset_s are for recordings: publish camera_info and images of "
            f"both sides by one clock, or convert the recording (sfr convert)"
        )
    if "record" in (how.sync.stamps, how.truth.stamps):
        raise ConfigError(
            f"'{config}': sync.stamps and truth.stamps of record are for recordings, whose times they take: stamp the "
            "messages when they are published"
        )
    values: dict[str, dict[str, Any]] = {
        "localisation": changed(read_config(LocalisationConfig, config, "localisation"), "localisation."),
        "mapping": changed(read_config(MappingConfig, config, "mapping"), "mapping."),
        "monitor": {**section(config, "monitor"), **changed(replace(how.truth, source="", columns=""), "truth.")},
    }
    values["localisation"] |= changed(how.extrinsics, "T_rb_locsb.")
    if how.frames.base:
        values["localisation"]["rb_frame"] = how.frames.base
    if isinstance(limits := sections.get("limits"), str):
        values["monitor"]["limits_file"] = str((config.parent / limits).resolve())
    if conditions := sections.get("conditions"):
        values["monitor"]["score.trajectory.conditions"] = conditions
    for task in ("localisation", "mapping"):
        values[task]["input.stamp_tolerance_s"] = how.sync.stamp_tolerance_s
        raw = f"{Task(task).rig}/left/image_raw"
        names = (name.removesuffix(COMPRESSED_END) for name in how.remap.values())
        values[task]["input.rectify"] = any(name.endswith(raw) for name in names)
    content = {f"/**/{name}_node": {"ros__parameters": parameters} for name, parameters in values.items()}
    written.write_text(yaml.safe_dump(content), encoding="utf-8")
    return ["--params-file", str(written), *(word for rule in remaps_of(how) for word in ("-r", rule))]


def remaps_of(how: SourceConfig) -> list[str]:
    """Return the topics of a configuration as remapping rules; compressed images have a name of their own."""
    rules = []
    for name, topic in how.topics.items():
        is_compressed = topic.endswith(COMPRESSED_END) and not name.endswith(COMPRESSED_END)
        rules.append(f"{name}{COMPRESSED_END if is_compressed else ''}:={topic}")
    return rules
