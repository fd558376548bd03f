"""The place of a stereo rig on the rover follows from the frames that drivers of cameras publish."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.node_scenes import DRIVERS, OPTICAL
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.source_config import ExtrinsicsConfig
from sfr_loc_map.nodes.localisation.extrinsics import Extrinsics
from sfr_loc_map.ros.static_transforms import add_static_transforms


def tf(parent: str, child: str, xyz: tuple[float, float, float], q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> object:
    """Return what a tf2_msgs/TFMessage with one transform has."""
    names = ("x", "y", "z", "w")
    transform = SimpleNamespace(
        translation=SimpleNamespace(**dict(zip(names, xyz, strict=False))),
        rotation=SimpleNamespace(**dict(zip(names, q, strict=True))),
    )
    item = SimpleNamespace(header=SimpleNamespace(frame_id=parent), child_frame_id=child, transform=transform)
    return SimpleNamespace(transforms=[item])


@pytest.mark.parametrize("driver", DRIVERS)
def test_extrinsics_follow_from_the_frames_of_drivers(driver: str) -> None:
    said: list[str] = []
    extrinsics = Extrinsics(ExtrinsicsConfig(), "", "locsb")
    chain = ("base_footprint", "base_link", "mast", *DRIVERS[driver])
    for parent, child in pairwise(chain):
        extrinsics.search(chain[-1], 0.12, said.append)
        assert extrinsics.T_rb_sb is None
        turn = OPTICAL if child == chain[-1] else (0.0, 0.0, 0.0, 1.0)
        xyz = (0.1, 0.06, 0.5) if child == "mast" else (0.0, 0.0, 0.0)
        add_static_transforms(tf(parent, child, xyz, turn), extrinsics._tree)
    extrinsics.search(chain[-1], 0.12, said.append)
    assert [text.partition(";")[0] for text in said] == [
        f"extrinsics of the stereo rig from /tf_static: base_link to {chain[-1]}"
    ]
    assert extrinsics.T_rb_sb is not None
    np.testing.assert_allclose(extrinsics.T_rb_sb.translation, (0.1, 0.0, 0.5), atol=1e-12)  # half a baseline right
    np.testing.assert_allclose(extrinsics.T_rb_sb.rotation, np.eye(3), atol=1e-12)
    assert Transform.from_quat((0, 0, 0), OPTICAL).rotation == pytest.approx(OPTICAL_IN_BODY)


def test_slashes_before_the_names_of_frames_are_ignored() -> None:
    extrinsics = Extrinsics(ExtrinsicsConfig(), "/base_link", "locsb")
    add_static_transforms(tf("/base_link", "/camera_optical", (0.1, 0.0, 0.5), OPTICAL), extrinsics._tree)
    extrinsics.search("camera_optical", 0.12, lambda _: None)
    assert extrinsics.T_rb_sb is not None
