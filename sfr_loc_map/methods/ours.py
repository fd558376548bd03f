"""The suite's own localiser and mapper with the interface of a candidate: a rig, and parameters as YAML or JSON."""

from __future__ import annotations

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.json_yaml import parse_yaml
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper


def localiser(rig: StereoRig, config: str) -> Localiser:
    """Return our localiser, which starts at the identity."""
    return Localiser(rig, build(LocalisationConfig, parse_yaml(config) or {}), Transform.identity())


def mapper(rig: StereoRig, config: str) -> Mapper:
    """Return our mapper."""
    return Mapper(rig, build(MappingConfig, parse_yaml(config) or {}))
