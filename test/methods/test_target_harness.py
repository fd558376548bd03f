"""The C harness for a target (examples/c_candidate): on this host, and big-endian on SPARC under an emulator."""

import csv
import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from helpers import HELPERS, ROOT, score_rows
from helpers.cli_result import Sfr

SOURCES = [ROOT / "examples/c_candidate" / name for name in ("harness.c", "candidate.c")]
WRAP = "-Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc,--wrap=free"
SPARC = "sparc64-linux-gnu-gcc"


def compiled(compiler: str, output: Path, *options: str, sources: list[Path] = SOURCES) -> Path:
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler}")
    strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-O2")
    words = [compiler, *strict, *options, "-I", ROOT / "include", *sources, "-o", output, "-lm"]
    subprocess.run(list(map(str, words)), check=True)
    return output


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture(scope="module")
def pairs(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from sfr_loc_map.io.layouts.board_file import write_pairs
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.runs.drive_start import start_pose

    path, source = tmp_path_factory.mktemp("target") / "pairs.sfrp", open_source(drive)
    assert source.loc is not None
    write_pairs(path, source, start_pose(source.loc, "truth").T_ds_rb)
    return path


@pytest.fixture(scope="module")
def on_host(pairs: Path) -> Path:
    folder = pairs.parent
    harness = compiled("cc", folder / "harness", WRAP, '-DSFR_FLAGS="-O2"')
    subprocess.run([harness, pairs, folder / "host"], check=True)
    return folder / "host"


def test_the_file_of_pairs_is_as_documented(pairs: Path, drive: Path) -> None:
    from sfr_loc_map.io.registry import open_source

    data, loc = pairs.read_bytes(), open_source(drive).loc
    assert loc is not None
    magic, version, sections, task, count, width, height = struct.unpack_from("<8s4I2i", data)
    assert (magic, version, sections, task, count) == (b"SFRPAIRS", 1, 2, 1, len(loc))
    assert (width, height) == (loc.rig.width, loc.rig.height)
    head = 32 + 8 * (5 + 24 + 7)
    first = next(iter(loc.pairs()))
    assert struct.unpack_from("<q", data, head)[0] == first.stamp_ns
    assert data[head + 8 : head + 8 + first.left.size] == first.left.tobytes()


def test_every_call_is_measured_and_memory_is_known(on_host: Path, drive: Path) -> None:
    rows = table(on_host / "stats.csv")
    assert [row["state"] for row in rows] == ["initialising", *["tracking"] * 11, "mapped_set"]
    for row in rows:
        assert float(row["processing_time_s"]) > 0.0
        assert 50_000 < int(row["heap_peak_bytes"]) < 5_000_000
        assert 1000 < int(row["stack_peak_bytes"]) < 65_536
        assert int(row["peak_rss_bytes"]) > int(row["above_idle_bytes"])
    about = json.loads((on_host / "target.json").read_text())
    assert (about["flags"], about["board"], about["byte_order"]) == ("-O2", None, "little-endian")


@pytest.mark.clause("4.2.2")
def test_a_known_allocation_is_counted(pairs: Path, tmp_path: Path) -> None:
    sources = [SOURCES[0], HELPERS / "faulty_candidate.c"]
    options = (WRAP, "-D_POSIX_C_SOURCE=200112L", '-DKIND="allocate"')
    harness = compiled("cc", tmp_path / "harness", *options, sources=sources)
    subprocess.run([harness, pairs, tmp_path / "results"], check=True)
    size = 200 * 1024 * 1024
    for row in table(tmp_path / "results" / "stats.csv")[:-1]:  # the last is of the mapper
        assert int(row["heap_peak_bytes"]) == pytest.approx(size, rel=0.01)
        assert int(row["above_idle_bytes"]) == pytest.approx(size, rel=0.01)


@pytest.mark.clause("4.2.1")
def test_poses_clouds_and_times_of_a_board_make_one_report(
    on_host: Path, drive: Path, tmp_path: Path, sfr: Sfr
) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text(
        "target:\n  localisation_p95_s: 60\n  mapping_call_max_s: 600\n  localisation_heap_peak_bytes: 5000000\n"
    )
    ran = sfr("score", on_host, drive, "--limits", limits, "--condition", "frames=3", "--json", tmp_path / "s.json")
    assert ran.code == 0, ran.err
    score = json.loads((tmp_path / "s.json").read_text())
    assert score["association"]["matched"] == 12
    assert score_rows.number(score, "points") > 100
    assert score_rows.number(score, "localisation", "n", part="target") == 12
    assert score_rows.number(score, "mapping_call", "n", part="target") == 1
    assert score["target"]["matched_share"] == 1.0
    assert score["target"]["about"]["flags"] == "-O2"
    assert not score_rows.row(score, "localisation", part=None)


@pytest.mark.slow
def test_a_big_endian_board_gives_the_same_poses_and_clouds(
    pairs: Path, on_host: Path, drive: Path, tmp_path: Path, sfr: Sfr
) -> None:
    emulator = shutil.which("qemu-sparc64")
    if emulator is None:
        pytest.skip("there is no qemu-sparc64")
    harness = compiled(SPARC, tmp_path / "harness", WRAP, "-static", "-DSFR_NO_PROC", '-DSFR_BOARD="emulated SPARC"')
    subprocess.run([emulator, harness, pairs, tmp_path / "sparc"], check=True)
    states = [[row["state"] for row in table(place / "stats.csv")] for place in (on_host, tmp_path / "sparc")]
    assert states[0] == states[1]
    poses = [np.loadtxt(place / "estimate.csv", delimiter=",", skiprows=1) for place in (on_host, tmp_path / "sparc")]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0.0, atol=1e-9)
    assert (on_host / "cloud_0.ply").read_bytes() == (tmp_path / "sparc" / "cloud_0.ply").read_bytes()
    limits = tmp_path / "limits.yaml"
    limits.write_text("target:\n  localisation_peak_bytes: 1000000000\n")
    ran = sfr("score", tmp_path / "sparc", drive, "--limits", limits, "--condition", "frames=3", "--json", "-")
    target, (verdict, *_) = json.loads(ran.out)["target"], json.loads(ran.out)["verdicts"]
    assert (ran.code, verdict["verdict"]) == (3, "not enough data")
    assert (target["about"]["byte_order"], target["name"]) == ("big-endian", "emulated SPARC")


def test_results_come_from_a_console_too(pairs: Path, on_host: Path, tmp_path: Path) -> None:
    """As on a board without files: pairs linked in, results on the console, taken apart as the docs say."""
    blob = tmp_path / "pairs.s"
    blob.write_text(
        f'.section .rodata\n.global sfr_pairs, sfr_pairs_end\nsfr_pairs: .incbin "{pairs}"\nsfr_pairs_end:\n'
        '.section .note.GNU-stack,"",%progbits\n'
    )
    harness = compiled(
        "cc", tmp_path / "harness", WRAP, "-DSFR_IN_MEMORY", "-DSFR_TO_STDOUT", "-DSFR_NO_PROC", str(blob)
    )
    console = subprocess.run([harness], check=True, capture_output=True, text=True).stdout
    subprocess.run(["awk", "/^@@ /{f=$2; next} f{print > f}"], input=console, cwd=tmp_path, text=True, check=True)
    for name in ("estimate.csv", "cloud_0.ply"):
        assert (tmp_path / name).read_bytes() == (on_host / name).read_bytes()
    assert all(row["peak_rss_bytes"] == "" for row in table(tmp_path / "stats.csv"))


def test_it_compiles_for_a_32_bit_board(tmp_path: Path) -> None:
    """Flags of RTEMS on a GR740; the C library of the cross-compiler is of 64 bits, so that it is not linked."""
    (tmp_path / "gnu").mkdir()
    (tmp_path / "gnu" / "stubs-32.h").touch()
    if shutil.which(SPARC) is None:
        pytest.skip(f"there is no {SPARC}")
    for number, source in enumerate(SOURCES):
        flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-m32", "-mcpu=leon3", "-isystem", tmp_path]
        board = ["-DSFR_IN_MEMORY", "-DSFR_TO_STDOUT", "-DSFR_NO_PROC", "-I", ROOT / "include"]
        output = tmp_path / f"{number}.o"
        subprocess.run(list(map(str, [SPARC, *flags, *board, "-c", source, "-o", output])), check=True)
        assert output.read_bytes()[4:6] == bytes([1, 2])  # 32 bits, big-endian


def test_pairs_that_end_early_are_said(pairs: Path, on_host: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.sfrp"
    for data in (pairs.read_bytes()[:5000], b"not pairs at all"):
        cut.write_bytes(data)
        ran = subprocess.run([on_host.parent / "harness", cut, tmp_path / "results"], capture_output=True, text=True)
        assert ran.returncode == 2
        assert len(ran.stderr.splitlines()) == 1
