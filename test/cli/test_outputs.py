"""Outputs: a file is replaced only with --overwrite, two outputs share no file, and foreign files are kept."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import broken_sources as broken
from helpers.cli_result import Sfr
from sfr_loc_map.cli.output import output_folder
from sfr_loc_map.cli.source_files import source_of_file
from sfr_loc_map.configuration import sections
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory

MadeOnce = Callable[[Callable[[Path], Path]], Path]
TUM = "".join(f"{t}.0 {0.5 * t} 0 0 0 0 0 1\n" for t in range(30))
TWICE = {
    "localise": ("localise", "{source}", "-o", "{out}/z.csv", "--stats", "{out}/../out/z.csv"),
    "map": ("map", "{source}", "-o", "{out}/z.ply", "--stats", "{out}/z.ply"),
    "map beside": ("map", "{source}", "-o", "{out}/z.ply", "--covariance", "--stats", "{out}/z.covariance.npz"),
    "score": ("score", "{tum}", "{tum}", "--json", "{out}/z.html", "--html", "{out}/z.html"),
    "input": ("score", "{tum}", "{tum}", "--json", "{tum}", "--overwrite"),
    "estimate": ("check", "{source}", "--estimate", "{tum}", "--json", "{tum}", "--overwrite"),
    "default page": ("report", "{out}/score.json", "--json", "{out}/report.html"),
}
EXISTS = {
    "localise": ("localise", "{source}", "-o", "{file}.csv"),
    "map": ("map", "{source}", "-o", "{file}.ply"),
    "score": ("score", "{tum}", "{tum}", "--json", "{file}.json"),
    "report": ("report", "{tum}", "-o", "{file}.html"),
    "info": ("info", "{source}", "--json", "{file}.json"),
    "trajectory": ("convert", "{source}", "{file}.csv"),
}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    path = tmp_path / "e.tum"
    path.write_text(TUM)
    return path


@pytest.mark.parametrize("case", TWICE)
def test_two_outputs_on_one_path_are_refused(sfr: Sfr, made_once: MadeOnce, out: Path, tum: Path, case: str) -> None:
    source = made_once(broken.good_folder)
    result = sfr(*(word.format(source=source, out=out, tum=tum) for word in TWICE[case]))
    assert (result.code, result.out) == (2, "")
    assert "; choose another name" in result.err
    assert list(out.iterdir()) == []
    assert tum.read_text() == TUM


def test_a_file_with_the_name_of_standard_output_is_not_replaced(
    sfr: Sfr, tum: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tum.parent)
    Path("-").write_text("mine")
    assert sfr("score", tum.name, tum.name, "--junit", "-").code == 2
    assert Path("-").read_text() == "mine"


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize(
    "words",
    [
        ("score", "{tum}", "{source}"),
        ("check", "{source}"),
        ("info", "{source}"),
        ("bench", "localise", "{source}"),
        ("bench", "map", "{source}"),
        ("bench", "faults", "{source}"),
    ],
)
def test_the_configuration_of_a_source_is_not_replaced(
    sfr: Sfr, made_once: MadeOnce, tum: Path, out: Path, words: tuple[str, ...], given: bool
) -> None:
    """The file beside the source is an input of the command, although no option names it."""
    source = out / "source"
    shutil.copytree(made_once(broken.good_folder), source)
    config = out / "other.yaml" if given else source / "sfr.yaml"
    config.write_text("truth:\n  sigma_m: 0.01\n")
    options = ("--config", config) if given else ()
    result = sfr(*(word.format(tum=tum, source=source) for word in words), *options, "--json", config, "--overwrite")
    assert result.code == 2
    assert "it is also an input of this command" in result.err
    assert config.read_text() == "truth:\n  sigma_m: 0.01\n"


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize(
    "words",
    [
        ("localise", "{source}", "-o", "{out}/t.csv"),
        ("map", "{source}", "-o", "{out}/c.ply"),
        ("convert", "{source}", "{out}/t.csv"),
        ("convert", "{source}", "{out}/pairs.sfrp"),
        ("convert", "{source}", "{out}/copy"),
        ("simulate", "{out}/copy", "--from", "{source}", "--fault", "dropped:share=0.5"),
        ("score", "{tum}", "{source}"),
    ],
)
def test_a_command_reads_the_configuration_once_and_reports_the_file_beside_the_source(
    sfr: Sfr,
    made_once: MadeOnce,
    tum: Path,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    given: bool,
) -> None:
    source = out / "source"
    shutil.copytree(made_once(broken.good_folder), source)
    config = out / "other.yaml" if given else source / "sfr.yaml"
    config.write_text("truth:\n  sigma_m: 0.01\n")
    read: list[Path] = []
    real = sections.load_yaml
    monkeypatch.setattr(sections, "load_yaml", lambda path: read.append(path) or real(path))
    options = ("--config", config) if given else ()
    result = sfr(*(word.format(tum=tum, source=source, out=out) for word in words), *options)
    assert read == [config]
    assert (f"configuration: {config}" in result.err.splitlines()) == (not given)


@pytest.mark.parametrize("case", EXISTS)
def test_a_file_that_exists_is_refused(sfr: Sfr, made_once: MadeOnce, out: Path, tum: Path, case: str) -> None:
    file = out / "precious"
    for suffix in (".csv", ".ply", ".json", ".html"):
        file.with_suffix(suffix).write_text("precious")
    source = made_once(broken.good_folder)
    result = sfr(*(word.format(source=source, out=out, file=file, tum=tum) for word in EXISTS[case]))
    assert (result.code, result.out) == (2, "")
    assert "a file exists; choose another name or give --overwrite" in result.err
    assert {path.read_text() for path in out.iterdir()} == {"precious"}


def test_a_failed_command_leaves_no_result_of_an_earlier_command(sfr: Sfr, out: Path, tum: Path) -> None:
    """JSON and JUnit have a verdict. Refused names remove nothing."""
    names = ("--json", out / "s.json", "--junit", out / "s.xml", "--limits", out / "absent.yaml", "--overwrite")
    for html, left in ((tum, {"s.json", "s.xml", "s.html"}), (out / "s.html", {"s.html"})):
        for name in ("s.json", "s.xml", "s.html"):
            (out / name).write_text("verdict")
        assert sfr("score", tum, tum, "--html", html, *names).code == 2
        assert {path.name for path in out.iterdir()} == left


def test_overwrite_replaces_a_file_and_standard_output_is_free(sfr: Sfr, out: Path, tum: Path) -> None:
    file = out / "s.json"
    file.write_text("old")
    assert sfr("score", tum, tum, "--json", file, "--overwrite").code == 0
    assert file.read_text().startswith("{")
    for _ in range(2):
        assert sfr("score", tum, tum, "--json", "-").code == 0
    for code in (0, 2):
        assert sfr("report", file).code == code
    assert sfr("report", file, "--overwrite").code == 0


def test_a_folder_that_holds_something_else_stays(sfr: Sfr, made_once: MadeOnce, out: Path) -> None:
    source, place = made_once(broken.good_folder), out / "mine"
    shutil.copytree(source, place)
    (place / "notes.txt").write_text("precious")
    result = sfr("convert", source, place, "--overwrite")
    assert result.code == 2
    assert "files that belong to neither a data set nor a bag" in result.err
    assert (place / "notes.txt").read_text() == "precious"
    for destination in (place, place / "loc"):
        within = sfr("convert", place / "loc", destination, "--overwrite")
        assert within.code == 2
        assert "it is or contains an input of this command; choose another name" in within.err


def test_a_resumable_output_is_overwritten_repeatedly_and_leaves_nothing_beside_it(
    made_once: MadeOnce, out: Path
) -> None:
    place, mine = out / "drive", out / "before"
    shutil.copytree(made_once(broken.good_folder), place)
    mine.write_text("precious")
    for number in range(2):
        with output_folder(place, overwrite=True, resumable=True) as new:
            shutil.copytree(place, new)
            (new / "loc" / "times.txt").write_text(str(number))
        assert (place / "loc" / "times.txt").read_text() == str(number)
        assert sorted(path.name for path in out.iterdir()) == ["before", "drive"]
    assert mine.read_text() == "precious"


def test_the_files_of_every_layout_belong_to_their_source(tmp_path: Path) -> None:
    """EuRoC without mav0, and folders of images, have no other name than those of their cameras."""
    for name in ("cam0/sensor.yaml", "cam1/data/1.png", "mav0/imu.csv", "Left/1.png", "infra2/1.png", "image_0/1.png"):
        assert source_of_file(tmp_path / name, [tmp_path]) == tmp_path, name
    for name in ("score.json", "results/left.json", "loc/score.json"):
        assert source_of_file(tmp_path / name, [tmp_path]) is None, name


def test_no_input_is_overwritten(sfr: Sfr, made_once: MadeOnce, out: Path) -> None:
    source, limits = out / "source", out / "limits.yaml"
    shutil.copytree(made_once(broken.good_folder), source)
    limits.write_text("trajectory:\n - {condition: frames=1, position_mean_plus_3sigma_m: 1e-3}\n")
    inputs = [limits, *(path for path in source.rglob("*") if path.is_file())]
    before, truth = [path.read_bytes() for path in inputs], next(source.rglob("groundtruth.csv"))
    poses = read_trajectory_file(truth).trajectory
    save_trajectory(out / "moved.csv", Trajectory(poses.stamps_ns, poses.positions + 0.001, poses.quats_xyzw))
    words = ["score", out / "moved.csv", source, "--limits", limits, "--overwrite"]
    for place in inputs:
        result = sfr(*words, "--json", place)
        assert result.code == 2
        assert re.search("it (is also|belongs to '.*',) an input of this command", result.err)
    assert sfr("localise", source, "-o", truth, "--overwrite").code == 2
    assert [path.read_bytes() for path in inputs] == before
    for _ in range(2):  # what was made beside them may be
        assert sfr(*words, "--json", truth.parent / "score.json").code in (0, 1, 3)
    named = out / "e.times.txt"
    named.write_text("1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n")
    result = sfr("convert", named, out / "e.kitti", "--overwrite")  # which comes with e.times.txt
    assert (result.code, "an input of this command" in result.err) == (2, True)
