"""The test report and JUnit: figures are those of the JSON, links lead somewhere, a pipeline reads every state."""

import asyncio
import html
import json
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from helpers import ROOT
from helpers.browser import Browser
from helpers.cli_result import Sfr
from helpers.made_scores import HOSTILE, dig, drive, half, json_of, of_drive, of_map, whole_score, with_target, without
from sfr_loc_map.metrics.config import TrajectoryScoreConfig, VerdictState
from sfr_loc_map.metrics.figures.catalogue import CLAUSES
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord, TruthRecord
from sfr_loc_map.metrics.judging.judge import judged_by, with_verdicts
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.several_scores import common_verdict, each_by_its_limits
from sfr_loc_map.metrics.score.caveats import truth_caveats
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.metrics.stored.score_json import load_score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.report.deviations import deviations_of, is_of_stage
from sfr_loc_map.report.junit import junit
from sfr_loc_map.report.page import render_page
from sfr_loc_map.report.plotted_data import error_sizes
from sfr_loc_map.report.printed_plot import printed_plots
from sfr_loc_map.report.score_tables import READINGS, score_tables, view_table
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.report.test_report import clauses_used, render_test_report
from sfr_loc_map.report.verdict_view import VerdictView
from sfr_loc_map.suite_names import OURS

COMMANDS = ("sfr score estimate.csv data", "sfr score cloud.ply data", "sfr score target data")
TEN: dict[str, Any] = {
    "trajectory": [
        {
            "condition": "distance=5",
            "position_mean_plus_3sigma_m": {"limit": 0.02, "id": "R1", "text": HOSTILE, "certain": True},
            "attitude_mean_plus_3sigma_deg": {"limit": 0.5, "id": "R2", "text": "attitude"},
            "lost_max_share": {"limit": 0.0, "id": "R3"},
        },
        {"condition": "distance=500", "position_mean_plus_3sigma_m": {"limit": 0.1, "id": "R4"}},
    ],
    "map": {"point_error_p95_m": {"limit": 1.0, "id": "R5"}, "coverage_min": {"limit": 0.5, "id": "R6"}},
    "timing": {"localisation_p95_s": {"limit": 1.0, "id": "R7"}, "mapping_call_s": {"limit": 1.0, "id": "R8"}},
    "memory": {"localisation_peak_bytes": {"limit": 2e9, "id": "R9"}},
    "target": {"localisation_max_s": {"limit": 1.0, "id": "R10"}},
}


def scores() -> list[Score]:
    """A score with ten requirements, a map alone, and one of a part of the drive."""
    whole = whole_score()
    assert whole.provenance is not None
    parts = [with_target(whole), of_map(whole), half(of_drive(whole))]
    named = [
        replace(part, provenance=replace(whole.provenance, command=command))
        for part, command in zip(parts, COMMANDS, strict=True)
    ]
    return [judged_by(part, parse_limits(TEN, "test")) for part in named]


class Page(HTMLParser):
    """Places, links and figures of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.figures: list[tuple[int, str, str]] = []
        self.tags: set[str] = set()
        self._score = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.add(tag)
        self._score = int(found.get("data-score") or self._score)
        self.ids += [found["id"]] if found.get("id") else []  # type: ignore[list-item]
        self.links += [found["href"]] if found.get("href") else []  # type: ignore[list-item]
        if "data-value" in found:
            self.figures.append((self._score, str(found["data-key"]), str(found["data-value"])))


def test_every_figure_is_found_in_the_json_and_every_link_leads_to_its_clause_and_command() -> None:
    made = scores()
    made = each_by_its_limits(made)
    text = render_test_report(made)
    page, plain = Page(text), [json_of(score) for score in made]
    assert len(page.figures) > 100
    for score, key, value in page.figures:
        number, found = json.loads(value), dig(plain[score - 1], key)
        assert number == ([found["low95"], found["high95"]] if isinstance(number, list) else found), (score, key)
    assert len(set(page.ids)) == len(page.ids)
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    for command in COMMANDS:
        assert f"<code>{command}</code>" in text
    rows = re.findall(r'<tr data-score="1">(.*?)</tr>', text, re.DOTALL)
    assert len(rows) == 10
    for number, row in enumerate(rows, 1):
        assert f">R{number}<" in row
        assert 'href="#command-1"' in row
    with_clause = [number for number, row in enumerate(rows, 1) if 'href="#clause-' in row]
    assert with_clause == [1, 2, 4, 5, 9, 10]  # not those on what is lost, on coverage, and on times of the host
    assert "script" not in page.tags
    assert "img" not in page.tags
    headings = re.findall(r"<h2>(\d) ", text)
    assert headings == list("123456789")


def test_what_stands_first_is_the_worst_and_a_part_is_said_first() -> None:
    made = scores()
    assert "<strong>FAIL</strong>" in render_test_report(made)
    loose = parse_limits({"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 100.0}]}, "test")
    part, whole = judged_by(made[2], loose), judged_by(of_drive(made[0]), loose)
    assert (part.verdict, whole.verdict) == ("incomplete", "pass")
    assert "<strong>INCOMPLETE</strong>" in render_test_report([whole, part])
    assert part.verdicts[0].state is VerdictState.INCOMPLETE
    assert next(table for table in score_tables(part) if table.name == "verdicts").rows[0][0].text == "incomplete"


def test_every_limit_has_a_clause_of_the_list_or_none() -> None:
    for score in scores():
        assert {VerdictView.of(item).clause for item in score.verdicts} <= {*CLAUSES, ""}
    plain = Verdict(name="judged", limit=1.0, value=0.5, state=VerdictState.INCOMPLETE)
    assert VerdictView.of(plain).clause == ""


def test_what_the_truth_does_not_have_is_stated_once() -> None:
    truth = TruthRecord(attitude=False, yaw_deg=3.0)
    (warning,) = truth_caveats(truth)
    score = judged_by(replace(whole_score(), truth=truth, warnings=(warning, "another warning")), None)
    page = render_test_report([score])
    assert page.count("attitude and heading errors are unknown") == 1
    assert page.count("another warning") == 1


def test_the_memory_of_a_stage_follows_no_clause_and_is_a_deviation() -> None:
    limits = {f"{kind}_peak_bytes": 2e9 for kind in ("localisation", "mapping_call", "mapping")}
    content = {"memory": limits, "timing": {"mapping_p50_s": 1.0, "localisation_p50_s": 1.0}}
    score = judged_by(whole_score(), parse_limits(content, "test"), partial=True)
    found = {item.name: (VerdictView.of(item).clause, is_of_stage(item)) for item in score.on_limits}
    assert found == {
        "localisation_peak_bytes": ("4.2.2", False),
        "mapping_call_peak_bytes": ("4.3.2", False),
        "mapping_peak_bytes": ("", True),
        "mapping_p50_s": ("", True),
        "localisation_p50_s": ("", False),
    }
    deviations = re.findall("([a-z ]*) concerns a stage", render_test_report([score]))
    assert len(deviations) == 2, deviations


@pytest.mark.parametrize("kind", MethodKind)
def test_the_time_of_a_method_that_may_return_disparities_is_a_deviation(kind: MethodKind) -> None:
    """The suite triangulates disparities outside of the call. Libraries return points."""
    limits = parse_limits({"timing": {"mapping_p50_s": 1.0, "localisation_p50_s": 1.0}}, "test")
    may_return_disparities = kind not in (MethodKind.LIBRARY, MethodKind.EXTERNAL)
    for name, count in (("x", int(may_return_disparities)), (OURS, 0)):
        score = replace(whole_score(), method=MethodRecord(name=name, version="1", kind=kind))
        found = " ".join(deviations_of(judged_by(score, limits, partial=True)))
        assert found.count("does not contain the triangulation of disparity images") == count


def test_calls_that_were_not_measured_have_no_deviation() -> None:
    content = {"timing": {"mapping_p50_s": 1.0, "localisation_p50_s": 1.0}, "memory": {"mapping_peak_bytes": 2e9}}
    score = judged_by(of_drive(without(whole_score(), "timing")), parse_limits(content, "test"), partial=True)
    assert not [item for item in score.on_limits if item.subject == "timing" and item.value is not None]
    assert not [text for text in deviations_of(score) if "was measured on the host" in text and "time" in text]


def test_texts_of_a_user_are_printable() -> None:
    turned = "Rep\u202eort"
    made = whole_score().provenance
    assert made is not None
    files = {role: replace(file, path=turned) for role, file in made.inputs.items()}
    score = replace(whole_score(), provenance=replace(made, inputs=files, command=turned))
    page = render_page(score, plots=False)
    report = render_test_report([score], title=turned, number=turned, issue=turned)
    for text in (page, report):
        assert "\u202e" not in text
        assert "Rep\\u202eort" in text


def test_a_figure_without_a_clause_is_listed() -> None:
    made = scores()
    _, _, documents = render_test_report(made).partition("2 Documents</h2>")
    documents, _, _ = documents.partition("<h2>")
    without_clause = {VerdictView.of(item).name for score in made for item in score.verdicts} - {
        VerdictView.of(item).name for score in made for item in score.verdicts if VerdictView.of(item).clause
    }
    assert {"lost", "coverage"} <= without_clause
    assert all(html.escape(name) in documents for name in without_clause)


@pytest.mark.parametrize(("limit", "shown"), [(2e9, "2 GB"), (512e6, "512 MB"), (2.0**30, "1024 MiB")])
def test_a_limit_on_memory_has_the_unit_of_the_requirement(limit: float, shown: str) -> None:
    content = {"memory": {"localisation_peak_bytes": limit}}
    (item,) = judged_by(whole_score(), parse_limits(content, "test")).on_limits
    assert VerdictView.of(item).limit_text == f"≤ {shown}"


@pytest.mark.parametrize("width", [1100, 1400])
def test_the_results_fit_a_window(tmp_path: Path, width: int) -> None:
    path = tmp_path / "report.html"
    path.write_text(render_test_report(scores()))

    async def hidden_width() -> int:
        async with Browser(width) as browser:
            await browser.open(path.as_uri())
            await browser.wait_for("document.querySelector('#results')")
            table = "document.querySelector('#results').parentElement"
            return int(await browser.value(f"{table}.scrollWidth - {table}.clientWidth"))

    assert asyncio.run(hidden_width()) == 0


@pytest.mark.parametrize(
    ("limit", "value", "shown", "of_value"),
    [
        (0.24995, 0.2, "0.24995", "0.2"),
        (0.2120501, 0.1, "0.2120501", "0.1"),
        (0.21205, 0.212053073, "0.21205", "0.212053"),
        (0.21205, 0.21205, "0.21205", "0.21205"),
    ],
)
def test_a_limit_is_exact_and_the_value_shows_on_which_side_it_is(
    limit: float, value: float, shown: str, of_value: str
) -> None:
    item = Verdict(
        name="attitude_mean_deg", figure="attitude", statistic="mean", limit=limit, value=value, state=VerdictState.FAIL
    )
    view = VerdictView.of(item)
    assert view.limit_text == f"≤ {shown} deg"
    assert view.comparison == f"{of_value} deg, limit ≤ {shown} deg"


def test_junit_has_one_case_for_missing_states_and_one_for_their_limit() -> None:
    content = {"completeness": {"lost_max_share": 0.5}}
    score = whole_score()
    rows = tuple(replace(row, value=None) if row.figure == "lost" else row for row in score.figures)
    score = judged_by(replace(score, figures=rows), parse_limits(content, "test"))
    assert [item.figure for item in score.verdicts].count("lost") > 1
    cases = [
        (case.attrib["classname"], case.attrib["name"]) for case in ET.fromstring(junit({"a": score})).iter("testcase")
    ]
    assert len(set(cases)) == len(cases)


def test_a_limit_over_a_condition_that_the_drive_is_too_short_for_has_the_reason() -> None:
    made = scores()[0]
    text = render_test_report([made])
    assert "R4: position error over 500 m" in text
    assert "long)." in text
    assert "distance=500: the drive is" in junit({"a": made})


def test_junit_says_every_state_in_its_own_word() -> None:
    """pass: nothing; fail: failure; what is not judged: error, because the command ends with exit code 3."""
    made = scores()
    made.append(with_verdicts(replace(made[0], contradiction="the quaternions are written the other way round")))
    part = junit({"part": judged_by(half(made[2]), None)})
    assert [case.find("error") is not None for case in ET.fromstring(part).iter("testcase")] == [True]
    root = ET.fromstring(junit({str(n): score for n, score in enumerate(made)}))
    words = {"pass": None, "fail": "failure", "not enough data": "error", "incomplete": "error", "not judged": "error"}
    for score, suite in zip(made, root.iter("testsuite"), strict=True):
        cases = suite.findall("testcase")
        assert int(suite.attrib["tests"]) == len(cases) == len(score.verdicts)
        for word in ("failure", "skipped", "error"):
            count = sum(case.find(word) is not None for case in cases)
            assert count == int(suite.attrib["skipped" if word == "skipped" else f"{word}s"])
        for item, case in zip(score.verdicts, cases, strict=True):
            said = [child.tag for child in case if child.tag != "properties"]
            expected = words[item.state]
            assert said == ([expected] if expected else [])
            properties = {each.attrib["name"]: each.attrib["value"] for each in case.iter("property")}
            assert float(properties["limit"]) == item.limit
            assert properties.get("id") == item.id
    states = {item.state for score in made for item in score.verdicts}
    assert len(states) == 5


def test_the_reason_of_an_open_bound_is_what_it_needs() -> None:
    entry = {"limit": 10.0, "prob": 0.95, "confidence": 0.95, "interpretation": "ensemble"}
    content = {"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}
    config = TrajectoryScoreConfig(conditions=("distance=5",))
    errors = score_trajectory(*drive(300), config, kept_errors=[("position", "distance=5")]).errors
    score = judged_by(replace(whole_score(), errors=errors), parse_limits(content, "test"))
    item = score.on_limits[0]
    assert item.state == "not enough data"
    text = render_test_report([score])
    assert "required: 58 more drives" in text
    assert "values)" not in text
    place = next(place for place, row in enumerate(score.figures) if row.figure == "bound")
    assert item.row == place
    assert 'data-key="verdicts.0.independent"' in text
    assert "58 more drives" in junit({"score 1": score})


def test_each_limit_that_is_neither_met_nor_missed_is_an_open_point() -> None:
    whole, _, part = scores()
    other = with_verdicts(replace(whole, contradiction="the quaternions are conjugated"))
    open_states = (VerdictState.NOT_ENOUGH_DATA, VerdictState.INCOMPLETE, VerdictState.NOT_JUDGED)
    found = set()
    for score in (whole, part, other):
        _, _, listed = render_test_report([score]).partition("Open points</h2>")
        for item in score.verdicts:
            if item.state in open_states:
                assert html.escape(f"{VerdictView.of(item).title}: ") in listed, item.name
                found.add(item.state)
    assert found == set(open_states)


@pytest.mark.parametrize(("kind", "is_open"), [(MethodKind.PYTHON, True), (MethodKind.BUILT_IN, False)])
def test_encoded_truth_in_a_method_under_test_is_an_open_point(*, kind: MethodKind, is_open: bool) -> None:
    score = replace(scores()[0], method=MethodRecord(name="mine.py:Mine", version=None, kind=kind))
    _, _, listed = render_test_report([score]).partition("Open points</h2>")
    assert ("the code of mine.py:Mine" in listed) == is_open


def test_a_verdict_that_depends_on_the_reading_is_named() -> None:
    score = scores()[0]
    note = view_table(READINGS, score).note
    assert note.endswith("Each reading gives the same verdicts.")
    first = score.verdicts[0]
    other = replace(first, by_reading={"pose": VerdictState.PASS, "position": VerdictState.FAIL})
    said = view_table(READINGS, replace(score, verdicts=(other,))).note
    assert "The verdict depends on the reading: position error over 5 m, mean + 3 sigma: " in said
    assert "fail by position" in said


def test_limits_of_the_sample_are_ten_requirements() -> None:
    from sfr_loc_map.metrics.judging.limits_file import load_limits

    limits = load_limits(ROOT / "sample/limits.yaml").limits
    assert len({item.id for item in limits}) == len(limits) == 10
    assert all(item.text for item in limits)


def unseen_limits(path: Path) -> str:
    return f"{path} names no limits file: its limits were not compared"


def test_the_command_writes_both_and_refuses_what_it_would_not_do(tmp_path: Path, sfr: Sfr) -> None:
    from sfr_loc_map.metrics.stored.score_json import to_json

    paths = [tmp_path / f"{number}.json" for number in range(3)]
    for path, score in zip(paths, scores(), strict=True):
        path.write_text(to_json(score))
    report, xml = tmp_path / "t.html", tmp_path / "v.xml"
    words = ["report", *paths, "--test-report", report, "--junit", xml]
    assert sfr(*words).code == 1  # the verdict of the scores
    read = [load_score(path).with_caveat(unseen_limits(path)) for path in paths]
    assert report.read_text() == render_test_report(each_by_its_limits(read))
    assert len(list(ET.parse(xml).getroot().iter("testsuite"))) == 3
    assert sfr(*words, "--overwrite", "-o", "x.md").code == 2


def test_a_limit_stands_once_where_one_score_judges_it() -> None:
    """One limits file for a score of the drive and one of the map."""
    _, cloud, drive = scores()
    page = render_test_report(each_by_its_limits([drive, cloud]))
    for name in ("R1", "R2", "R5", "R6"):
        assert len(re.findall(f'<th scope="row">{name}<', page)) == 1, name
    for score, omitted in zip(each_by_its_limits([drive, cloud]), ("point_error", "position"), strict=True):
        (text,) = (text for text in deviations_of(score) if text.endswith("judged in another of the scores."))
        assert omitted in text
        assert text in page


def test_several_items_under_test_have_no_common_pass() -> None:
    loose = parse_limits({"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 100.0}]}, "test")
    met = judged_by(of_drive(whole_score()), loose)
    ours, theirs = (
        replace(met, method=MethodRecord(name=name, version="1", kind=MethodKind.PYTHON)) for name in ("ours", "theirs")
    )
    for several, heading in (([ours, ours], "PASS"), ([ours, theirs], "NO COMMON VERDICT"), ([ours, met], "NO COMMON")):
        assert f"<strong>{heading}" in render_test_report(several)
    tuned = replace(met, method=MethodRecord(name="ours", version="1", kind=MethodKind.PYTHON, config_sha256="1" * 64))
    assert common_verdict([tuned, tuned]).state == "pass"
    assert common_verdict([ours, tuned]).state is None
    of_points = parse_limits({"map": {"point_error_p95_m": 100.0}}, "test")
    mapper = replace(judged_by(of_map(whole_score()), of_points), method=replace(tuned.method, config_sha256="2" * 64))
    assert mapper.verdict == "pass"
    assert common_verdict([tuned, mapper]).state == "pass", "localiser and mapper have each a configuration"
    assert common_verdict([ours, judged_by(half(of_drive(whole_score())), loose)]).state == "incomplete"


def test_a_report_lists_the_clauses_of_its_limits_alone() -> None:
    memory = judged_by(whole_score(), parse_limits({"memory": {"localisation_peak_bytes": 2e9}}, "test"))
    assert clauses_used([memory]) == ["4.2.2"]
    content = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}]}
    of_position = judged_by(whole_score(), parse_limits(content, "test"))
    assert clauses_used([of_position]) == ["4.1.1", "4.1.2", "4.1.3", "4.2.3.1"]


def test_the_banner_counts_every_limit() -> None:
    part = scores()[2]
    many = len(part.on_limits)
    assert f" of {many} limits met" in banner_of(part).text
    incomplete = sum(item.state is VerdictState.INCOMPLETE for item in part.on_limits)
    assert incomplete
    assert f"{incomplete} on incomplete data" in banner_of(part).text


def test_the_figure_on_paper_shows_the_error_of_each_sub_trajectory() -> None:
    score = scores()[0]
    assert score.details is not None
    assert score.details.trajectory is not None
    errors = [error_sizes(rows) for rows in score.details.trajectory.sub_trajectories if rows.start_frame]
    every = printed_plots(score)
    drawn = [figure for figure in every if figure.title.startswith("Position")]
    assert [figure.count for figure in drawn] == [len(figure.points) for figure in drawn] == [*map(len, errors)]
    for figure, sizes in zip(drawn, errors, strict=True):
        zero, top = figure.y_ticks[0], figure.y_ticks[-1]
        factor = {"mm": 1e3, "m": 1.0}[figure.y_title.rpartition(", ")[2]]
        scale = float(top.text) / (zero.at - top.at)
        shown = [(zero.at - y) * scale for _, y in figure.points]
        assert shown == pytest.approx([size * factor for size in sizes if size is not None], abs=0.02 * scale)
        assert all(figure.x_ticks[0].at <= x <= figure.x_ticks[-1].at for x, _ in figure.points)
    assert render_test_report([score]).count("<circle") == sum(len(figure.points) for figure in every)


def test_the_caption_on_paper_has_the_count_of_the_figure_and_the_number_of_marks() -> None:
    score = whole_score()
    assert score.details is not None
    assert score.details.trajectory is not None
    first = score.details.trajectory.sub_trajectories[0]
    names = [name for name in first.__struct_fields__ if name not in ("condition", "every", "others")]
    halved = replace(first, every=2, **{name: getattr(first, name)[::2] for name in names})
    trajectory = replace(score.details.trajectory, sub_trajectories=(halved,))
    thinned = replace(score, details=replace(score.details, trajectory=trajectory))
    row = thinned.figure("position", condition=first.condition)
    assert row is not None
    plot = printed_plots(thinned)[0]
    assert plot.count == row.n == len(first.start_frame)
    assert plot.count_text == f"n = {row.n}, of which {len(halved.start_frame)} are drawn"
    assert f"{plot.count_text}." in render_test_report([thinned])
    assert printed_plots(score)[0].count_text == f"n = {row.n}"


def test_the_report_on_paper_shows_attitude_and_map_with_their_limits() -> None:
    limits = {"trajectory": [{"condition": "distance=5", "attitude_p95_deg": 0.5}], "map": {"point_error_p95_m": 0.25}}
    score = judged_by(whole_score(), parse_limits(limits, "test"))
    assert score.details is not None
    assert score.details.map is not None
    figures = {figure.y_title.partition(",")[0]: figure for figure in printed_plots(score)}
    attitude, points = figures["attitude error"], figures["point error"]
    row = score.figure("attitude", condition="distance=5")
    assert row is not None
    assert attitude.count == row.n
    shown = [*attitude.levels, *points.levels]
    assert "limit of p95 0.5 deg" in attitude.beyond + str(shown)
    assert "limit of p95 0.25 m" in points.beyond + str(shown)
    kept = score.details.map.cloud
    assert points.count == score.number("point_error", "n", part=None)
    assert len(points.points) == len(kept.error_m[:: -(-len(kept.error_m) // 1000)]) > 100
    zero, top = points.y_ticks[0], points.y_ticks[-1]
    scale = float(top.text) / (zero.at - top.at)
    errors = [value for value in kept.error_m[:: -(-len(kept.error_m) // 1000)] if value is not None]
    assert [(zero.at - y) * scale for _, y in points.points] == pytest.approx(errors, abs=0.02 * scale)
    page = render_test_report([score])
    assert "range of the true point, m" in page
    assert "attitude error, deg" in page
