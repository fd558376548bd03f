"""The extrinsics of the localisation cameras, from parameters or /tf_static."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from sfr_loc_map.geometry.extrinsics import rig_in_body
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.io.source_config import ExtrinsicsConfig
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.ros.messages import tf_message_type
from sfr_loc_map.ros.qos import TF_STATIC_QOS
from sfr_loc_map.ros.static_transforms import add_static_transforms
from sfr_loc_map.topics import TF_STATIC


class Extrinsics:
    """The extrinsics from the parameters or, if not given there, from /tf_static.

    The extrinsics from /tf_static are used once transforms connect the base frame with the camera frame. Until then,
    `T_rb_sb` is None.
    """

    def __init__(self, config: ExtrinsicsConfig, base_frame: str, sb_frame: str) -> None:
        """Use the parameters and the frame names in /tf_static. An empty base frame means any of `BASE_FRAMES`."""
        self.T_rb_sb = config.transform("T_rb_locsb")
        self._base_frame, self._sb_frame, self._tree = base_frame, sb_frame, FrameTree()

    def subscribe(self, endpoints: Endpoints, say: Callable[[str], object]) -> None:
        """Subscribe to /tf_static if the parameters have no extrinsics; report this through `say`."""
        if self.T_rb_sb is not None:
            return
        kind = tf_message_type()
        if kind is not None:
            add = partial(add_static_transforms, tree=self._tree)
            endpoints.add_subscription(kind, TF_STATIC, add, TF_STATIC_QOS, of_one_publisher=False)
        source = "/tf_static is awaited" if kind else "tf2_msgs for /tf_static is not installed"
        say(f"the extrinsics of the stereo rig (parameters T_rb_locsb) are not given: {source}")

    def search(self, camera_frame: str, baseline_m: float, say: Callable[[str], object]) -> None:
        """Search the received transforms for the frame of the left camera; report found extrinsics through `say`."""
        if self.T_rb_sb is None:
            found = rig_in_body(self._tree, camera_frame, baseline_m, self._base_frame, self._sb_frame)
            if found is not None:
                self.T_rb_sb = found.T_rb_sb
                say(f"extrinsics of the stereo rig from /tf_static: {found.text}")
