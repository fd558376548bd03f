"""The page of a suite: the worst drive first, each row leads to a page and a file, all figures are there."""

from __future__ import annotations

import re
from dataclasses import replace

from test_comparison import summary

from sfr_loc_map.metrics.score import Score
from sfr_loc_map.suite.page import render_summary
from sfr_loc_map.suite.summary import groups_of


def test_fifty_drives_each_with_its_links(score: Score) -> None:
    made = summary(score, {f"drive{number}": 1.0 + 0.01 * number for number in range(50)})
    page = render_summary(replace(made, groups=tuple(groups_of(made.drives, None))))
    assert re.findall(r'class="plot" id="([^"]+)"', page) == ["suite-errors"]
    rows = re.findall(r"<tr>.*?</tr>", page[page.index("Drives, the worst first") :], re.DOTALL)
    links = [re.findall(r'href="([^"]+)"', row) for row in rows if "<td" in row]
    expected = [drive.job.key for drive in reversed(made.drives)]
    assert links == [[f"pages/{key}.html", f"results/{key}.json"] for key in expected]
    assert page.count('href="suite.json"') == 1 + 3, "the runs, and three pooled errors"
