"""Folders of images with a calibration, and configurations that lie beside other sources."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.kalibr_chains import CHAINS, LENSES, kalibr
from helpers.made_worlds import make_world, write_folder
from helpers.message_bags import write_messages
from helpers.pose_tables import COUNT, drive, rows, seconds
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import messages
from sfr_loc_map.io.clouds.cloud_file import load_cloud
from sfr_loc_map.io.convert import ConvertOptions, Layout, convert
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig, source_config
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.stored.score_json import from_json
from sfr_loc_map.report.summary import run_facts

NAMES = {"ns": "{ns}", "us": "{us}", "s": "{s}.{fraction:09d}", "words": "rig_{ns}_raw", "numbers": "frame{number:04d}"}


def images(folder: Path, unit: str, sides: tuple[str, str] = ("left", "right")) -> list[int]:
    stamps = drive().stamps_ns.tolist()[:6]
    width, height = LENSES["TUM-VI"][2]
    for side in sides:
        (folder / side).mkdir(parents=True)
        for number, stamp in enumerate(stamps, 1):
            parts = {
                "number": number,
                "ns": stamp,
                "us": stamp // 1000,
                "s": stamp // NS_PER_S,
                "fraction": stamp % NS_PER_S,
            }
            data = encode_png(np.full((height, width), 100, np.uint8))
            (folder / side / f"{NAMES[unit].format(**parts)}.png").write_bytes(data)
    if unit == "numbers":
        (folder / "times.txt").write_text("".join(f"{stamp / NS_PER_S:.9f}\n" for stamp in stamps))
    return stamps


@pytest.mark.parametrize("unit", NAMES)
@pytest.mark.parametrize("sides", [("left", "right"), ("cam0", "cam1")])
def test_a_folder_of_images_and_a_chain_of_kalibr_are_a_source(
    tmp_path: Path, sfr: Sfr, unit: str, sides: tuple[str, str]
) -> None:
    stamps = images(tmp_path / "drive", unit, sides)
    (tmp_path / "camchain.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_imu_cam"]))
    bare = sfr("info", tmp_path / "drive")
    assert bare.code == 1
    assert "--calibration FILE" in bare.out
    given = ["--set", "extrinsics.translation_m=[0.1, 0.0, 0.5]", "--set", "extrinsics.quat_xyzw=[0.0, 0.0, 0.0, 1.0]"]
    words = ["--from", tmp_path / "drive", "--calibration", tmp_path / "camchain.yaml", *given]
    done = sfr("init", tmp_path / "rover", *words)
    assert done.code == 0, done.err
    loc = open_source(tmp_path / "drive", source_config(tmp_path / "drive", tmp_path / "rover" / "sfr.yaml")).loc
    assert loc is not None
    assert list(loc.stamps_ns) == stamps
    assert next(iter(loc.pairs())).left.mean() > 90.0
    assert loc.rig.T_rb_sb is not None


def test_images_that_the_calibration_calls_the_other_side_are_refused(tmp_path: Path) -> None:
    """cam0 of the chain is the right camera: the folders cam0/ and cam1/ are the right and the left images."""
    images(tmp_path / "drive", "ns", ("cam0", "cam1"))
    images(tmp_path / "named", "ns", ("left", "right"))
    chain = tmp_path / "camchain.yaml"
    chain.write_text(
        kalibr("TUM-VI", *CHAINS["T_imu_cam"]).replace("cam0", "X").replace("cam1", "cam0").replace("X", "cam1")
    )
    config = SourceConfig(calibration=CalibrationConfig(file=str(chain)))
    with pytest.raises(InputError, match="left and right swapped"):
        open_source(tmp_path / "drive", config)
    assert open_source(tmp_path / "named", config).loc is not None


def test_a_broken_calibration_is_refused_and_a_good_one_is_named(tmp_path: Path, sfr: Sfr) -> None:
    images(tmp_path / "drive", "ns")
    chain = tmp_path / "camchain.yaml"
    chain.write_text(kalibr("TUM-VI", *CHAINS["T_imu_cam"]).replace("pinhole", "omni"))
    refused = sfr("init", tmp_path / "rover", "--from", tmp_path / "drive", "--calibration", chain)
    assert refused.code == 2
    assert refused.err.startswith(f"sfr: calibration '{chain}': cam0 has the camera_model 'omni': pinhole is required")
    assert not (tmp_path / "rover").exists()
    text = kalibr("TUM-VI", *CHAINS["T_imu_cam"])
    chain.write_text(text + text[text.index("cam1:") :].replace("cam1:", "cam2:"))
    done = sfr("info", tmp_path / "drive", "--calibration", chain, "--json", "-")
    assert json.loads(done.out)["calibration"] == "Kalibr 'camchain.yaml', cam0 and cam1"
    source = open_source(tmp_path / "drive", SourceConfig(calibration=CalibrationConfig(file=str(chain))))
    assert source.calibration == "Kalibr 'camchain.yaml', cam0 and cam1"


def test_the_advice_of_init_on_columns_of_the_truth_can_be_followed(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    images(tmp_path / "drive", "ns")
    (tmp_path / "camchain.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_imu_cam"]))
    text = rows(seconds(poses), poses.positions, separator=";", header="Zeit[s];Rechts[m];Hoch[m];Höhe[m]")
    (tmp_path / "station.csv").write_text(text.replace(".", ","), encoding="utf-8")
    words = ["--from", tmp_path / "drive", "--calibration", tmp_path / "camchain.yaml"]
    words += ["--set", "extrinsics.quat_xyzw=[0.0, 0.0, 0.0, 1.0]", "--set", f"truth.source={tmp_path / 'station.csv'}"]
    first = sfr("init", tmp_path / "rover", *words)
    assert "name the columns: --set 'truth.columns=t=HEADER,x=HEADER,y=HEADER,z=HEADER'" in first.err
    given = ["--set", "truth.columns=t=Zeit,x=Rechts,y=Hoch,z=Höhe", "--overwrite"]
    done = sfr("init", tmp_path / "rover", *words, *given)
    assert done.code == 0, done.err
    truth = open_source(tmp_path / "drive", source_config(tmp_path / "drive", tmp_path / "rover" / "sfr.yaml")).loc
    assert truth is not None
    assert truth.ground_truth is not None
    np.testing.assert_allclose(truth.ground_truth.positions, poses.positions, atol=1e-12)


@pytest.mark.parametrize(
    ("times", "words"), [("0.0\n0.1\n", "2 times for 6 images"), ("5\n4\n3\n2\n1\n0\n", "increasing")]
)
def test_times_that_do_not_fit_the_numbered_images_are_refused(tmp_path: Path, times: str, words: str) -> None:
    images(tmp_path / "drive", "numbers")
    (tmp_path / "drive" / "times.txt").write_text(times)
    (tmp_path / "c.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_cn_cnm1"]))
    with pytest.raises(InputError, match=words):
        open_source(tmp_path / "drive", SourceConfig(calibration=CalibrationConfig(file=str(tmp_path / "c.yaml"))))


def test_images_that_are_not_named_by_a_time_are_refused(tmp_path: Path, sfr: Sfr) -> None:
    for side in ("left", "right"):
        (tmp_path / "drive" / side).mkdir(parents=True)
        (tmp_path / "drive" / side / "frame_a.png").write_bytes(encode_png(np.zeros((8, 8), np.uint8)))
    (tmp_path / "c.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_cn_cnm1"]))
    (tmp_path / "sfr.yaml").write_text("calibration: {file: c.yaml}\n")
    done = sfr("info", tmp_path / "drive")
    assert done.code == 1
    assert "frame_a.png: stamps in one unit" in " ".join(done.out.split())


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["1.0", "2.0"], r"named 1\.0, 2\.0: stamps in one unit .* are required as names; rename them$"),
        (["4611686018427387904"], "is not a number of nanoseconds since 1970"),
        (["\u0661\u0662"], "stamps in one unit"),
        (["1700000000000000000", "01700000000000000000"], "have the same stamp"),
        (["left_1700000000000000000", "right_1700000000100000000"], "stamps in one unit"),
        (["0000", "0001"], r"or write the time of each, s, to '.*times\.txt'"),
        (
            ["1700000000000000000", "1700000000100000000", "1700000000"],
            "names in one unit and of one clock are required",
        ),
    ],
)
def test_names_of_images_that_give_no_unique_stamp_are_refused(tmp_path: Path, names: list[str], words: str) -> None:
    for side in ("left", "right"):
        (tmp_path / "drive" / side).mkdir(parents=True)
        for name in names:
            (tmp_path / "drive" / side / f"{name}.png").write_bytes(encode_png(np.zeros((8, 8), np.uint8)))
    if "1.0" in names:
        (tmp_path / "drive" / "times.txt").write_text("0.0\n0.1\n")
    (tmp_path / "c.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_cn_cnm1"]))
    with pytest.raises(InputError, match=words):
        open_source(tmp_path / "drive", SourceConfig(calibration=CalibrationConfig(file=str(tmp_path / "c.yaml"))))


def test_the_folder_of_a_bag_with_the_truth_is_relative_to_the_configuration(tmp_path: Path) -> None:
    """A truth in a bag, which is a folder, is found from every working directory."""
    images(tmp_path / "drive", "ns")
    (tmp_path / "c.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_cn_cnm1"]))
    poses = drive()
    rows_of_bag = zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True)
    entries = [("/ground_truth/odometry", stamp, messages.odometry(stamp, *row)) for stamp, *row in rows_of_bag]
    write_messages(tmp_path / "truth_bag", entries)
    (tmp_path / "sfr.yaml").write_text("calibration: {file: c.yaml}\ntruth: {source: truth_bag}\n")
    source = open_source(tmp_path / "drive")
    assert source.truth is not None
    np.testing.assert_array_equal(source.truth.positions, poses.positions)
    assert tmp_path / "truth_bag" in source.truth_paths()


def test_a_configuration_of_a_bag_is_not_one_of_a_folder_beside_it(tmp_path: Path, sfr: Sfr) -> None:
    (tmp_path / "sfr.yaml").write_text("topics: {loc/left/image_rect: /a}\ntruth: {source: /mocap/pose}\n")
    images(tmp_path / "other", "ns")
    save_trajectory(tmp_path / "e.csv", drive())
    done = sfr("score", tmp_path / "e.csv", tmp_path / "other")
    assert "mocap" not in done.err
    assert "--calibration FILE" in done.err


def test_provenance_names_every_file_that_was_read(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    images(tmp_path / "drive", "ns")
    (tmp_path / "drive" / "camchain.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_cn_cnm1"]))
    text = rows(seconds(poses), poses.positions, separator=";", header="t[s];east[m];north[m];height[m]")
    (tmp_path / "drive" / "station.csv").write_text(text)
    (tmp_path / "drive" / "sfr.yaml").write_text("calibration: {file: camchain.yaml}\ntruth: {source: station.csv}\n")
    save_trajectory(tmp_path / "e.csv", poses)
    done = sfr("score", tmp_path / "e.csv", tmp_path / "drive", "--condition", "distance=1", "--partial", "--json", "-")
    assert done.code == 0, done.err
    assert "configuration:" in done.err
    inputs = json.loads(done.out)["provenance"]["inputs"]
    names = {role: Path(item["path"]).name for role, item in inputs.items()}
    assert names["configuration"] == "sfr.yaml"
    assert names["truth_file"] == "station.csv"
    assert names["calibration"] == "camchain.yaml"
    assert all(len(item["sha256"]) == 64 for item in inputs.values())
    facts = dict(run_facts(from_json(done.out, "score")))
    assert facts["Truth"].endswith("station.csv")
    assert [Path(name).name for name in facts["Read as"].split(", ")] == ["sfr.yaml", "camchain.yaml"]
    assert len(poses) == COUNT


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935\nsize 12345\n"


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag", "x.tum", "x.csv", "drive"])
def test_a_pointer_of_git_lfs_is_named(tmp_path: Path, sfr: Sfr, name: str) -> None:
    place, words = tmp_path / name, ["convert", tmp_path / name, tmp_path / "out.csv"]
    if name == "drive":
        images(place, "ns")
        next((place / "left").iterdir()).write_text(POINTER)
        (tmp_path / "c.yaml").write_text(kalibr("TUM-VI", *CHAINS["T_imu_cam"]))
        words = ["info", place, "--calibration", tmp_path / "c.yaml"]
    else:
        place.write_text(POINTER)
    done = sfr(*words)
    assert done.code in (1, 2)
    assert "git lfs pull replaces" in " ".join((done.out + done.err).split())


@pytest.mark.parametrize("ending", [".ply", ".pcd", ".npz"])
def test_a_pointer_to_a_cloud_is_named(tmp_path: Path, ending: str) -> None:
    (tmp_path / f"x{ending}").write_text(POINTER)
    with pytest.raises(InputError, match="git lfs pull replaces"):
        load_cloud(tmp_path / f"x{ending}")


LISTS = {"sfr": "pairs.csv", "euroc": "mav0/cam1/data.csv"}


@pytest.mark.parametrize("unit_ns", [1_000, 1_000_000])
@pytest.mark.parametrize("layout", LISTS)
def test_a_list_of_images_in_another_unit_than_nanoseconds_is_refused(
    tmp_path: Path, layout: str, unit_ns: int
) -> None:
    options = ConvertOptions() if layout == "sfr" else ConvertOptions(layout=Layout(layout))
    convert(open_source(write_folder(tmp_path / "made", make_world(), nav=False)), tmp_path / "x", options)
    table = tmp_path / "x" / LISTS[layout]
    header, *lines = table.read_text().splitlines()
    parts = [line.partition(",") for line in lines]
    base = 1_700_000_000_000_000_000
    stamps = [(base + 100_000_000 * k) // unit_ns for k in range(len(parts))]
    table.write_text("\n".join([header, *(f"{s},{names}" for s, (_, _, names) in zip(stamps, parts, strict=True))]))
    with pytest.raises(InputError, match="their unit is probably larger than stated"):
        open_source(tmp_path / "x")


@pytest.mark.parametrize("name", ["{}.jpg", "0000{}.png"])
def test_images_of_kitti_with_other_names_are_named(tmp_path: Path, name: str) -> None:
    convert(
        open_source(write_folder(tmp_path / "made", make_world(), nav=False)),
        tmp_path / "x",
        ConvertOptions(layout=Layout.KITTI),
    )
    for image in (tmp_path / "x").rglob("*.png"):
        image.rename(image.with_name(name.format(image.stem)))
    with pytest.raises(InputError, match=r"names like '000000\.png'"):
        open_source(tmp_path / "x")


def test_one_image_for_both_sides_of_a_pair_is_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "x", make_world(), nav=False)
    table = folder / "pairs.csv"
    table.write_text(table.read_text().replace("right/000001.png", "left/000001.png"))
    with pytest.raises(InputError, match=r"left/000001.png' as the left and the right image of one pair"):
        open_source(folder)


def test_the_truth_of_a_folder_in_another_format_is_named_as_such(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "x", make_world(), nav=False)
    for text in ("t,x,y,z\n1,2,3,4\n", "1.5 2 3 4 0 0 0 1\n", ""):
        (folder / "groundtruth.csv").write_text(text)
        with pytest.raises(InputError, match="the header of the truth of a data set folder"):
            open_source(folder)


@pytest.mark.parametrize("layout", ["sfr", "kitti", "euroc"])
def test_images_that_a_list_does_not_name_are_reported(
    tmp_path: Path, layout: str, caplog: pytest.LogCaptureFixture
) -> None:
    options = ConvertOptions() if layout == "sfr" else ConvertOptions(layout=Layout(layout))
    convert(open_source(write_folder(tmp_path / "made", make_world(), nav=False)), tmp_path / "x", options)
    caplog.clear()
    open_source(tmp_path / "x")
    assert "unlisted" not in caplog.text
    image = next(file for file in sorted((tmp_path / "x").rglob("*.png")))
    image.with_name("999999.png").write_bytes(image.read_bytes())
    image.with_name("._999999.png").write_bytes(b"hidden")
    open_source(tmp_path / "x")
    assert "unlisted images ignored: 1, the first: " in caplog.text


def test_missing_pairs_of_euroc_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    """A left image that the list of the right camera does not answer precedes a pair whose file is missing."""
    world = make_world(count=6)
    convert(
        open_source(write_folder(tmp_path / "made", world, nav=False)),
        tmp_path / "x",
        ConvertOptions(layout=Layout.EUROC),
    )
    right = tmp_path / "x" / "mav0" / "cam1"
    header, *lines = (right / "data.csv").read_text().splitlines()
    del lines[1]
    (right / "data.csv").write_text("\n".join([header, *lines]))
    stamps_ns = [pair.stamp_ns for pair in world.pairs]
    (right / "data" / f"{stamps_ns[3]}.png").unlink()
    assert open_source(tmp_path / "x").missing_loc_ns == (stamps_ns[1], stamps_ns[3])
