"""The page of a suite of fifty drives in a real browser: all figures are drawn, each row leads to a file."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from test_comparison import summary

from sfr_loc_map.metrics.score import Score
from sfr_loc_map.suite.page import render_summary
from sfr_loc_map.suite.summary import groups_of

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
DRIVES = 50


@pytest.mark.slow
def test_fifty_drives_in_a_browser(score: Score, tmp_path: Path) -> None:
    if not CHROMIUM.is_file():
        pytest.skip(f"no {CHROMIUM}: install chromium to open the page")
    made = summary(score, {f"drive{number}": 1.0 + 0.01 * number for number in range(DRIVES)})
    timed = tuple(replace(drive, seconds=2.0) for drive in made.drives)
    page = tmp_path / "report.html"
    page.write_text(render_summary(replace(made, drives=timed, groups=tuple(groups_of(timed, None)))))
    command = [str(CHROMIUM), *FLAGS, "--virtual-time-budget=30000", f"--user-data-dir={tmp_path / 'profile'}"]
    run = subprocess.run([*command, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=100)
    shutil.rmtree(tmp_path / "profile", ignore_errors=True)
    assert 'data-figures="2/2"' in run.stdout, run.stderr
    rows = re.findall(r"<tr>.*?</tr>", run.stdout[run.stdout.index("Drives, the worst first") :], re.DOTALL)
    links = [re.findall(r'href="([^"]+)"', row) for row in rows if "<td" in row]
    expected = [drive.job.key for drive in reversed(made.drives)]
    assert links == [[f"pages/{key}.html", f"results/{key}.json"] for key in expected]
    assert run.stdout.count('href="suite.json"') == 1 + 3, "the runs, and three pooled errors"
