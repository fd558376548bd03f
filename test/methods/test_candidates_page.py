"""The commands of docs/candidates.md do what the page says."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import ROOT
from helpers.cli_result import Sfr
from helpers.score_rows import number

PAGE = (ROOT / "docs" / "candidates.md").read_text(encoding="utf-8").partition("\n## A ROS node")[0]


@pytest.mark.clause("4.2.1", "4.3.1")
@pytest.mark.slow
def test_the_commands_on_the_page_work(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sfr: Sfr) -> None:
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler (cc)")
    monkeypatch.chdir(tmp_path)
    for name in ("examples", "include"):
        Path(name).symlink_to(ROOT / name)
    blocks = "".join(block for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) if "METHOD" not in block)
    lines = blocks.replace("\\\n", "").splitlines()
    for line in lines:
        line = line.replace("sample/sample.mcap", str(drive)).replace("$(sfr bench methods --include-dir)", "include")
        if line.startswith("sfr "):  # within this process: starting one takes longer than the work
            condition = ("--condition", "frames=3") if " score " in line else ()
            result = sfr(*shlex.split(line)[1:], *condition)
            assert result.code == 0, result.err
        else:
            subprocess.run(["sh", "-ec", re.sub("^python", sys.executable, line)], check=True)
    still, c, target = (json.loads(Path(name).read_text()) for name in ("still.json", "c.json", "target.json"))
    assert len(lines) == 9  # among them the time on the target, by a program without this suite
    assert still["method"]["kind"] == "python"
    assert c["method"]["kind"] == "library"
    assert number(still, "position", "mean") > 3 * number(c, "position", "mean")
    counts = {name: number(target, name, "n", part="target") for name in ("localisation", "mapping_call")}
    assert counts == {"localisation": 12, "mapping_call": 1}
