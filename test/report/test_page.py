"""The page of a score: its numbers are those of the JSON, texts are escaped, and no network is required."""

import html
import json
import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from helpers.made_scores import HOSTILE, dig, drive, json_of, place_of, whole_score, without
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_plain
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.report.drive_plots import drive_plots
from sfr_loc_map.report.limit_lines import error_axis
from sfr_loc_map.report.page import render_page, score_plots
from sfr_loc_map.report.path_plot import Curve, path_plot
from sfr_loc_map.report.plots import PALETTES, to_figure
from sfr_loc_map.report.printed_plot import printed_plots
from sfr_loc_map.report.test_report import render_test_report
from sfr_loc_map.tables.model import MILLIMETRE, number

CHROMIUM = Path("/usr/bin/chromium")
SWITCHES = (
    *("headless", "no-sandbox", "disable-gpu", "enable-unsafe-swiftshader", "no-first-run", "disable-sync"),
    *("disable-background-networking", "disable-component-update", "enable-logging=stderr"),
    *("window-size=1280,6000", "virtual-time-budget=30000", "blink-settings=preferredColorScheme=1"),
)
FLAGS = [*(f"--{switch}" for switch in SWITCHES), "--host-resolver-rules=MAP * ~NOTFOUND"]
"""Without what the browser itself would like to ask."""
OF_THE_BROWSER = "not an origin"
"""What the browser's log of its network says in place of the page that made a request."""


class Elements(HTMLParser):
    """All elements of a page with their attributes, what scripts hold, and value and text of the cells by key."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str]]] = [("", {})]
        self.scripts: list[str] = []
        self.cells: dict[str, tuple[str, str]] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))

    def handle_data(self, data: str) -> None:
        tag, attributes = self.found[-1]
        if tag == "script":
            self.scripts.append(data)
        if tag == "td" and "data-key" in attributes:
            self.cells.setdefault(attributes["data-key"], (attributes.get("data-value", ""), data))


def hostile_score() -> Score:
    """A score with markup in every text that may come from outside."""
    plain = json_of(whole_score())
    stage = {"subject": "timing", "figure": HOSTILE, "part": HOSTILE, "unit": HOSTILE, "n": 1, "mean": 1.0}
    plain["figures"].append(stage)
    plain["calls"] = {"clocks": {"localisation": HOSTILE}, "memory_method": HOSTILE}
    plain["verdicts"][0]["name"] = HOSTILE
    plain["details"]["calls"]["localisation"]["series"]["state"][0] = HOSTILE
    return from_plain(Score, plain)


@pytest.fixture(scope="module")
def page() -> str:
    return render_page(whole_score())


def specs_of(page: str) -> list[dict[str, Any]]:
    text = re.search(r'id="specs"[^>]*>(.*?)</script>', page, re.S)
    assert text is not None
    plots: list[dict[str, Any]] = json.loads(text[1])
    return plots


@pytest.mark.clause("4.2.3.1", "4.2.3.2", "4.2.3.3", "4.3.4")
def test_every_number_with_a_key_is_the_one_of_the_json(page: str) -> None:
    score, cells = json_of(whole_score()), Elements(page).cells
    exact = {key: float(value) for key, (value, _) in cells.items() if value}
    assert len(exact) > 100
    assert exact == {key: dig(score, key) for key in exact}
    key = f"{place_of(whole_score(), 'heading')}.mean_plus_3sigma"
    assert cells[key][1] == number(exact[key])
    key = f"{place_of(whole_score(), 'position')}.mean"
    assert cells[key][1] == number(exact[key], unit=MILLIMETRE)


def test_nothing_is_loaded_from_elsewhere(page: str) -> None:
    elements = Elements(page)
    loading = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"}
    assert [(tag, a) for tag, a in elements.found if loading & a.keys() and a.get("href", "")[:1] != "#"] == []
    assert {tag for tag, _ in elements.found} & {"link", "iframe", "object", "embed", "base", "img"} == set()
    style = re.search(r"<style>(.*?)</style>", page, re.S)
    assert style is not None
    assert not re.search(r"url\(|@import", style[1])
    policy = next(a["content"] for tag, a in elements.found if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    assert "connect-src" not in policy
    assert not re.search(r"https?://", page)


def test_figures_show_the_values_of_the_score(page: str) -> None:
    plain, plots = json_of(whole_score()), {plot["name"]: plot for plot in specs_of(page)}
    rows, marked = plain["details"]["trajectory"]["sub_trajectories"][0], plots["position"]["data"][0]
    names = ("start_frame", "end_frame", "start_stamp_ns", "end_stamp_ns")
    wanted = [[a, b, str(c), str(d)] for a, b, c, d in zip(*(rows[name] for name in names), strict=True)]
    assert [item[1:] for item in marked["customdata"]] == wanted, "a mark leads back to frames and exact stamps"
    assert wanted[0][2] == "1700000000123456789"
    sizes = [math.hypot(*vector) for vector in zip(rows["x_m"], rows["y_m"], rows["z_m"], strict=True)]
    assert marked["y"] == pytest.approx([size * 1e3 for size in sizes], rel=1e-5)
    laws = (trace for trace in plots["over-range"]["data"] if trace["name"].startswith("law"))
    law = next(trace for trace in laws if trace["text"][0] == "1 px ")
    assert law["y"] == pytest.approx([1e3 * r * r / (96 * 0.8 * 0.25) for r in law["x"]], rel=1e-4)


def test_hostile_texts_stay_texts(page: str) -> None:
    hostile = render_page(hostile_score())
    elements = Elements(hostile)
    assert not any("onerror" in attributes for _, attributes in elements.found)
    assert len(elements.scripts) == len(Elements(page).scripts)
    assert not any("alert(1)" in text and "\\u003c" not in text for text in elements.scripts)
    assert html.escape(HOSTILE) in hostile
    assert HOSTILE not in hostile


@pytest.mark.parametrize("part", ["trajectory", "map", "timing", "memory", "completeness", "details", "provenance"])
def test_each_part_may_be_absent_and_without_figures_there_is_no_script(part: str) -> None:
    score = (
        replace(whole_score(), **{part: None}) if part in ("details", "provenance") else without(whole_score(), part)
    )
    text = render_page(score, plots=part != "details")
    assert "<h1>" in text
    assert ("<script" in text) == (part != "details")


PROBE = """<script>
const wait = setInterval(() => {
  const root = document.documentElement;
  if (!root.dataset.figures) return;
  clearInterval(wait);
  root.dataset.before = root.dataset.theme;
  const mark = document.getElementById("position").data[0].customdata[4];
  document.getElementById("position").emit("plotly_click", { points: [{ customdata: mark }] });
  const view = document.getElementById("top-view");
  const shown = view.data.find((trace) => trace.name === "chosen sub-trajectory");
  root.dataset.shown = [shown.x.length, mark[2] - mark[1] + 1, shown.x[0]].join(" ");
  document.getElementById("theme").click();
}, 50);
</script>"""


def opened(path: Path, tmp_path: Path) -> tuple[str, str, set[str]]:
    """Return the root of a page after its script has run, what the browser logged, and what the page asked for."""
    if not CHROMIUM.is_file():
        pytest.skip(f"no {CHROMIUM}: install chromium to open the page")
    profile, net = tmp_path / "profile", tmp_path / "net.json"
    command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={profile}", f"--log-net-log={net}", "--dump-dom"]
    run = subprocess.run([*command, path.as_uri()], capture_output=True, text=True, timeout=100)
    shutil.rmtree(profile, ignore_errors=True)
    asked = [
        event["params"] for event in json.loads(net.read_text())["events"] if "initiator" in event.get("params", {})
    ]
    urls = {item["url"] for item in asked if "url" in item and item["initiator"] != OF_THE_BROWSER}
    root = re.search(r"<html[^>]*>", run.stdout)
    assert root is not None
    return root[0], run.stderr, {url for url in urls if not url.startswith(("file:", "data:", "blob:"))}


def test_in_a_browser_all_is_drawn_a_click_shows_the_frames_and_the_button_the_other_theme(
    page: str, tmp_path: Path
) -> None:
    path, asking, count = tmp_path / "report.html", tmp_path / "asking.html", len(specs_of(page))
    path.write_text(page.replace("</body>", PROBE + "</body>"))
    root, log, urls = opened(path, tmp_path)
    for words in (f'data-figures="{count}/{count}"', 'data-before="light"', 'data-theme="dark"'):
        assert words in root, log
    details = json_of(whole_score())["details"]["trajectory"]
    rows = details["sub_trajectories"][0]
    first, last = rows["start_frame"][4], rows["end_frame"][4]
    assert f'data-shown="{last - first + 1} {last - first + 1} {details["path"]["truth_x_m"][first]}"' in root
    console = [text for text in log.splitlines() if "CONSOLE" in text]
    assert not [text for text in console if re.search("error|refused|violat|not defined", text, re.I)]
    assert not urls
    asking.write_text("<!DOCTYPE html><img src='http://elsewhere.invalid/image.png'>")
    assert opened(asking, tmp_path)[2] == {"http://elsewhere.invalid/image.png"}, "a request would be seen"


PRINT_PROBE = """<script>
const wait = setInterval(() => {
  const root = document.documentElement;
  if (!root.dataset.figures) return;
  clearInterval(wait);
  window.dispatchEvent(new Event("beforeprint"));
  setTimeout(() => {
    const inside = (plot) => [...plot.querySelectorAll('[class*="title"] text, text[class*="title"]')];
    const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
    const overlaps = [];
    let drawn = 0;
    for (const plot of document.querySelectorAll(".plot")) {
      const size = plot.querySelector(".main-svg").getBoundingClientRect();
      if (size.width > 300 && size.width <= 703 && size.height <= 900) drawn += 1;
      const titles = [...new Set(inside(plot))].filter((text) => text.textContent);
      const boxes = titles.map((text) => text.getBoundingClientRect());
      boxes.forEach((box, k) => boxes.slice(k + 1).forEach((other) => {
        if (overlap(box, other)) overlaps.push(plot.id);
      }));
      if (boxes.some((box) => box.left < size.left - 1 || box.top < size.top - 1 || box.bottom > size.bottom + 1)) {
        overlaps.push("cut-" + plot.id);
      }
    }
    root.dataset.paper = [root.dataset.theme, drawn + "/" + document.querySelectorAll(".plot").length].join(" ");
    root.dataset.overlaps = [...new Set(overlaps)].join(" ");
  }, 3000);
}, 50);
</script>"""


def test_on_paper_every_figure_is_there_as_wide_as_the_page_and_no_title_is_covered(page: str, tmp_path: Path) -> None:
    """A4 less its margins is 703 CSS pixels wide."""
    path, count = tmp_path / "report.html", len(specs_of(page))
    path.write_text(page.replace("</body>", PRINT_PROBE + "</body>"))
    root, log, _ = opened(path, tmp_path)
    assert f'data-paper="light {count}/{count}"' in root, (root, log)
    assert 'data-overlaps=""' in root, root


def test_ticks_are_numbers_in_full_whatever_their_size() -> None:
    """Coordinates of a map have millions of metres, which plotly shortens to 5.40014M by itself."""
    plots = [plot for _, group in score_plots(whole_score(100, 48, 2)) for plot in group]
    axes = [axis for plot in plots for name, axis in to_figure(plot).to_dict()["layout"].items() if "axis" in name]
    assert len(axes) > 10
    assert {axis.get("exponentformat") for axis in axes} == {"none"}


def test_a_notebook_shows_a_cloud_in_the_colours_of_the_page() -> None:
    plots = {plot.name: plot for _, group in score_plots(whole_score()) for plot in group}
    scene, light = to_figure(plots["cloud"]).layout.scene, PALETTES["light"]
    assert {scene[name].gridcolor for name in ("xaxis", "yaxis", "zaxis")} == {light["grid"]}
    assert scene.xaxis.title.text == "x of LM, m", "the settings of the plot remain"


@pytest.mark.parametrize("name", ["@drive.csv", "@truth"])
def test_the_name_of_a_file_is_not_read_as_a_colour(name: str) -> None:
    curve = Curve(name, "@one", np.arange(3.0), np.zeros((3, 3)))
    trace = to_figure(path_plot([curve])).data[0]
    assert trace.name == f"&#64;{name[1:]}"
    assert trace.line.color == PALETTES["light"]["one"]


def test_two_requirements_on_one_statistic_are_both_drawn() -> None:
    score = whole_score()
    limit = score.verdicts[0]
    assert limit.value is not None
    limits = [0.5 * limit.value, 0.7 * limit.value]
    judged = replace(score, verdicts=tuple(replace(limit, limit=value) for value in (*limits, limits[0])))
    plots = {plot.name: plot for _, group in score_plots(judged) for plot in group}
    drawn = [trace["y"][0] for trace in plots["position"].data if trace["name"] == "limit of mean + 3 sigma, 5 m"]
    assert drawn[0] / drawn[1] == pytest.approx(0.5 / 0.7, rel=1e-3)
    assert len(drawn) == 2, "a limit that is stated twice is one line"
    printed = printed_plots(judged)[0]
    texts = [*(level.text for level in printed.levels), *printed.beyond.split(", ")]
    assert len([text for text in texts if text.startswith("limit of mean + 3 sigma ")]) == 2


def test_an_error_of_zero_is_drawn_although_its_limit_is_far_above() -> None:
    assert error_axis("error", [1.0, 2.0], [100.0]).get("type") == "log"
    assert error_axis("error", [0.0, 2.0], [100.0]).get("type") is None


def test_limits_are_drawn_beside_their_figure_and_do_not_flatten_it() -> None:
    score = whole_score()
    limit = score.verdicts[0]
    assert limit.value is not None
    for factor, scale in ((0.5, None), (100.0, "log")):
        judged = replace(score, verdicts=(replace(limit, limit=factor * limit.value),))
        plots = {plot.name: plot for _, group in score_plots(judged) for plot in group}
        (drawn,) = (trace for trace in plots["position"].data if trace["name"] == "limit of mean + 3 sigma, 5 m")
        assert "visible" not in drawn
        assert plots["position"].layout["yaxis"].get("type") == scale
        shown = max(trace["y"][0] for trace in plots["position"].data if trace["name"] == "mean + 3 sigma, 5 m")
        assert drawn["y"][0] / shown == pytest.approx(factor, rel=1e-3)


def test_limited_conditions_are_drawn_first() -> None:
    estimates, truth = drive(300)
    made = score_trajectory(estimates, truth, TrajectoryScoreConfig(conditions=("distance=1", "distance=5")))
    score = Score(figures=made.figures, association=made.association, details=Details(trajectory=made.details))
    entries = [{"condition": "distance=5", "heading_mean_plus_3sigma_deg": 1e-9}]
    judged = judged_by(score, parse_limits({"trajectory": entries}, "test"))
    plots = {plot.name: plot for plot in drive_plots(judged)}
    for name in ("top-view", "directions", "angles", "position"):
        marks = [trace for trace in plots[name].data if "sub-trajectory" in trace.get("hovertemplate", "")]
        assert marks[0]["customdata"][0][0] == "5 m", name


@pytest.mark.parametrize(("limits_m", "axis"), [((1.0, 1e-4), "log"), ((1e-4, 1000.0), None)])
def test_a_hidden_limit_does_not_scale_the_axis(limits_m: tuple[float, float], axis: str | None) -> None:
    estimates, truth = drive(300)
    made = score_trajectory(estimates, truth, TrajectoryScoreConfig(conditions=("distance=1", "distance=5")))
    score = Score(figures=made.figures, association=made.association, details=Details(trajectory=made.details))
    entries = [
        {"condition": condition, "position_mean_plus_3sigma_m": limit_m}
        for condition, limit_m in zip(("distance=1", "distance=5"), limits_m, strict=True)
    ]
    judged = judged_by(score, parse_limits({"trajectory": entries}, "test"))
    plots = {plot.name: plot for plot in drive_plots(judged)}
    assert plots["position"].layout["yaxis"].get("type") == axis


def test_the_band_of_an_unsigned_error_is_not_negative() -> None:
    plots = {plot.name: plot for plot in drive_plots(whole_score())}
    bands = [min(trace["y"]) for trace in plots["angles"].data if trace["name"] == "mean ± 3 sigma"]
    assert len(bands) == 2
    assert bands[0] < 0.0 <= bands[1]


WIDTH_PROBE = """<script>
const table = document.getElementById("results");
document.documentElement.dataset.width = table.getBoundingClientRect().width <= 703;
</script>"""


def test_the_results_of_a_test_report_fit_on_paper(tmp_path: Path) -> None:
    text = render_test_report([whole_score()]).replace("@media print", "@media all")
    text = re.sub('<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    text = text.replace("<body>", '<body style="width: 703px">')
    path = tmp_path / "report.html"
    path.write_text(text.replace("</body>", WIDTH_PROBE + "</body>"))
    assert 'data-width="true"' in opened(path, tmp_path)[0]


@pytest.mark.parametrize("has_heading", [False, True])
def test_angles_without_errors_are_not_drawn(has_heading: bool) -> None:
    estimates, true = drive(300)
    quats = true.quats_xyzw if has_heading else np.zeros_like(true.quats_xyzw)
    truth = Truth(true.stamps_ns, true.positions, quats, has_tilt=False)
    driven = score_trajectory(estimates, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
    score = Score(figures=driven.figures, association=driven.association, details=Details(trajectory=driven.details))
    plots = {plot.name: plot for plot in drive_plots(score)}
    assert "position" in plots
    assert ("angles" in plots) is has_heading
    if has_heading:
        errors = [trace for trace in plots["angles"].data if trace["name"] == "sub-trajectory"]
        assert len(errors) == 1, "the truth has no tilt, so that attitude errors are unknown"
