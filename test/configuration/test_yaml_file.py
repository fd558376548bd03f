"""Files of YAML that are not a mapping, unusual names and numbers, and values as one line."""

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.configuration.yaml_file import load_yaml, yaml_text
from sfr_loc_map.errors import ConfigError

BOMB = "a0: &a0 {x: 1}\n" + "".join(f"a{i + 1}: &a{i + 1} {{x: *a{i}, y: *a{i}}}\n" for i in range(30))
"""A mapping of 2^30 values in 30 lines."""


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a: [1", "not valid YAML"),
        (b"\xff\xfe\xff", "not valid YAML"),
        (b"- 1\n- 2", "names with values"),
        (b"a: !!python/object:os.system {}", "not valid YAML"),
        (b"a: " + b"9" * 400, "an integer of 400 digits"),
        (b"[" * 1000, "nested too deeply"),
        (b"a: &a [*a]", "within its own anchor"),
        (b"a: 1\nb: {c: 1, c: 2}", "'c' occurs twice, the second time in line 2"),
        (b"yes: 1\ntrue: 2", "'true' occurs twice, the second time in line 2"),
        (b"a: {1: 1, 01: 2}", "'01' occurs twice"),
        (BOMB.encode(), "aliases expand to more than 100000 values"),
        (b"#" * 1_000_001, "larger than 1 MB"),
        (None, "cannot read '.*c.yaml': No such file"),
    ],
)
def test_files_that_are_no_mapping(tmp_path: Path, content: bytes | None, words: str) -> None:
    path = tmp_path / "c.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        load_yaml(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_and_merged_maps_of_yaml(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    lines = ["a: &a {x: 1}", "b: &b {y: 1e-3}", "c: {<<: *a, <<: *b, x: 2}"]
    lines += ["d: {1e-3: 1.5e3, 1: one, '1': text}", "e: [1:30, 1:30.5]", "f: [030, 08, -.5, 0x1F, .inf]"]
    path.write_text("\n".join(lines))
    content = load_yaml(path)
    assert content["c"] == {"x": 2, "y": 0.001}
    assert content["e"] == ["1:30", "1:30.5"], "not numbers of base 60"
    assert content["f"] == [30, 8, -0.5, 31, math.inf], "not octal"
    assert content["d"] == {"1e-3": 1500.0, 1: "one", "1": "text"}


@given(st.one_of(st.text(max_size=8), st.lists(st.text(max_size=8) | st.integers(), max_size=3)))
def test_a_value_is_one_line_of_yaml_and_is_read_back(value: object) -> None:
    text = yaml_text(value)
    assert len(text.splitlines()) == 1
    assert yaml.safe_load(text) == value
