"""A stereo pair as it was received, not yet decoded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.io.rectification import StereoRectifier
from sfr_loc_map.nodes.messages.image import grey_from_image
from sfr_loc_map.pipeline.reception import MessageTimes


@dataclass(frozen=True, slots=True)
class ReceivedImage:
    """An image message.

    Attributes:
        message: sensor_msgs/Image or CompressedImage.
        times: When it was sent and received.
    """

    message: Any
    times: MessageTimes


@dataclass(frozen=True, slots=True)
class ReceivedPair:
    """Two image messages of one moment.

    Attributes:
        stamp_ns: Stamp of the left one.
        rig: The rig that took them.
        frame_id: Frame of the left camera by its camera_info.
        left: Left image.
        right: Right image.
        rectifier: What rectifies the images, None where they are rectified.
    """

    stamp_ns: int
    rig: StereoRig
    frame_id: str
    left: ReceivedImage
    right: ReceivedImage
    rectifier: StereoRectifier | None = None

    @property
    def times(self) -> tuple[MessageTimes, MessageTimes]:
        """When they were sent and received."""
        return self.left.times, self.right.times

    def decode(self) -> StereoPair:
        """Return the images in grey, rectified.

        Raises:
            InputError: If one cannot be read.
        """
        images = _grey(self.left.message, self.rig), _grey(self.right.message, self.rig)
        return StereoPair(self.stamp_ns, *(images if self.rectifier is None else self.rectifier.rectify(*images)))


def _grey(message: Any, rig: StereoRig) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage
    try:
        return grey_from_image(message, (rig.width, rig.height))
    except InputError:
        raise
    except Exception as error:  # data from the network: whatever a decoder raises, the node goes on
        raise InputError(f"image of stamp {stamp_of(message)} cannot be read: {error}") from error
