"""Parameters of the input of stereo images."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.nodes.lifecycle.qos import RELIABILITIES


@dataclass(frozen=True, slots=True)
class StereoInputConfig:
    """How stereo images are received."""

    image_transport: str = param(
        "auto",
        doc="Topics of images: image_rect (raw), image_rect/compressed (compressed), or both (auto); of image_raw "
        "likewise.",
        choices=("raw", "compressed", "auto"),
    )
    rectify: bool = param(
        False,
        doc="Take image_raw instead of image_rect, and rectify it by the D, K, R and P of camera_info: models "
        "plumb_bob, rational_polynomial, equidistant (fisheye).",
    )
    reliability: str = param(
        "best_effort",
        doc="Reliability requested from the publishers of images, camera_info and nav/pose; best_effort matches both "
        "kinds. One subscription alone: qos_overrides.TOPIC.subscription.reliability.",
        choices=RELIABILITIES,
    )
    queue_depth: int = param(
        30, unit="images", doc="Most images that wait on each side; older ones are dropped.", low=1, high=1000
    )
    stamp_tolerance_s: float = param(
        0.0, unit="s", doc="Largest difference between the stamps of left and right; 0: equal.", low=0.0, high=0.5
    )

    @property
    def stamp_tolerance_ns(self) -> int:
        """The tolerance in nanoseconds."""
        return round(self.stamp_tolerance_s * NS_PER_S)
