"""What the localiser saw in a pair: tracks, masks and the image drawn of them, each only while somebody subscribes."""

from __future__ import annotations

from sensor_msgs.msg import Image, PointCloud2

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import draw_tracks
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.image import image_msg
from sfr_loc_map.nodes.messages.tracks import mask_msg, tracks_msg

DEPTH = 2


class TrackPublisher:
    """Publishes tracks; used in the worker's thread."""

    def __init__(self, endpoints: Endpoints) -> None:
        """Create the publishers."""
        self._tracks = endpoints.add_publisher(PointCloud2, "localisation/tracks", DEPTH)
        self._masks = [endpoints.add_publisher(Image, f"localisation/{side}_mask", DEPTH) for side in SIDES]
        self._image = endpoints.add_publisher(Image, "localisation/debug_image", DEPTH)

    def publish(self, pair: StereoPair, localiser: Localiser, estimate: PoseEstimate, frame_id: str) -> None:
        """Publish what there is of a pair that was just processed; of a side without a mask none, tracks last."""
        for publisher, mask in zip(self._masks, localiser.masks, strict=True):
            if mask is not None and publisher.get_subscription_count():
                publisher.publish(mask_msg(mask, header_msg(pair.stamp_ns, frame_id)))
        if self._tracks.get_subscription_count():
            self._tracks.publish(tracks_msg(localiser.last_result, header_msg(pair.stamp_ns, frame_id)))
        if self._image.get_subscription_count():
            image = draw_tracks(pair.left, localiser.last_result, estimate)
            self._image.publish(image_msg(image, header_msg(pair.stamp_ns, frame_id)))
