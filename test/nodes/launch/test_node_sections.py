"""Parameter files of `sfr run`: a file without parameters, and sections that resemble a node but apply to none."""

from pathlib import Path

import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.launch.node_sections import check_sections

PARAMETERS = "{ros__parameters: {queue_size: 3}}"


@pytest.mark.parametrize(
    ("text", "namespace", "is_refused"),
    [
        (f"localisation_node: {PARAMETERS}", "", False),
        (f"/**: {PARAMETERS}", "rover", False),
        (f"/**/localisation_node: {PARAMETERS}", "", False),
        (f"/**/localisation_node: {PARAMETERS}", "mars/rover", False),
        (f"rover: {{localisation_node: {PARAMETERS}}}", "rover", False),
        (f"amcl: {PARAMETERS}", "", False),  # another stack's file
        (f"localization_node: {PARAMETERS}\nlocalisation_node: {PARAMETERS}", "", False),
        (f"localization_node: {PARAMETERS}", "", True),
        (f"/rover/localisation_node: {PARAMETERS}", "", True),
        (f"localisation_node: {PARAMETERS}", "rover", True),
        ("extrinsics: {translation_m: [0, 0, 0]}", "", True),  # an sfr.yaml
        ("localisation_node: {queue_size: 3}", "", True),
        ("", "", True),
    ],
)
def test_a_file_whose_parameters_would_have_no_effect_is_refused(
    tmp_path: Path, text: str, namespace: str, is_refused: bool
) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    if not is_refused:
        check_sections(path, ["localisation_node"], namespace)
        return
    with pytest.raises(ConfigError, match=r"parameters\.yaml"):
        check_sections(path, ["localisation_node"], namespace)
