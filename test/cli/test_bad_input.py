"""Invalid input of every kind: exit code 2, one line that names the file and the fix, and no output left behind."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import broken_sources as broken
from helpers.cli_result import Result, Sfr
from sfr_loc_map.errors import ExitCode, FailedVerdictError, InputError, NotJudgedError

Made = Callable[[Path], Path]
MadeOnce = Callable[[Made], Path]

LOCALISE = ("localise", "-o", "{out}/t.csv", "--stats", "{out}/s.csv", "--start", "truth")
MAP = ("map", "-o", "{out}/c.ply", "--stats", "{out}/m.csv")
TO_BAG = ("convert", "{out}/b.mcap")
COMMANDS = {"localise": LOCALISE, "map": MAP, "to bag": TO_BAG}

SOURCES: dict[str, tuple[Made, str] | tuple[Made, str, tuple[str, ...]]] = {
    "missing": (broken.missing, "No such file or directory; give a"),
    "empty folder": (broken.empty_folder, "no supported format.*found nothing; give"),
    "empty bag": (broken.empty_bag, "has no messages: record it again"),
    "truncated bag": (broken.truncated_bag, "corrupt or truncated: record or copy it again"),
    "flipped image": (broken.flipped_image, r"000001.png.*; \w+"),
    "no camera_info": (broken.no_camera_info, "no topic 'loc/right/camera_info'.*; record it"),
    "silent camera_info": (broken.silent_camera_info, "no message on '/loc/left/camera_info'"),
    "unequal sizes": (broken.unequal_sizes, "000001.png.* is 150 x 120: 160 x 120, the size of the rig"),
    "not rectified": (broken.not_rectified, "no projection matrix p.*calibrate both cameras as a pair"),
    "nan in poses": (broken.nan_in_poses, "(groundtruth|pairs).csv' line 3.*not .*finite.*; correct"),
    "backwards": (broken.backwards, "pairs.csv'.*in increasing order"),
    "broken rig": (broken.broken_rig, "rig.json.*truncated"),
    "no place on the rover": (broken.no_place_on_the_rover, "T_rb_locsb.*: set extrinsics", ("localise",)),
    "four pairs": (broken.four_pairs, "has 4 stereo pairs: a source with 1 to 3 is required for a map", ("map",)),
    "no drive": (broken.four_pairs, "no drive .*: give a source that has one", ("localise",)),
}
CASES = [(name, command) for name, (_, _, *only) in SOURCES.items() for command in (only[0] if only else COMMANDS)]


def check(result: Result, named: object, words: str, out: Path, code: int = ExitCode.BAD_INPUT) -> None:
    """Check everything that holds for every refusal."""
    lines = [line for line in result.err.splitlines() if line.strip()]
    assert result.code == code, result
    assert len(lines) == 1, result.err
    assert lines[0].startswith("sfr: ")
    assert str(named) in lines[0]
    assert re.search(words, lines[0]), lines[0]
    assert "Traceback" not in result.err + result.out
    assert result.out == ""
    assert list(out.rglob("*")) == [], "nothing is left behind"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(("source", "command"), CASES, ids=[f"{s}-{c}" for s, c in CASES])
def test_bad_source(sfr: Sfr, made_once: MadeOnce, out: Path, source: str, command: str) -> None:
    make, words, *_ = SOURCES[source]
    path = made_once(make)
    name, *rest = (word.format(out=out) for word in COMMANDS[command])
    check(sfr(name, path, *rest), path, words, out)


@pytest.mark.parametrize(
    ("command", "content", "words"),
    [
        ("localise", "localisation: {max_feature: 100}\n", "unknown key 'max_feature' .did you mean 'max_features'?"),
        ("localise", "/**:\n  ros__parameters:\n    localisation.max_feature: 1\n", "unknown key 'max_feature'"),
        ("localise", "[1, 2", "not valid YAML"),
        ("info", "localisation: {nope: 1}\n", "unknown key 'nope'"),
        ("map", "mapping: {nope: 1}\n", "unknown key 'nope'"),
    ],
)
def test_bad_configuration(
    sfr: Sfr, made_once: MadeOnce, tmp_path: Path, out: Path, command: str, content: str, words: str
) -> None:
    path = tmp_path / "some.yaml"
    path.write_text(content)
    name, *rest = (word.format(out=out) for word in ({"info": ("info",)} | COMMANDS)[command])
    source = made_once(broken.good_folder)
    check(sfr(name, source, *rest, "--config", path), path, words, out)


TUM = "1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("e.txt", TUM + "3.0 two 0 0 0 0 0 1\n", "line 3: 'two' is not a finite number; correct"),
        ("e.tum", TUM + "3.0 0 0 0 0 0 0 0\n", "line 3: the quaternion .* is not a rotation.*; correct"),
        ("e.txt", "", "has no pose: at least one line"),
        ("e.csv", "Frame,X\n1.5,2\n2.5,3\n", "line 1 is .Frame,X.: .*t, y, z not found.*--columns"),
        ("e.ply", "ply\nformat", "cannot be read.*; write it again"),
        ("e.npz", "PK", "cannot be read"),
    ],
)
def test_bad_estimate(sfr: Sfr, tmp_path: Path, out: Path, name: str, content: str, words: str) -> None:
    path, truth = tmp_path / name, tmp_path / "truth.txt"
    path.write_text(content)
    truth.write_text(TUM)
    if path.suffix in (".ply", ".pcd", ".npz"):
        truth = broken.good_folder(tmp_path / "truth")
    check(sfr("score", path, truth, "--json", out / "s.json", "--html", out / "s.html"), path, words, out)


@pytest.mark.parametrize("command", ["localise", "map"])
@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("{tmp}/nowhere/o.{end}", "the folder .* does not exist; create it first"),
        ("{tmp}/out/o.xyz", "a name that ends in"),
        ("/proc/sfr_o.{end}", "cannot write .*; check"),
    ],
)
def test_output_that_cannot_be_written_is_refused_before_the_work(
    sfr: Sfr,
    made_once: MadeOnce,
    tmp_path: Path,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    output: str,
    words: str,
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr("sfr_loc_map.localisation.localiser.Localiser.__init__", never)
    monkeypatch.setattr("sfr_loc_map.mapping.mapper.Mapper.__init__", never)
    source = made_once(broken.good_folder)
    (tmp_path / "file").write_text("")
    path = output.format(tmp=tmp_path, end={"localise": "csv", "map": "ply"}[command])
    check(sfr(command, source, "-o", path), path, words, out)
    if "that ends" not in words:
        good = out / {"localise": "t.csv", "map": "c.ply"}[command]
        check(sfr(command, source, "-o", good, "--stats", path), path, words, out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("localise",), "Missing argument 'SRC': see 'sfr localise --help'"),
        (("localise", "{source}", "-o", "{out}/t.csv", "--start", "here"), "Invalid value for '--start'.*'here'"),
        (("localise", "{source}", "-o", "{out}/t.csv", "--remap", "a=b"), "'--remap a=b': FOUND:=EXPECTED is required"),
        (("localise", "{source}", "-o", "{out}/t.csv", "--remap", "a:=b:=c"), "FOUND:=EXPECTED is required"),
        (("live", "--namespace", "//", "--port", "0"), "'--namespace //' is not a ROS namespace"),
        (("map", "{source}", "-o", "{out}/c.ply", "--fusion"), "No such option.*--fusion.*: see 'sfr map --help'"),
        (("fly",), "No such command 'fly': see 'sfr --help'"),
        (("score", "{tum}", "{tum}", "--condition", "distance=far"), "distance=far"),
        (("convert", "{source}", "{out}/f", "--jpeg-quality", "90"), "JPEG.*to bags"),
        (("simulate", "{out}/f", "--from={source}", "--fault", "dropped:share=1,start=0"), "the faults drop all pairs"),
        (("score", "{out}/c.ply", "{tum}", "--align", "se3"), "omit it for a cloud"),
        (("map", "{source}", "-o", "{out}/c.ply", "--dem", "x.jpg"), r"cannot write 'x.jpg': a name that ends in .npz"),
        (("report", "{tum}", "-o", "{out}/p.svg"), "html"),
        (("plot", "{tum}", "-o", "{out}/p.html"), "'sfr plot' was removed: use sfr report"),
        (("doctor", "{source}"), "use sfr info"),
        (("live", "--terminal", "--port", "0"), "'--port' applies to the page.*: omit it"),
        (("score", "{tum}", "{tum}", "--diagnose", "--junit", "{out}/j.xml"), "'--junit' has no effect.*: omit it"),
        (("score", "{tum}", "{tum}", "--spacing", "0"), "Invalid value for '--spacing'"),
        (
            ("convert", "{tum}", "{out}/e.tum", "--compression", "zstd"),
            "'--compression' does not apply to a trajectory",
        ),
        (
            ("convert", "{source}", "{out}/e.tum", "--columns", "t,x,y,z"),
            "'--columns' does not apply to the true trajectory",
        ),
        (("convert", "{tum}", "{out}/f", "--to", "kitti"), "'--to' does not apply to a trajectory"),
        (("simulate", "{out}/f", "--from={source}", "--workers", "3"), "'--workers' has no effect with --from"),
        (("simulate", "{out}/f", "--fault", "black"), "'--fault' applies only to a recording"),
        (("replay", "{source}", "--live-port", "0"), "'--live-port' applies to the page: give --live"),
        (("simulate", "{out}/f", "--set", "seed"), "'--set seed': KEY=VALUE is required"),
        (("bench", "localise", "{source}", "--vocab", "{tum}"), "'--vocab' .*: give --peer-python"),
        (("bench", "methods", "--include-dir", "--json", "-"), "'--json' has no effect with --include-dir"),
        (("convert", "{tum}", "{out}/e.tum", "--columns", "truth:t,x,y,z"), "is the only table: omit 'truth:'"),
        (("doctor", "--calibration", "{tum}"), "No such option.*--calibration"),
        (("init", "{out}/f", "--calibration", "{tum}"), "'--calibration' describes a recording: give --from SRC"),
        (("init", "{out}/f", "--remap", "a:=b"), "'--remap' describes a recording: give --from SRC"),
        (
            ("localise", "{source}", "-o", "{out}/t.csv", "--call-timeout", "120"),
            "'--call-timeout' applies to a method",
        ),
        (("localise", "{source}", "-o", "{out}/t.csv", "--remap", "a:=b"), "applies only to topics of a bag"),
        (("info", "{source}", "--remap", "a:=b"), "applies only to topics of a bag"),
        (
            ("localise", "{source}", "-o", "{out}/t.csv", "--method", "opencv", "--video", "{out}/v.avi"),
            "'--video' applies only to the built-in method: omit it",
        ),
        (("map", "{source}", "-o", "{out}/c.ply", "--memory-limit", "900"), "'--memory-limit' applies to a method"),
        (
            ("map", "{source}", "-o", "{out}/c.ply", "--method", "sgbm", "--refine-poses"),
            "'--refine-poses' applies only to the built-in method",
        ),
        (("replay", "{source}", "--overwrite"), "'--overwrite' replaces the files of a folder: give --out"),
        (("replay", "{source}", "--answer-timeout", "5"), "'--answer-timeout' applies only to an external node"),
        (("report", "{tum}", "-o", "{out}/p.html", "--align", "se3"), "'--align' .*: give --truth TRUTH"),
        (("report", "{tum}", "-o", "{out}/p.html", "--max-difference", "0.01"), "'--max-difference' .*: give --truth"),
        (("report", "{tum}", "-o", "{out}/p.html", "--lenient"), "'--lenient' does not apply to trajectories"),
        (("score", "{out}/c.ply", "{source}", "--spacing", "10"), "'--spacing' applies only to trajectories"),
        (("score", "{tum}", "{tum}", "--range", "0", "10"), "'--range' applies only to clouds"),
        (("score", "{tum}", "{tum}", "--not-fused"), "'--not-fused' applies only to clouds"),
        (("score", "{tum}", "{tum}", "--diagnose", "--condition", "time=1"), "'--condition' has no effect"),
        (("simulate", "{tum}", "{out}/f", "--from={source}"), "has no effect with --from"),
        (("suite", "run", "{tum}", "--out", "{out}/s", "--dry-run", "--json", "-"), "'--json' has no effect"),
        (("score", "{tum}", "{tum}", "--max-gap", "-1"), "sfr: '--max-gap' is -1.0: 0.0 to 3600.0 s is required"),
        (("score", "{tum}", "{tum}", "--spacing", "2000000"), "sfr: '--spacing' is 2000000: 1 to"),
        (("score", "{tum}", "{tum}", "--condition", "far"), "sfr: '--condition': 'far' is not a condition"),
        (("score", "{out}/c.ply", "{source}", "--range", "-1", "5"), "sfr: '--range' is -1.0: 0.0 to"),
        (("score", "{tum}", "{tum}", "--rpe-delta", "frames=2"), "sfr: '--rpe-delta' .* require '--align'"),
        (("score", "{tum}", "{tum}", "--align=se3", "--rpe-delta=time=2"), "sfr: '--rpe-delta': 'time=2' is not a"),
        (("score", "{tum}", "{tum}", "--align=se3", "--max-difference=-1"), "sfr: '--max-difference' is -1.0"),
        (
            ("score", "{tum}", "{tum}", "--frames=images", "--associate=match"),
            "'--frames' images .* '--associate' match",
        ),
        (
            ("report", "{tum}", "--truth={tum}", "-o", "{out}/p.html", "--max-difference=-1"),
            "sfr: '--max-difference' is",
        ),
        (("replay", "{source}", "--condition", "far"), "sfr: '--condition': 'far' is not a condition"),
        (("bench", "faults", "{source}", "--condition", "far"), "sfr: '--condition': 'far' is not a condition"),
        (("bench", "localise", "{source}", "--condition", "far"), "sfr: '--condition': 'far' is not a condition"),
        (
            ("map", "{source}", "-o", "{out}/c.ply", "--method=sgbm", "--memory-limit=1"),
            "sfr: '--memory-limit' is 1: 50 to",
        ),
        (
            ("map", "{source}", "-o", "{out}/c.ply", "--method=sgbm", "--call-timeout=0"),
            "sfr: '--call-timeout' is 0.0: 0.05 to",
        ),
        (("simulate", "{out}/f", "--set", "terrain.relief_m=-1"), "sfr: --set: 'terrain.relief_m' is -1"),
    ],
)
def test_bad_usage(
    sfr: Sfr, made_once: MadeOnce, tmp_path: Path, out: Path, arguments: tuple[str, ...], words: str
) -> None:
    source, tum = made_once(broken.good_folder), tmp_path / "e.txt"
    tum.write_text(TUM)
    check(sfr(*(word.format(source=source, out=out, tum=tum) for word in arguments)), "", words, out)


def test_a_fault_of_the_program_is_one_line_too(
    sfr: Sfr, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise KeyError("deep\ninside")

    monkeypatch.setattr("sfr_loc_map.io.registry.open_source", fail)
    arguments = ("localise", tmp_path, "-o", out / "t.csv")
    check(sfr(*arguments), "KeyError", "a fault of the program, run 'sfr --debug", out, ExitCode.FAULT)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("no drive"), 2),
        (OSError(28, "No space left on device", "drive.csv"), 2),
        (LookupError("inside"), 70),
        (FailedVerdictError("missed"), 1),
        (NotJudgedError("no data"), 3),
    ],
)
def test_debug_adds_the_traceback_of_an_error_and_keeps_its_exit_code(
    sfr: Sfr, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("sfr_loc_map.io.registry.open_source", fail)
    arguments = ("localise", tmp_path, "-o", out / "t.csv")
    plain = sfr(*arguments)
    monkeypatch.setenv("SFR_DEBUG", "1")
    debug = sfr(*arguments)
    assert plain.code == debug.code == code
    assert ("Traceback" in debug.err) == (code in (2, 70))
    assert debug.err.splitlines()[-1] == plain.err.splitlines()[-1]
    assert len(plain.err.splitlines()) == 1


@pytest.mark.parametrize("words", [("info",), ("score", "{source}/loc/groundtruth.csv"), ("replay",)])
def test_a_wrong_condition_of_a_configuration_is_refused_with_its_file(
    sfr: Sfr, made_once: MadeOnce, tmp_path: Path, out: Path, words: tuple[str, ...]
) -> None:
    source, config = made_once(broken.good_folder), tmp_path / "c.yaml"
    config.write_text("conditions: [far]\n")
    command = [word.format(source=source) for word in words]
    check(sfr(*command, source, "--config", config), config, "c.yaml, conditions: 'far' is not a condition", out)


@pytest.mark.parametrize("command", ["convert", "map"])
def test_a_remapping_to_a_name_that_nothing_reads_leaves_nothing_out_in_silence(
    sfr: Sfr, made_once: MadeOnce, out: Path, command: str
) -> None:
    bag = made_once(broken.good_bag)
    arguments = {"convert": (bag, out / "f"), "map": (bag, "-o", out / "c.ply")}
    result = sfr(command, *arguments[command], "--remap", "/loc/left/image_rect:=/loc/left/image_rct")
    check(result, bag, "no topic is read as 'loc/left/image_rct'.* did you mean loc/left/image_rect", out)
    result = sfr(command, *arguments[command], "--remap", "/loc/lft/image_rect:=/loc/left/image_rect")
    check(result, bag, "no topic 'loc/lft/image_rect' .* did you mean loc/left/image_rect", out)
