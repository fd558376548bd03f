"""The score's JSON: what is written reads back to the same values, and what is wrong is refused in one line."""

import json
import math
from collections.abc import Callable
from enum import StrEnum
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

import sfr_loc_map
from helpers.random_drives import drive, score_of
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import CallHistogram, Columns, ErrorRows
from sfr_loc_map.metrics.figures.records import InputFile, MethodKind, MethodRecord, Provenance
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import COLUMNS, Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.score.limits import BOUND, LIMITED_NUMBERS, Limit, Population
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_dict, from_json, from_plain, hash_of_values, to_dict, to_json

NUMBERS = st.floats(-1e100, 1e100)
WORDS = st.text(max_size=5)
SCALARS: dict[Any, st.SearchStrategy[Any]] = {
    float: NUMBERS,
    int: st.integers(-(2**62), 2**62),
    bool: st.booleans(),
    str: WORDS,
    CallHistogram: st.sampled_from(
        [CallHistogram(edges_s=(), counts=()), CallHistogram(edges_s=(0.1, 0.2, 0.4), counts=(7, 0))]
    ),
    ErrorRows: st.sampled_from(
        [
            ErrorRows(figure="chord", condition="distance=5", errors=((0.1, None),)),
            ErrorRows(figure="position", condition="time=5", errors=((0.1,), (0.2,), (0.3,))),
        ]
    ),
    RowPart: WORDS.map(RowPart),
    Any: st.one_of(WORDS, st.integers(-(2**62), 2**62), st.lists(NUMBERS, max_size=2)),
}


def values(hint: Any) -> st.SearchStrategy[Any]:
    """Return values of a type, built from its annotations alone."""
    kind, arguments = get_origin(hint), get_args(hint)
    if hint in SCALARS:
        return SCALARS[hint]
    if kind in (Union, UnionType):
        return st.none() | values(next(part for part in arguments if part is not type(None)))
    if kind is tuple and arguments[-1] is Ellipsis:
        return st.lists(values(arguments[0]), max_size=2).map(tuple)
    if kind is tuple:
        return st.tuples(*map(values, arguments))
    if kind is dict:
        return st.dictionaries(WORDS, values(arguments[1]), max_size=2)
    if issubclass(hint, Columns):
        return st.integers(0, 2).flatmap(lambda length: columns(hint, length))
    if hint is Limit:
        return st.builds(
            limit_of, st.sampled_from(list(LimitSection)), st.integers(0, 100), st.floats(0, 1), st.booleans()
        )
    if issubclass(hint, msgspec.Struct):
        parts = get_type_hints(hint).items()
        return st.builds(hint, **{name: st.deferred(lambda part=part: values(part)) for name, part in parts})
    assert issubclass(hint, StrEnum)
    return st.sampled_from(list(hint))


def limit_of(part: LimitSection, place: int, bound: float, certain: bool) -> Limit:
    """Return a limit of a part; what it is called follows from its place among the names of the part."""
    name = list(LIMITED_NUMBERS[part])[place % len(LIMITED_NUMBERS[part])]
    condition = "distance=5" if part is LimitSection.TRAJECTORY else None
    terms: dict[str, Any] = {}
    if LIMITED_NUMBERS[part][name].statistic == BOUND:
        certain = False
        terms = {"prob": 0.95, "confidence": 0.9, "interpretation": Population.TEMPORAL}
    return Limit(section=part, name=name, limit=bound, condition=condition, certain=certain, **terms)


def columns(hint: type, length: int) -> st.SearchStrategy[Any]:
    """Return records whose columns have a length."""
    parts = {name: column_or_value(part, length) for name, part in get_type_hints(hint).items()}
    return st.builds(hint, **parts)


def column_or_value(part: Any, length: int) -> st.SearchStrategy[Any]:
    """Return columns of a length where a type is a tuple or a dictionary of them."""
    if get_origin(part) is tuple:
        return st.tuples(*[values(get_args(part)[0])] * length)
    if get_origin(part) is dict and get_origin(get_args(part)[1]) is tuple:
        return st.dictionaries(WORDS, column_or_value(get_args(part)[1], length), max_size=2)
    return values(part)


@settings(max_examples=12, suppress_health_check=list(HealthCheck))
@given(values(Score))
def test_every_score_reads_back_as_it_was_written(score: Score) -> None:
    text = to_json(score)
    score = replace(score, content_sha256=json.loads(text)["content_sha256"])
    read = from_plain(Score, json.loads(text))
    assert read == score
    assert to_json(read) == text


def score() -> Score:
    truth, estimate = drive(1, 30)
    made = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("frames=7",)))
    return replace(made, figures=(*made.figures, figure_row("peak", part="mapping", value=7)), details=None)


def test_the_keys_are_those_that_other_programs_rely_on() -> None:
    plain = to_dict(replace(score(), errors=()))
    pinned = ["schema", "verdict", "figures", "verdicts", "association", "truth", "provenance", "content_sha256"]
    assert list(plain) == pinned, "these are always there, others only if they are known"
    assert list(to_dict(Score())) == pinned
    assert plain["schema"] == "sfr-score/2"
    first, *_, last = plain["figures"]
    assert first.keys() <= set(COLUMNS)
    assert [first[name] for name in ("clause", "subject", "condition", "part", "figure", "unit")] == [
        *("4.2.3.1", "trajectory", "frames=7", "pose", "position", "m")
    ]
    assert last == {"unit": last["unit"], "subject": "memory", "part": "mapping",
                    "figure": "peak", "value": 7}  # fmt: skip
    assert (plain["association"]["exact"], plain["truth"]["attitude"]) == (30, True)


def test_a_row_that_occurs_twice_is_refused() -> None:
    made = score()
    with pytest.raises(InputError, match="twice"):
        from_dict(to_dict(replace(made, figures=(*made.figures, made.figures[0]))))


def test_the_text_of_missing_data_is_that_of_the_version_that_reads_the_score() -> None:
    truth, (stamps, *poses) = drive(1, 60)
    kept = stamps < stamps[30]
    half = judged_by(score_of((stamps[kept], *(each[kept] for each in poses)), truth), None)
    assert half.incomplete is not None
    assert from_dict(to_dict(replace(half, incomplete="in other words"))).incomplete == half.incomplete
    with pytest.raises(InputError, match="incomplete is null"):
        from_dict(to_dict(replace(half, incomplete=None)))


def test_rows_are_found_by_what_they_are() -> None:
    found = score()
    assert found.figure("position") is found.figures[0]
    assert found.figure("position", condition="frames=7 frames", part="position").part == "position"
    assert found.figure("position", condition="frames=8") is None
    assert found.number("position", "sigma") == found.figures[0].sigma
    assert found.number("peak", part="fusion") is None
    assert {row.condition for row in found.rows(subject="trajectory", condition=None)} == {None}
    assert found.conditions == ("frames=7",)


@pytest.mark.parametrize(
    ("look_up", "words"),
    [
        (lambda found: found.figure("positon"), "there is no figure 'positon' .did you mean 'position'"),
        (lambda found: found.rows("peek"), "there is no figure 'peek'"),
        (lambda found: found.number("position", "mean3"), "there is no statistic 'mean3'"),
        (lambda found: found.number("position", "unit"), "there is no statistic 'unit'"),
    ],
)
def test_names_that_no_score_has_are_refused(look_up: Callable[[Score], object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        look_up(score())


def test_the_table_of_figures_is_a_table_of_pandas() -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    found = score()
    frame = sfr_loc_map.Score.of(found).to_pandas()
    assert list(frame.columns) == list(COLUMNS)
    assert len(frame) == len(found.figures)


CALLS = {"slowest_of": 1, "stamp_ns": [1], "processing_time_s": [0.1], "peak_rss_bytes": [None], "state": ["tracking"]}


def drawn(edges: list[float], counts: list[int], **series: Any) -> dict[str, Any]:
    """Details of the calls of a localiser."""
    plots = {"histogram": {"edges_s": edges, "counts": counts}, "series": CALLS | series}
    return {"calls": {"localisation": plots}}


LIMIT = {"part": "trajectory", "name": "position_mean_m", "limit": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema": "sfr-score/1"}, "version 0.2.*score the estimate again"),
        ({"schema": "sfr-suite/1"}, "schema sfr-score/2 is required, found 'sfr-suite/1'"),
        ({"trajectry": {}}, "unknown field `trajectry`"),
        ({"figures": [{"figure": "position"}]}, "missing required field `subject` - at `..figures.0.`"),
        ({"association": {"matched": 3.5}}, "Expected `int`, got `float` - at `..association.matched`"),
        ({"a\nb": 1}, "unknown field `a b`"),
        ({"details": drawn([], [], state=[])}, "at `..details"),
        ({"details": drawn([], [], state=["a", "b"])}, "its columns differ in length"),
        ({"details": drawn([1.0], [1])}, "1 counts with 1 edges"),
        ({"errors": [{"figure": "position", "condition": "time=5", "errors": [[1.0], []]}]}, "its columns differ"),
        ({"rules": {"limits": [{**LIMIT, "limit": -1.0, "condition": "distance=5"}]}}, "a number >= 0 is required"),
        ({"rules": {"limits": [{**LIMIT, "condition": "5 m"}]}}, "'5 m' is not a condition as scores write it"),
    ],
)
def test_malformed_scores_are_refused_with_the_place(change: dict[str, Any], words: str) -> None:
    if words == "at `..details":  # an empty column is unknown
        content = to_dict(score()) | change
        assert from_dict(content | {"content_sha256": hash_of_values(content)}).details is not None
        return
    for read in (lambda plain: from_dict(plain, "file.json"), lambda plain: from_json(json.dumps(plain), "file.json")):
        with pytest.raises(InputError, match=f"^file.json .*{words}") as caught:
            read(to_dict(score()) | change)
        assert "\n" not in str(caught.value)


def test_numbers_that_are_not_finite_are_undefined_and_no_json_is_refused() -> None:
    row = replace(score().figures[0], mean=math.nan, sigma=math.inf)
    read = from_json(to_json(Score(figures=(row,)))).figures[0]
    assert (read.mean, read.sigma) == (None, None)
    for wrong in ("", "{", "nul", b"\xff", "[" * 100_000, "[1]", "3"):
        with pytest.raises(InputError, match=r"is not JSON|is not a score"):
            from_json(wrong)


def test_names_of_files_that_are_no_text_are_written_readably() -> None:
    made = Provenance(version="1", inputs={"truth": InputFile(path="a\udcffb", sha256="0")})
    assert from_json(to_json(Score(provenance=made))).provenance.inputs["truth"].path == "a\\udcffb"


@pytest.mark.clause("4.1.3")
def test_sigma_of_one_sub_trajectory_is_written_as_null() -> None:
    row = figure_row("position", "distance=5", "pose", n=1, mean=0.1)
    written = to_dict(Score(figures=(row,)))
    assert {name: written["figures"][0][name] for name in ("sigma", "mean_plus_3sigma")} == {
        "sigma": None,
        "mean_plus_3sigma": None,
    }
    assert from_dict(written).figures == (row,)


@pytest.mark.parametrize(
    ("key", "value"),
    [("condition", "5 m"), ("clause", "4.3.4"), ("subject", "map"), ("figure", "slip"), ("unit", "mm")],
)
def test_a_row_with_a_key_that_its_figure_cannot_have_is_refused(key: str, value: str) -> None:
    content = to_dict(score())
    content["figures"][0][key] = value
    content["content_sha256"] = hash_of_values(content)
    with pytest.raises(
        InputError, match=f"^file.json contradicts itself: .*{value if key == 'figure' else 'position'}"
    ):
        from_dict(content, "file.json")


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"p50": 99.0}, "p50 of position .* is 99, but p95 is"),
        ({"p95": 99.0}, "p95 of position .* is 99, but p99 is"),
        ({"p99": 99.0}, "p99 of position .* is 99, but max is"),
        ({"rmse": -1.0}, "rmse of position .* is -1: a number >= 0"),
        ({"rmse": 99.0}, "rmse of position .* is 99, but max is"),
        ({"sigma": -1.0}, "sigma of position .* is -1: a number >= 0"),
        ({"mean": -99.0}, "mean of position .* is -99, but rmse is"),
        ({"low95": 9.0, "high95": 1.0}, "low95 of position .* is 9, but high95 is 1"),
        ({"mean_plus_3sigma": None}, "has a sigma, but mean_plus_3sigma is absent"),
    ],
)
def test_statistics_that_no_values_can_have_are_refused(numbers: dict[str, float | None], words: str) -> None:
    row = score().figures[0]
    assert from_dict(to_dict(Score(figures=(row,)))).figures == (row,)
    edited = replace(row, **numbers)
    if edited.mean_plus_3sigma is not None:
        edited = replace(edited, mean_plus_3sigma=abs(edited.mean) + 3.0 * edited.sigma)
    with pytest.raises(InputError, match=words):
        from_dict(to_dict(Score(figures=(edited,))))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (figure_row("missing", n=4, value=1.5), "value of missing is 1.5: a fraction"),
        (figure_row("missing", n=4, value=-0.5), "value of missing is -0.5: a number >= 0"),
        (figure_row("missing", part="count", n=4, value=-1), "value of missing count is -1: a number >= 0"),
        (figure_row("coverage", n=4, value=1.1), "value of coverage is 1.1: a fraction"),
        (figure_row("points", value=-3), "value of points is -3"),
        (figure_row("peak", part="mapping", n=1, value=-3), "value of peak mapping is -3"),
        (figure_row("nearest_distance", n=1, mean=0.0, rmse=0.0, p50=-1.0), "p50 of nearest_distance is -1"),
    ],
)
def test_counts_and_fractions_that_cannot_be_are_refused(row: Figure, words: str) -> None:
    with pytest.raises(InputError, match=words):
        from_dict(to_dict(Score(figures=(row,))))


@pytest.mark.parametrize(
    "row", [figure_row("longest_gap", part="distance", value=9.0), figure_row("restarts", value=3)]
)
def test_lengths_and_counts_may_exceed_1(row: Figure) -> None:
    assert from_dict(to_dict(Score(figures=(row,)))).figures == (row,)


@pytest.mark.parametrize("table", ["path", "sub_trajectories"])
def test_numbers_of_rows_and_of_values_that_cannot_be_are_refused(table: str) -> None:
    truth, estimate = drive(1, 30)
    made = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("frames=7",)))
    for every, fault in ((0, "'every' of its details is 0"), (-2, "'every' of its details is -2")):
        content = to_dict(made)
        tables = content["details"]["trajectory"][table]
        (tables if table == "path" else tables[0])["every"] = every
        with pytest.raises(InputError, match=fault):
            from_dict(content | {"content_sha256": hash_of_values(content)})
    row = figure_row("coverage", n=-1, value=0.5)
    with pytest.raises(InputError, match="'n' of coverage is -1"):
        from_dict(to_dict(Score(figures=(row,))))


@pytest.mark.parametrize("count", [-1, 2**63, 2**70])
@pytest.mark.parametrize("name", ["spacing_frames", "matched", "largest_gap_ns"])
def test_a_count_that_does_not_fit_64_bits_is_refused(name: str, count: int) -> None:
    content = {name: value for name, value in to_dict(score()).items() if name != "content_sha256"}
    counts = {"matched": 5, "estimate_poses": 5, "truth_poses": 5, name: count}
    with pytest.raises(InputError, match=f"'{name}' of the association is {count}: a number from 0"):
        from_dict({**content, "association": counts})


@pytest.mark.parametrize("bound", [-1.0, math.nan, math.inf])
def test_a_limit_is_a_number_of_its_unit(bound: float) -> None:
    with pytest.raises(ValueError, match="a number >= 0 is required"):
        Limit(section=LimitSection.TRAJECTORY, name="position_mean_m", limit=bound, condition="distance=5")
    with pytest.raises(ValueError, match="a fraction from 0 to 1"):
        Limit(section=LimitSection.MAP, name="coverage_min", limit=1.5)


@pytest.mark.parametrize("version", ["1.0\nverdict: pass", "1.0\r\x1b[2Kverdict: pass", "1.0\u2028verdict: pass", None])
def test_names_and_versions_of_methods_are_one_printable_line(version: str | None) -> None:
    """A version cannot print forged lines, and it is equal after a score was written and read."""
    method = MethodRecord(name=f"nav{version or ''}", version=version, kind=MethodKind.PYTHON)
    for text in filter(None, (method.name, method.version)):
        assert text.isprintable()
        assert len(text.splitlines()) == 1
    score = Score(figures=(), method=method)
    assert from_json(to_json(score)).method == method
