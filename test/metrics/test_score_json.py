"""The score's JSON: what is written reads back to the same values, and what is wrong is refused in one line."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, is_dataclass, replace
from enum import StrEnum
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_drives import drive, score_of

from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.config import Condition, ConditionKind, TrajectoryScoreConfig
from sfr_loc_map.metrics.score import CallHistogram, Columns, Inline, MemoryScore, PeakMemory, Score
from sfr_loc_map.metrics.score_json import from_dict, from_json, to_dict, to_json

NUMBERS = st.floats(-1e100, 1e100)
WORDS = st.text(max_size=5)
CONDITIONS = st.builds(Condition, st.sampled_from([ConditionKind.DISTANCE, ConditionKind.TIME]), st.floats(1e-3, 1e6))
SCALARS: dict[Any, st.SearchStrategy[Any]] = {
    float: NUMBERS,
    int: st.integers(-(2**62), 2**62),
    bool: st.booleans(),
    str: WORDS,
    CallHistogram: st.sampled_from(
        [CallHistogram(edges_s=(), counts=()), CallHistogram(edges_s=(0.1, 0.2, 0.4), counts=(7, 0))]
    ),
    object: st.one_of(WORDS, st.integers(-(2**62), 2**62), st.lists(NUMBERS, max_size=2)),
    Condition: CONDITIONS | st.builds(Condition, st.just(ConditionKind.FRAMES), st.integers(1, 10**6).map(float)),
}


def values(hint: Any, inline: bool = False) -> st.SearchStrategy[Any]:
    """Return values of a type, built from its annotations alone; an inlined part is always there."""
    kind, arguments = get_origin(hint), get_args(hint)
    if kind is Annotated:
        return values(arguments[0], any(isinstance(note, Inline) for note in arguments[1:]))
    if kind in (Union, UnionType):
        some = values(next(part for part in arguments if part is not type(None)))
        return some if inline else st.none() | some
    if kind is tuple and arguments[-1] is Ellipsis:
        return st.lists(values(arguments[0]), max_size=2).map(tuple)
    if kind is tuple:
        return st.tuples(*map(values, arguments))
    if kind is not None and issubclass(kind, Mapping):
        return st.dictionaries(WORDS, values(arguments[1]), max_size=2)
    if hint in SCALARS:
        return SCALARS[hint]
    if is_dataclass(hint) and isinstance(hint, type) and issubclass(hint, Columns):
        return st.integers(0, 2).flatmap(lambda length: columns(hint, length))
    if is_dataclass(hint):
        hints = get_type_hints(hint, include_extras=True)
        return st.builds(hint, **{name: st.deferred(lambda part=part: values(part)) for name, part in hints.items()})
    assert issubclass(hint, StrEnum)
    return st.sampled_from(list(hint))


def columns(hint: type, length: int) -> st.SearchStrategy[Any]:
    """Return records whose columns have a length."""
    parts = {}
    for name, part in get_type_hints(hint, include_extras=True).items():
        is_column = get_origin(part) is tuple
        parts[name] = st.tuples(*[values(get_args(part)[0])] * length) if is_column else values(part)
    return st.builds(hint, **parts)


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(values(Score))
def test_every_score_reads_back_as_it_was_written(score: Score) -> None:
    text = to_json(score)
    read = from_json(text)
    assert read == score
    assert to_json(read) == text


def score() -> Score:
    truth, estimate = drive(1, 30)
    made = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("frames=7",)))
    assert made.trajectory is not None
    memory = MemoryScore(mapping=PeakMemory(peak_bytes=7, above_idle_bytes=None))
    return replace(made, trajectory=replace(made.trajectory, duration_s=math.nan), memory=memory, details=None)


def test_keys_are_those_of_the_schema() -> None:
    plain = to_dict(score())
    assert list(plain) == ["schema", "trajectory", "memory", "verdicts"], "absent parts are left out"
    trajectory = plain["trajectory"]
    assert list(trajectory)[:4] == ["count", "condition", "spacing_frames", "rebase"]
    assert trajectory["condition"] == {"frames": 7}
    assert trajectory["starts_given_up"] == 0
    assert [trajectory[name] for name in ("nees", "duration_s")] == [None, None], "undefined figures are null"
    assert [trajectory["association"][name] for name in ("exact", "truth")] == [30, "match"]
    assert "conditions" not in trajectory, "one condition stands by itself"
    assert plain["memory"] == {"mapping_peak_bytes": 7, "mapping_above_idle_bytes": None}


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return the score's JSON with one value set, or taken away if the value is MISSING."""
    plain = to_dict(score())
    *way, last = path.split(".")
    place = plain
    for name in way:
        place = place[name]
    if value is MISSING:
        del place[last]
    else:
        place[last] = value
    return plain


CALLS = {"slowest_of": 1, "stamp_ns": [1], "processing_time_s": [0.1], "peak_rss_bytes": [None], "state": ["tracking"]}


def drawn(edges: list[float], counts: list[int], **series: Any) -> dict[str, Any]:
    """Details of the calls of a localiser."""
    figures = {"histogram": {"edges_s": edges, "counts": counts}, "series": CALLS | series}
    return {"calls": {"localisation": figures}}


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("schema", "sfr-score/2", "sought schema sfr-score/1, found sfr-score/2"),
        ("trajectry", {}, "unknown key 'trajectry' .did you mean 'trajectory'"),
        ("trajectory.position_m.men", 1.0, "trajectory.position_m has an unknown key 'men' .did you mean 'mean'"),
        ("trajectory.count", MISSING, "trajectory has no 'count'"),
        ("trajectory.count", 3.5, "trajectory.count is 3.5: Expected `int`"),
        ("trajectory.rebase", "heading", "trajectory.rebase is 'heading': Invalid enum value"),
        ("trajectory.condition", {"distance_m": -5}, "trajectory.condition: .distance=-5. is not a condition"),
        ("trajectory.overlap", 10**400, "trajectory.overlap: a number of at most"),
        ("trajectory.position_m.mean_plus_3sigma_ci95", [1.0], "ci95 is .1.0.: Expected `array` of length 2"),
        ("verdicts", MISSING, "it has no 'verdicts'"),
        ("a\nb", 1, "an unknown key 'a b'"),
        ("details", drawn([], [], state=[]), "series: its columns differ"),
        ("details", drawn([1.0], [1]), "histogram: 1 counts with 1 edges"),
        ("details", drawn([1e308, 2.0], [1]), "edges_s is .1e.308, 2.0.: a number of at"),
    ],
)
def test_malformed_scores_are_refused_with_the_place(path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError, match=f"^file.json is .*{words}") as caught:
        from_dict(changed(path, value), "file.json")
    assert "\n" not in str(caught.value)


def test_numbers_that_are_not_finite_are_undefined_and_no_json_is_refused() -> None:
    text = to_json(score())
    read = from_json(text.replace('"duration_s":null', '"duration_s":NaN')).trajectory
    assert read is not None
    assert read.duration_s is None
    for wrong in ("", "{", "nul", "[" * 100_000, "9" * 400):
        with pytest.raises(InputError, match="is no JSON"):
            from_json(wrong)
