"""Parameters are declared once, checked, flattened and rebuilt without a difference."""

import math
import re
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.configuration.parameters import build, flatten, param, parameters
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.simulation.config import SimulationConfig


@dataclass(frozen=True, slots=True)
class Matcher:
    max_disparity: int = param(64, unit="px", doc="Largest disparity.", low=1, high=256)
    method: str = param("blocks", doc="Way of matching.", choices=("blocks", "pixels"))


@dataclass(frozen=True, slots=True)
class Whole:
    voxel_m: float = param(0.05, unit="m", doc="Edge of a voxel.", low=0.001, high=10.0)
    fill: bool = param(False, doc="Close holes.")
    ranges_m: tuple[float, ...] = param((1.0, 2.0), unit="m", doc="Bounds of ranges.", low=0.0, high=100.0)
    centre_m: tuple[float, float] = param((0.0, 0.0), unit="m", doc="Centre.", low=-1.0, high=1.0)
    labels: tuple[str, ...] = param(("a",), doc="Words.")
    ends: tuple[str, str] = param(("a", "b"), doc="First and last word.")
    matcher: Matcher = field(default_factory=Matcher)


wholes = st.builds(
    Whole,
    voxel_m=st.floats(0.001, 10.0),
    fill=st.booleans(),
    ranges_m=st.lists(st.floats(0, 100.0), max_size=4).map(tuple),
    labels=st.lists(st.text(max_size=5), max_size=3).map(tuple),
    matcher=st.builds(Matcher, max_disparity=st.integers(1, 256), method=st.sampled_from(["blocks", "pixels"])),
)


@given(wholes)
def test_build_of_flatten_is_the_same(config: Whole) -> None:
    assert build(Whole, flatten(config)) == config


def test_nested_names_in_both_forms_and_whole_numbers_where_they_mean_the_same() -> None:
    for values in ({"matcher.max_disparity": 8}, {"matcher": {"max_disparity": 8}}):
        assert build(Whole, values) == replace(Whole(), matcher=Matcher(max_disparity=8))
    built = build(Whole, {"voxel_m": 1, "ranges_m": [1, 2.5], "labels": []})
    assert built == replace(Whole(), voxel_m=1.0, ranges_m=(1.0, 2.5), labels=())
    assert build(Whole, {"centre_m": (np.float32(0.5), np.int64(1))}).centre_m == (0.5, 1.0)
    assert build(Whole, {"matcher": None}) == build(Whole, {"matcher": {}}) == Whole()
    assert (type(built.voxel_m), type(built.ranges_m[0])) == (float, float)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"voxel": 1.0}, "unknown key 'voxel' (did you mean 'voxel_m'?)"),
        (
            {"matcher": {"max_dispariti": 3}},
            "unknown key 'matcher.max_dispariti' (did you mean 'matcher.max_disparity'?)",
        ),
        ({"voxel_m": 0.0}, "'voxel_m' is 0.0: 0.001 to 10.0 m is required"),
        ({"voxel_m": float("nan")}, "'voxel_m' is nan: 0.001 to"),
        ({"fill": 1}, "'fill' is 1: true or false is required"),
        ({"matcher.method": "block"}, "'matcher.method' is 'block': one of blocks, pixels"),
        ({"ranges_m": [1.0, -1.0]}, "'ranges_m' is -1.0: 0.0 to 100.0 m is required"),
        ({"voxel_m": 10**400}, "a number is required"),
        ({"ranges_m": 1.0}, "a list of numbers is required"),
        ({"centre_m": [1.0]}, "'centre_m' is [1.0]: a list of 2 numbers is required"),
        ({"ends": ["a"]}, "'ends' is ['a']: a list of 2 texts is required"),
        ({"labels": [1]}, "'labels' is [1]: a list of texts is required"),
        ({"matcher": 5}, "'matcher' is 5: a mapping of names to values is required"),
        ({"matchr": {}}, "unknown key 'matchr' (did you mean 'matcher.method'?)"),
        ({"voxel_m": {}}, "'voxel_m' is {}: a number is required"),
        ({"voxel": 1.0, "fill": 1}, "unknown key 'voxel' (did you mean 'voxel_m'?); 'fill' is 1"),
    ],
)
def test_wrong_values_are_one_line_with_the_origin(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)) as caught:
        build(Whole, values, origin="some.yaml")
    assert str(caught.value).startswith("some.yaml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("config_type", [LocalisationConfig, MappingConfig, ScoreConfig, SimulationConfig])
def test_every_number_of_the_suite_refuses_infinity(config_type: type) -> None:
    for info in parameters(config_type):
        for absurd in (math.inf, -math.inf, math.nan, 1e300) if info.type in (int, float, tuple[float, ...]) else ():
            with pytest.raises(ConfigError, match=f"'{info.name}'"):
                build(config_type, {info.name: (absurd,) if isinstance(info.default, tuple) else absurd})


@pytest.mark.parametrize("wrong", [float | None, complex, list[float], tuple[float, Path]])
def test_a_parameter_of_another_type_is_refused_at_its_first_use(wrong: type) -> None:
    cls = make_dataclass("Other", [("value", wrong, param(None, doc="Any value."))], frozen=True)
    with pytest.raises(TypeError, match="the parameter value has the type"):
        build(cls, {"value": "x"})
