"""Files that the process of a method can and cannot read: its own code, the working directory, simulated sources."""

from __future__ import annotations

import csv
import py_compile
from importlib.util import cache_from_source
from pathlib import Path
from py_compile import PycInvalidationMode

import pytest

from helpers.made_scene import LOC_RIG, loc_pair, write_folder
from helpers.made_suites import recording
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.registry import find_method
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.jobs.job_run import run_job
from sfr_loc_map.suite_names import Task

READER = """
from pathlib import Path
import numpy as np
class Reader:
    def __init__(self, rig, config):
        self.paths = config.splitlines()
        self.statistics = {}
    def process(self, pair):
        self.statistics = {path: float(can_read(path)) for path in self.paths}
        return np.eye(4)

def can_read(path):
    try:
        return bool(Path(path).read_bytes())
    except OSError:
        return False
"""


def test_a_class_of_a_package_reads_its_package_and_not_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, copy = tmp_path / "reading_candidate", tmp_path / "converted" / "groundtruth.csv"
    package.mkdir()
    copy.parent.mkdir()
    for path, text in (
        (package / "__init__.py", ""),
        (package / "constants.py", "GAIN = 1.0"),
        (package / "reader.py", f"from . import constants\n{READER}"),
        (package / "weights.txt", "1 2 3"),
        (copy, "stamp_ns,x,y,z"),
    ):
        path.write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    method = find_method("reading_candidate.reader:Reader", Task.LOCALISATION, f"{package / 'weights.txt'}\n{copy}")
    with IsolatedLocaliser(method, LOC_RIG, Transform.identity(), hidden=()) as localiser:
        _, call = localiser.localise(loc_pair(0))
    assert not call.finding
    found = {name: value for name, value in call.statistics.items() if name.startswith(str(tmp_path))}
    assert found == {str(package / "weights.txt"): 1.0, str(copy): 0.0}


def test_a_class_of_a_file_reads_the_code_beside_it_and_no_other_file(tmp_path: Path) -> None:
    """A copy of the truth may be in the folder of the candidate, or below it."""
    package, recordings = tmp_path / "package", tmp_path / "recordings"
    package.mkdir()
    recordings.mkdir()
    code = tmp_path / "module.py", tmp_path / "libpart.so.1", package / "__init__.py"
    copies = tmp_path / "groundtruth.csv", recordings / "groundtruth.csv"
    for path in (*code, *copies):
        path.write_text("# 1")
    (tmp_path / "candidate.py").write_text(f"import module\nimport package\n{READER}")
    config = "\n".join(map(str, (*code, *copies)))
    method = find_method(f"{tmp_path / 'candidate.py'}:Reader", Task.LOCALISATION, config)
    with IsolatedLocaliser(method, LOC_RIG, Transform.identity(), hidden=()) as localiser:
        _, call = localiser.localise(loc_pair(0))
    assert not call.finding
    found = {name: value for name, value in call.statistics.items() if name.startswith(str(tmp_path))}
    assert found == dict.fromkeys(map(str, code), 1.0) | dict.fromkeys(map(str, copies), 0.0)


@pytest.mark.parametrize("place", ["package", "file"])
def test_what_the_hash_of_the_own_code_ignores_is_neither_read_nor_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """Python loads the compiled code of an unchecked hash in place of the sources."""
    folder = tmp_path / "ignoring_candidate"
    (folder / "tools").mkdir(parents=True)
    code, constants = folder / "reader.py", folder / "constants.py"
    for path in (folder / "__init__.py", folder / "tools" / "__init__.py", folder / "tools" / ".truth"):
        path.write_text("# 1")
    (folder / ".truth.csv").write_text("stamp_ns,x,y,z")
    compiled = Path(cache_from_source(constants))
    constants.write_text("GAIN = 1.0")
    py_compile.compile(str(constants), str(compiled), invalidation_mode=PycInvalidationMode.UNCHECKED_HASH)
    constants.write_text("GAIN = 0.0")
    statement = "self.statistics['gain'] = constants.GAIN\n        return"
    imported = "from . import constants" if place == "package" else "import constants"
    code.write_text(f"{imported}\n{READER.replace('return', statement, 1)}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # permits the complete folder
    unreadable = [compiled, folder / "tools" / ".truth"]
    spec = "ignoring_candidate.reader:Reader" if place == "package" else f"{code}:Reader"
    if place == "package":
        unreadable.append(folder / ".truth.csv")
    method = find_method(spec, Task.LOCALISATION, "\n".join(map(str, unreadable)))
    with IsolatedLocaliser(method, LOC_RIG, Transform.identity(), hidden=()) as localiser:
        _, call = localiser.localise(loc_pair(0))
    assert not call.finding
    assert [name for name in (*map(str, unreadable), "gain") if call.statistics[name]] == []


def test_the_simulated_sources_of_a_suite_are_hidden(tmp_path: Path) -> None:
    """Variants of an error budget have the same true path."""
    variant = tmp_path / "cache" / "simulated-other" / "groundtruth.csv"
    variant.parent.mkdir(parents=True)
    variant.write_text("stamp_ns,x,y,z")
    (tmp_path / "candidate.py").write_text(READER)
    spec = f"{tmp_path / 'candidate.py'}:Reader"
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    job = Job(
        task=JobTask.LOCALISE,
        source=recording(path=str(write_folder(tmp_path / "x", 12, 0))),
        fault_seed=0,
        configuration="reader",
        parameters={"localisation.method": spec, "localisation.method_config": str(variant)},
        input_files={"localisation.method": find_method(spec, Task.LOCALISATION).sha256 or ""},
        start="truth",
        scoring=TrajectoryScoreConfig(conditions=("frames=3",), spacing=1),
        repeat=0,
        threads=1,
        code="",
    )
    run_job(job, scratch, tmp_path / "cache")
    with (scratch / "stats.csv").open(newline="") as stream:
        assert {float(row[str(variant)]) for row in csv.DictReader(stream)} == {0.0}
