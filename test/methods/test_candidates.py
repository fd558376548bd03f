"""Valid methods under test: our method, Python classes and the C example give estimates and maps in their processes."""

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from helpers.score_rows import number
from sfr_loc_map.errors import MappingError, MethodError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.methods.supervised_process import Channel
from sfr_loc_map.runs.localiser_run import localise
from sfr_loc_map.runs.mapper_run import run_mapper
from sfr_loc_map.runs.under_test import UnderTest
from sfr_loc_map.suite_names import Task

TAKEN = {"stated_s", "cpu_s", "cpu_between_s", "threads", "processes"}  #: Seen from outside the process.
CLASSES = """
import io, os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState

def ours(rig):
    from sfr_loc_map.mapping.mapper import Mapper  # its import takes 0.3 s, which the other classes do not need
    return Mapper(rig)

class Odd:
    statistics = {"mood": 3, "note": "bright", "none": None, "ratio": np.nan, "large": 10**400}
    def __init__(self, rig, config):
        self.results = {"text": config, "wrong": np.eye(3), "none": None, "matrix": np.eye(4),
                        "transform": Transform(np.eye(3), np.array([0.0, 2.0, 0.0])), "nan": np.full((4, 4), np.nan)}
        self.kinds = iter(config.split())
    def process(self, pair):
        kind = next(self.kinds)
        if kind == "raise":
            raise RuntimeError("no idea")
        if kind == "indefinite":
            covariance = np.eye(6) + 2.0 * (np.eye(6, k=1) + np.eye(6, k=-1))
            return PoseEstimate(pair.stamp_ns, Transform.identity(), covariance, TrackingState.TRACKING)
        if kind == "negative":
            covariance = np.diag([1.0, 1.0, 1.0, -5e-7, 1e-6, 1e-6])
            return PoseEstimate(pair.stamp_ns, Transform.identity(), covariance, TrackingState.TRACKING)
        if kind == "rounded":
            covariance = np.diag([1.0, 1.0, -1e-9, 1e-6, 1e-6, -1e-15])
            return PoseEstimate(pair.stamp_ns, Transform.identity(), covariance, TrackingState.TRACKING)
        if kind in ("unknown", "position", "stamp"):
            covariance = {"position": np.eye(3), "stamp": np.eye(6)}.get(kind)
            stamp_ns = float(pair.stamp_ns) if kind == "stamp" else np.int64(pair.stamp_ns)
            return PoseEstimate(stamp_ns, Transform.identity(), covariance, TrackingState.TRACKING)
        return self.results[kind]

class Versioned(Odd):
    def version(self):
        return "1"

class Holder:
    def __init__(self, rig, config):
        self.held = []
    def process(self, pair):
        self.held.append((pair.right[3:], pair.right.astype(int).sum(1)))
        if len(self.held) > 11:
            del self.held[2]
        assert all((image.sum(1) == sums[3:]).all() for image, sums in self.held)
        return np.eye(4)

class Flat:
    def __init__(self, rig, config):
        pass
    def process(self, pair, T_lm_navsb, index):
        return np.full(pair.left.shape, 6.0 if index == 0 else np.nan, np.float32)

class Set:
    def __init__(self, rig, config):
        self.mapper = None if config == "disparity" else ours(rig)
        self.kind = config
    def map_pairs(self, pairs):
        if self.kind == "disparity":
            return pairs[0].pair.left
        cloud = self.mapper.map(pairs).cloud
        return replace(cloud, pair=cloud.pair + np.uint8(self.kind == "pair"))

class Fusing:
    def __init__(self, rig, config):
        pass
    def process(self, pair, T_lm_navsb, index):
        return SimpleNamespace(cloud=PointCloud.empty(), warnings=["of a pair"])
    def fuse(self, results):
        return SimpleNamespace(cloud=PointCloud.empty(), warnings=["of the fusion"])

class Counting:
    def __init__(self, rig, config):
        pass
    def process(self, pair, T_lm_navsb, index):
        return PointCloud.empty()
    def fuse(self, results):
        self.statistics = {"results": len(results)}
        return PointCloud.empty()

class InvalidFusion:
    def __init__(self, rig, config):
        self.kind = config
    def process(self, pair, T_lm_navsb, index):
        return np.full(pair.left.shape, 6.0, np.float32)
    def fuse(self, results):
        if self.kind == "disparity":
            return np.ones((120, 160), np.float32)
        return SimpleNamespace(cloud=PointCloud.empty(), stamp_ns=1)

class Writing:
    def __init__(self, rig, config):
        self.what = config
        self.path = Path(os.environ["TMPDIR"]).parent / f"result.{self.what}.npy"
        self.contents = [b"no array", header((120, 160))[:40], header((120, 10**12)), b"PK" + bytes(100),
                         header((3,)) + bytes(24)]
    def process(self, pair, T_lm_navsb, index):
        if self.contents:
            self.path.write_bytes(self.contents.pop(0))
        else:
            self.path.unlink(missing_ok=True)
            self.path.mkdir()
        return PointCloud.empty() if self.what == "disparity" else np.zeros(pair.left.shape, np.float32)

def header(shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()

class Nothing:
    def __init__(self, rig, config):
        pass
"""


def calls(spec: str, config: str, count: int) -> list[tuple[PoseEstimate, MethodCall]]:
    with IsolatedLocaliser(find_method(spec, Task.LOCALISATION, config), LOC_RIG, true_pose(0), hidden=()) as localiser:
        return [localiser.localise(loc_pair(number)) for number in range(count)]


@pytest.mark.slow
def test_ours_gives_the_same_bits_in_a_process_of_its_own(drive: Path) -> None:
    known = list(localise(open_source(drive).loc, LocalisationConfig(), true_pose(0)))
    for (estimate, record), (theirs, call) in zip(known, calls("sfr", "", 12), strict=True):
        np.testing.assert_array_equal(theirs.T_ds_rb.matrix, estimate.T_ds_rb.matrix)
        np.testing.assert_array_equal(call.covariance, estimate.covariance)
        np.testing.assert_array_equal(call.step, record.step)
        assert theirs.state is estimate.state
        own = {name: figure for name, figure in call.statistics.items() if "stage" not in name and name not in TAKEN}
        assert own == estimate.statistics.as_dict()
        assert call.statistics.keys() > TAKEN


def test_a_class_of_python_may_return_what_it_likes_and_is_checked(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    made = calls(
        f"{tmp_path}/classes.py:Odd",
        "matrix transform none wrong raise nan indefinite negative rounded matrix unknown position stamp",
        13,
    )
    assert [estimate.state.value for estimate, _ in made] == [
        "tracking", "tracking", "lost", "lost", "lost", "lost", "lost", "lost", "tracking", "tracking",
        "tracking", "lost", "lost"
    ]  # fmt: skip
    assert [call.finding for _, call in made] == [
        "",
        "",
        "",
        "invalid result: the pose is ndarray of shape (3, 3): a PoseEstimate, a Transform or a matrix (4, 4) is "
        "required",
        "raised: RuntimeError: no idea",
        "not finite: the pose contains a non-finite number",
        "invalid result: the covariance is not symmetric and positive semi-definite",
        "invalid result: the covariance is not symmetric and positive semi-definite",
        "",
        "",
        "",
        "invalid result: the covariance is ndarray of shape (3, 3): a matrix (6, 6), or None if unknown, is required",
        f"invalid result: the stamp is {float(loc_pair(12).stamp_ns)}: a whole number of nanoseconds is required",
    ]
    moved = true_pose(0) @ Transform(np.eye(3), np.array([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(made[1][0].T_ds_rb.matrix, moved.matrix, atol=1e-12)
    assert made[1][1].covariance is None
    assert made[0][1].statistics.keys() - TAKEN == {"mood"}
    with pytest.raises(MethodError, match="has no method 'process': see"):
        calls(f"{tmp_path}/classes.py:Nothing", "", 0)
    with pytest.raises(MethodError, match="'version' has the type method"):
        calls(f"{tmp_path}/classes.py:Versioned", "", 0)
    assert not any(call.finding for _, call in calls(f"{tmp_path}/classes.py:Holder", "", 24))


def test_a_matcher_gives_points_and_a_pair_without_any_is_empty(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    with IsolatedMapper(find_method(f"{tmp_path}/classes.py:Flat", Task.MAPPING), NAV_RIG, hidden=()) as mapper:
        item = nav_pair(0)
        of_pairs = mapper.begin_map()
        first, call = of_pairs.map_pair(item.pair, item.T_lm_navsb)
        second, _ = of_pairs.map_pair(item.pair, item.T_lm_navsb)
    assert not call.finding
    assert len(first.cloud) == NAV_RIG.width * NAV_RIG.height
    assert len(second.cloud) == 0
    T_left_lm = (item.T_lm_navsb @ NAV_RIG.T_sb_left).inverse()
    np.testing.assert_allclose(T_left_lm.apply(first.cloud.xyz)[:, 2], NAV_RIG.fx * NAV_RIG.baseline_m / 6.0, rtol=1e-5)


@pytest.mark.parametrize("what", ["disparity", "cloud"])
def test_arrays_that_a_method_writes_itself_are_checked(tmp_path: Path, what: str) -> None:
    """A text, a truncated file, a header that claims more than the data, an archive, another shape, and a folder."""
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Writing", Task.MAPPING, what)
    with IsolatedMapper(method, NAV_RIG, hidden=()) as mapper:
        item = nav_pair(0)
        made = [mapper.begin_map().map_pair(item.pair, item.T_lm_navsb) for _ in range(6)]
    for of_pair, call in made:
        assert call.finding.startswith("invalid result: the ")
        assert len(of_pair.cloud) == 0
    assert len({call.finding for _, call in made}) >= 3, "not a folder, not an array, not of the shape"


def test_the_warnings_of_the_pairs_and_of_the_fusion_are_reported(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:Fusing", Task.MAPPING)
    run = run_mapper(open_source(drive).nav, UnderTest(method, hidden=()))
    assert run.warnings == ["pair 0: of a pair", "pair 1: of a pair", "of the fusion"]


@pytest.mark.parametrize(
    ("kind", "finding"),
    [
        (
            "disparity",
            "invalid result: the mapper returned ndarray of shape (120, 160): a PointCloud, or an object with",
        ),
        ("stamp", "wrong stamp: answered with stamp 1: "),
    ],
)
def test_an_invalid_fusion_is_a_finding_and_the_points_of_all_pairs_are_kept(
    drive: Path, tmp_path: Path, kind: str, finding: str
) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    method = find_method(f"{tmp_path}/classes.py:InvalidFusion", Task.MAPPING, kind)
    run = run_mapper(open_source(drive).nav, UnderTest(method, hidden=()))
    (fusion,) = [record for record in run.records if record.state == "fused"]
    assert fusion.finding.startswith(finding)
    assert run.fused.cloud.fused is False
    assert set(run.fused.cloud.pair) == {0, 1}


def test_a_fusion_receives_the_results_of_the_pairs_of_its_map(tmp_path: Path) -> None:
    """A map begins with its first pair, and the map before need not have been fused."""
    (tmp_path / "classes.py").write_text(CLASSES)
    item, fused = nav_pair(0), []
    with IsolatedMapper(find_method(f"{tmp_path}/classes.py:Counting", Task.MAPPING), NAV_RIG, hidden=()) as mapper:
        for pairs, is_fused in ((2, True), (2, False), (3, True)):
            of_pairs = mapper.begin_map()
            for _ in range(pairs):
                of_pairs.map_pair(item.pair, item.T_lm_navsb)
            if is_fused:
                _, call = of_pairs.fuse()
                assert call is not None
                fused.append(call.statistics["results"])
    assert fused == [2.0, 3.0]


def test_a_map_that_has_ended_or_has_no_or_too_many_pairs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    item = nav_pair(0)
    with IsolatedMapper(find_method(f"{tmp_path}/classes.py:Counting", Task.MAPPING), NAV_RIG, hidden=()) as mapper:
        first = mapper.begin_map()
        first.map_pair(item.pair, item.T_lm_navsb)
        second = mapper.begin_map()
        with pytest.raises(MappingError, match="the map has ended"):
            first.fuse()
        with pytest.raises(MappingError, match="0 pairs given"):
            second.fuse()
        second.map_pair(item.pair, item.T_lm_navsb)
        second.fuse()
        with pytest.raises(MappingError, match="the map has ended"):
            second.map_pair(item.pair, item.T_lm_navsb)
        with pytest.raises(MappingError, match="maps only single pairs"):
            mapper.map_set([item])
        small = StereoPair(5, item.pair.left[:-2], item.pair.right[:-2])
        with pytest.raises(MethodError, match="image of stamp 5 is 160 x 118"):
            mapper.begin_map().map_pair(small, item.T_lm_navsb)


def test_the_files_of_a_pair_are_removed_before_the_fusion(monkeypatch: pytest.MonkeyPatch) -> None:
    """A method that answers without writing a cloud does not return the cloud of the last pair."""
    item = nav_pair(0)
    with IsolatedMapper(find_method("sfr", Task.MAPPING), NAV_RIG, hidden=()) as mapper:
        of_pairs = mapper.begin_map()
        made, _ = of_pairs.map_pair(item.pair, item.T_lm_navsb)
        reply = {"number": 2, "seconds": 0.0, "result": {"fused": True}}
        monkeypatch.setattr(Channel, "exchange", lambda *_: reply)
        fused, call = of_pairs.fuse()
    assert call is not None
    assert call.finding.startswith("invalid result: the cloud cannot be read")
    assert fused.cloud.fused is False
    assert len(fused.cloud) == len(made.cloud) > 0


def test_the_example_in_c_localises_and_maps(example: Path) -> None:
    made = calls(f"lib:{example}", "", 12)
    assert not any(call.finding for _, call in made)
    error = np.linalg.norm(made[-1][0].T_ds_rb.translation - true_pose(11).translation)
    assert error < 0.1  # of 0.28 m, by some 30 corners of a small image
    with pytest.raises(MethodError, match="max_disparity is 2: 4 to 1023 is required"):
        calls(f"lib:{example}", "max_disparity: 2", 0)
    items = [nav_pair(0), nav_pair(1)]
    with IsolatedMapper(find_method(f"lib:{example}", Task.MAPPING), NAV_RIG, hidden=()) as mapper:
        parts, fused, call = mapper.map_set(items)
    assert not call.finding
    assert fused.cloud.fused is False
    assert len(fused.cloud) == sum(len(part.cloud) for part in parts)
    for item, part in zip(items, parts, strict=True):
        errors = np.linalg.norm(part.cloud.xyz - item.truth[part.cloud.v, part.cloud.u], axis=1)
        assert len(part.cloud) > 0.5 * NAV_RIG.width * NAV_RIG.height
        assert np.median(errors) < 0.05  # of 3 m


@pytest.mark.clause("1.3")
def test_a_class_may_map_a_set_in_one_call_and_ours_gives_the_bits_of_its_stages(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    nav = open_source(drive).nav
    run = run_mapper(nav, UnderTest(find_method(f"{tmp_path}/classes.py:Set", Task.MAPPING), hidden=()))
    for config, finding in (
        (
            "disparity",
            "invalid result: the mapper returned ndarray of shape (120, 160): a PointCloud, or an object with a "
            "PointCloud as 'cloud', is required for a set of pairs",
        ),
        ("pair", "invalid result: a point has the pair number 2: 0 to 1 is required"),
    ):
        method = find_method(f"{tmp_path}/classes.py:Set", Task.MAPPING, config)
        assert run_mapper(nav, UnderTest(method, hidden=())).records[0].finding == finding
    ours = run_mapper(nav, MappingConfig())  # by process and fuse
    np.testing.assert_array_equal(run.fused.cloud.to_structured(), ours.fused.cloud.to_structured())
    assert [record.state for record in run.records] == ["mapped_set"]
    assert [record.state for record in ours.records] == ["mapped", "mapped", "fused", "mapped_set"]
    assert ours.records[-1].processing_time_s == sum(record.processing_time_s for record in ours.records[:-1])


@pytest.mark.clause("4.2.1", "4.2.2")
@pytest.mark.parametrize("method", ["sfr", "{}/classes.py:Set"])
def test_the_mapping_call_is_scored_and_judged(method: str, drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    (tmp_path / "classes.py").write_text(CLASSES)
    cloud, stats, limits = tmp_path / "c.npz", tmp_path / "s.csv", tmp_path / "limits.yaml"
    limits.write_text("timing: {mapping_call_s: 1.0e-6}\nmemory: {mapping_call_peak_bytes: 1.0e+11}\n")
    assert sfr("map", drive, "-o", cloud, "--stats", stats, "--method", method.format(tmp_path)).code == 0
    scored = sfr("score", cloud, drive, "--stats", stats, "--limits", limits, "--json", "-")
    score = json.loads(scored.out)
    assert number(score, "mapping_call", "n") == 1
    assert 0.0 < number(score, "mapping_call", "mean") < 60.0
    assert number(score, "peak", part="mapping_call") > number(score, "above_idle", part="mapping_call") >= 0
    assert [item["verdict"] for item in score["verdicts"]] == ["fail", "pass"]
