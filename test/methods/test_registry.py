"""Methods are found by name, by class and by library, and a peer is found in its interpreter."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, loc_pair, true_pose
from sfr_loc_map import __version__
from sfr_loc_map.bench.method_benchmark import methods_to_compare
from sfr_loc_map.configuration.parameters import parameters
from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.methods import ours
from sfr_loc_map.methods.child.numba_cache import OfUser
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolation import PACKAGE, SETTINGS, environment_of, isolation_of, rules_of
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord
from sfr_loc_map.suite_names import Task


def test_ours_reads_numbers_as_files_of_the_suite_do() -> None:
    """JSON writes a small number as 5e-05, which YAML 1.1 reads as a text."""
    name = next(info.name for info in parameters(LocalisationConfig) if info.type is float and info.low <= 5e-5)
    ours.localiser(LOC_RIG, json.dumps({name: 5e-5}))


def test_names_are_looked_up(tmp_path: Path, sfr: Sfr) -> None:
    assert find_method("sfr", Task.LOCALISATION).target == "sfr_loc_map.methods.ours:localiser"
    for name, task, words in (
        ("none", Task.LOCALISATION, "no method 'none' for localisation: give one of sfr, opencv, package.module"),
        ("none.py:Class", Task.LOCALISATION, "No such file"),
        ("pandora", Task.MAPPING, "no method 'pandora'"),
        ("package:", Task.MAPPING, "no method 'package:'"),
        (f"lib:{tmp_path}", Task.MAPPING, "is a folder"),
        ("lib:\0", Task.MAPPING, "contains a NUL character"),
        ("lib:" + 5000 * "a", Task.MAPPING, "File name too long"),
        (5000 * "a" + ".py:X", Task.LOCALISATION, "File name too long"),
        ("__main__:Class", Task.LOCALISATION, "there is no module '__main__'"),
        ("nothing.module:Class", Task.LOCALISATION, "there is no module 'nothing.module'"),
        ("json.nothing:Class", Task.LOCALISATION, "there is no module 'json.nothing'"),
        (".json:Class", Task.LOCALISATION, "no method '.json:Class'"),
        ("a b:Class", Task.LOCALISATION, "no method 'a b:Class'"),
    ):
        with pytest.raises(MethodError, match=words):
            find_method(name, task)
    assert find_method("json.decoder:JSONDecoder", Task.MAPPING).target == "json.decoder:JSONDecoder"
    listed = sfr("bench", "methods", "--json", "-")
    named = [item["name"] for item in json.loads(listed.out)["methods"]]
    assert named == ["sfr", "opencv", "orbslam3", "sfr", "sgbm", "pandora"]
    assert __version__ in listed.out
    assert (Path(sfr("bench", "methods", "--include-dir").out.strip()) / "sfr_candidate.h").is_file()
    for method in ("external", "none"):
        assert sfr("localise", tmp_path, "-o", tmp_path / "out.csv", "--method", method).code == 2


ORBSLAM3 = """
import numpy as np

class Sensor:
    STEREO = 1

class Answer:
    pose_valid = True

class Slam:
    def __init__(self, vocab_file, settings_file, sensor, use_viewer):
        assert open(vocab_file).read() == "words"
        assert "Camera.fps: 10.0" in open(settings_file).read()
    def track_stereo(self, left, right, seconds):
        answer = Answer()
        answer.pose_wc = np.eye(4)
        answer.pose_wc[2, 3] = seconds  # forward, 1 m/s
        return answer
"""


def test_a_peer_is_found_in_its_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pyorbslam3.py").write_text(ORBSLAM3)
    (tmp_path / "pyorbslam3-9.1.dist-info").mkdir()
    (tmp_path / "pyorbslam3-9.1.dist-info" / "METADATA").write_text("Name: pyorbslam3\nVersion: 9.1\n")
    (tmp_path / "words.txt").write_text("words")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    *_, peer = methods_to_compare(
        Task.LOCALISATION, LocalisationConfig(), Path(sys.executable), tmp_path / "words.txt"
    )[0]
    with IsolatedLocaliser(peer, LOC_RIG, true_pose(0), rate_hz=10.0, hidden=()) as slam:
        slam.localise(loc_pair(0))
        estimate, call = slam.localise(replace(loc_pair(1), stamp_ns=loc_pair(0).stamp_ns + 1_100_000_000))
    assert not call.finding
    about = {"name": "orbslam3", "version": "9.1", "kind": MethodKind.PEER}
    assert slam.record == MethodRecord(**about, isolation=slam.record.isolation, readable_files=str(tmp_path))
    T_first_now = Transform(np.eye(3), np.array([0.0, 0.0, 1.1]))
    expected = true_pose(0) @ LOC_RIG.T_rb_left @ T_first_now @ LOC_RIG.T_rb_left.inverse()
    np.testing.assert_allclose(estimate.T_ds_rb.matrix, expected.matrix, atol=1e-12)


VARIABLES = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "2",
    "MKL_NUM_THREADS": "3",
    "NUMBA_NUM_THREADS": "4",
    "CUDA_VISIBLE_DEVICES": "1",
    "OMP_WAIT_POLICY": "passive",
    "OPENBLAS_CORETYPE": "Haswell",
}
TRUTHS = {
    "MODE": "good",
    "PATH_TO_TRUTH": "truth.csv",
    "LC_TRUTH": "1",
    "NUMBA_X": "1",
    "PYTHON_TRUTH": "1",
    "XDG_TRUTH": "1",
    "OMP_SCHEDULE": "QUJDREVGR0hJSktM",
    "OMP_THREAD_LIMIT": "123456",
    "NUMBA_CPU_FEATURES": "QUJDREVGR0hJSktM",
    "NVIDIA_VISIBLE_DEVICES": "QUJDREVGR0hJSktM",
    "MKL_CBWR": "QUJDREVGR0hJSktM",
    "USER": "QUJDREVGR0hJSktM",
    "TZ": "QUJDREVGR0hJSktM",
    "LC_CTYPE": "1 2 3",
    "LANG": "0.123," * 20,
    "CONDA_PREFIX": "/0.1,0.2",
    "VIRTUAL_ENV": "0.1" * 5000,
}


def test_a_method_receives_only_known_variables_with_a_plain_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name that begins with that of another variable is another name."""
    for name, value in (VARIABLES | TRUTHS).items():
        monkeypatch.setenv(name, value)
    (tmp_path / "folder-0.1").mkdir()
    (tmp_path / "link-0.2").symlink_to("/usr/bin")
    named = [str(tmp_path / "folder-0.1"), str(tmp_path / "link-0.2")]
    monkeypatch.setenv("PATH", os.pathsep.join(["/usr/bin", "/0.1,0.2,0.3", *named, "/bin", "/usr/../usr/bin"]))
    monkeypatch.setenv("TZDIR", os.pathsep.join(named))
    (tmp_path / "item.py").write_text("")
    found = environment_of(find_method(f"{tmp_path / 'item.py'}:Mine", Task.LOCALISATION), tmp_path)
    assert VARIABLES.items() <= found.items()
    assert TRUTHS.keys().isdisjoint(found)
    assert (found["PATH"], found["HOME"]) == (f"/usr/bin{os.pathsep}/bin", str(tmp_path))
    assert "TZDIR" not in found


def test_system_folders_are_passed_and_links_to_them_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The name of a link could contain data."""
    monkeypatch.delenv("SFR_METHOD_FILES", raising=False)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    (tmp_path / "link-0.2").symlink_to("/usr/bin")
    folders = ["/usr/share", "/usr/lib", "/usr", "/usr/bin"]
    monkeypatch.setenv("LD_LIBRARY_PATH", os.pathsep.join([*folders, str(tmp_path / "link-0.2")]))
    (tmp_path / "item.py").write_text("")
    found = environment_of(find_method(f"{tmp_path / 'item.py'}:Mine", Task.LOCALISATION), tmp_path)
    passed = found["LD_LIBRARY_PATH"].split(os.pathsep)
    assert passed == [*folders, str(tmp_path / "link-0.2")]
    assert isolation_of("files", can_read_all_files=False).readable_files == str(tmp_path / "link-0.2")


def test_received_variables_are_part_of_the_configuration_of_a_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SFR_METHOD_FILES", raising=False)
    (tmp_path / "item.py").write_text("")
    method = find_method(f"{tmp_path / 'item.py'}:Mine", Task.LOCALISATION)
    records = {}
    for threads in ("1", "2", "two"):
        for name in SETTINGS:
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        records[threads] = method.record("1", isolation_of("files", can_read_all_files=False))
    assert [record.variables for record in records.values()] == ["OMP_NUM_THREADS=1", "OMP_NUM_THREADS=2", None]
    assert len({record.config_sha256 for record in records.values()}) == 3
    assert records["two"].config_sha256 is None


@pytest.mark.parametrize(("content", "is_same"), [("weights", True), ("other weights", False)])
def test_the_files_of_a_method_are_part_of_its_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, is_same: bool
) -> None:
    """Weights that are replaced between two runs are another configuration."""
    (tmp_path / "item.py").write_text("")
    method = find_method(f"{tmp_path / 'item.py'}:Mine", Task.LOCALISATION)
    weights = tmp_path / "weights"
    weights.mkdir()
    monkeypatch.setenv("SFR_METHOD_FILES", str(weights))
    hashes = []
    for text in ("weights", content):
        (weights / "net.bin").write_text(text)
        hashes.append(method.record("1", isolation_of("files", can_read_all_files=False)).config_sha256)
    assert None not in hashes
    assert (hashes[0] == hashes[1]) == is_same


def test_kernels_in_the_cache_folder_of_the_user_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The method has another home folder."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    method = find_method("opencv", Task.LOCALISATION)
    source = str(PACKAGE / "methods" / "isolation.py")
    kernels = tmp_path / "home" / ".cache" / "numba"
    place = kernels / OfUser.get_suitable_cache_subpath(source)
    place.mkdir(parents=True)
    (place / "isolation.kernel.nbi").touch()
    (place / "model.npz").write_text("")
    rules = rules_of(method, tmp_path, ())
    assert [path for path in rules["read"] if Path(path).is_relative_to(kernels)] == [
        str(place / "isolation.kernel.nbi")
    ]
    assert str(kernels) in rules["names"]
    for name, value in environment_of(method, tmp_path).items():
        monkeypatch.setenv(name, value)
    locator = OfUser.from_function(environment_of, source)
    assert locator is not None
    assert locator.get_cache_path() == str(place)
