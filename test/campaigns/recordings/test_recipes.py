"""The commands of the recipes work on a recording of their camera, and write the configuration on the page."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from campaigns.recordings.drive import Drive, load_drive
from campaigns.recordings.rows import ROWS
from helpers import ROOT
from helpers.cli_result import Sfr

HOWTO = ROOT / "docs" / "howto"
PAGES = {
    HOWTO / "cameras.md": ("zed", "realsense_without_p3", "oak_d"),
    HOWTO / "nav2_rover.md": ("nav2_rover", "motion_capture_lab"),
    HOWTO.parent / "formats.md": ("kalibr_yaml", "side_by_side", "pan_tilt_joints"),
}
"""The recordings of each page, in the order of its commands and configurations.

A single command on a page applies to all recordings of the page."""
INIT = re.compile(r"^sfr (init .*--from (\S+).*)$", re.MULTILINE)
SHOWN = re.compile(r"```yaml\n(.*?)```", re.DOTALL)
OF_THE_DRIVE = ("conditions", "limits")  # the drive of the page is longer


@pytest.fixture(scope="module")
def drive() -> Drive:
    return load_drive(4)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_recipe_give_what_it_shows(
    page: Path, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sfr: Sfr
) -> None:
    text = page.read_text(encoding="utf-8").replace("\\\n", "")
    names = PAGES[page]
    commands = INIT.findall(text)
    commands *= len(names) if len(commands) == 1 else 1
    configurations = SHOWN.findall(text) or ["{}"] * len(names)
    for name, (command, source), configuration in zip(names, commands, configurations, strict=True):
        place = tmp_path / name
        place.mkdir()
        monkeypatch.chdir(place)
        ROWS[name].make(place, drive).source.rename(source)
        result = sfr(*shlex.split(command))
        assert result.code == 0, result.err
        written = yaml.safe_load(Path("sfr.yaml").read_text(encoding="utf-8"))
        for section, values in yaml.safe_load(configuration).items():
            if section == "extrinsics":
                assert all(written[section][n] == pytest.approx(v, abs=1e-5) for n, v in values.items())
            elif section not in OF_THE_DRIVE:
                assert written[section] == values
        assert sfr("info", source).code == 0
