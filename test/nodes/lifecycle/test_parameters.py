"""The parameter files are made from the declarations."""

import pytest
import yaml

from helpers import ROOT
from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.nodes.parameter_files import FILES, parameter_file

CONFIG = ROOT / "config"


@pytest.mark.parametrize("name", FILES)
def test_parameter_files_hold_all_fields_at_their_defaults(name: str) -> None:
    node_name, config_type = FILES[name]
    text = (CONFIG / name).read_text(encoding="utf-8")
    assert text == parameter_file(node_name, config_type), "run: python -m sfr_loc_map.nodes.parameter_files config"
    content = yaml.safe_load(text)[f"/**/{node_name}"]["ros__parameters"]

    def flat(block: dict, prefix: str = "") -> dict:
        found = {}
        for key, value in block.items():
            found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        return found

    values = {n: tuple(v) if isinstance(v, list) else v for n, v in flat(content).items()}
    assert values == flatten(config_type())
