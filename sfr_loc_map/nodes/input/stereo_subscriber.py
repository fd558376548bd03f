"""The topics of one stereo rig."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import SIDES, Side
from sfr_loc_map.nodes.diagnostics.status_reporter import StatusReporter
from sfr_loc_map.nodes.input.config import StereoInputConfig
from sfr_loc_map.nodes.input.received_pair import ReceivedImage
from sfr_loc_map.nodes.input.stereo_synchronizer import PairHandlers, StereoSynchronizer
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.lifecycle.qos import profile
from sfr_loc_map.nodes.process.environment import EXPORT_LINE
from sfr_loc_map.pipeline.reception import LossWatch, MessageTimes, TransportGaps


class StereoSubscriber:
    """Subscribes to images and camera_info of one rig and hands over its pairs."""

    def __init__(
        self,
        name: str,
        config: StereoInputConfig,
        handlers: PairHandlers,
        endpoints: Endpoints,
        status: StatusReporter,
    ) -> None:
        """Subscribe.

        Args:
            name: First part of the topics, `loc` or `nav`.
            config: How.
            handlers: What is called with pairs and rigs, in the executor's thread.
            endpoints: Of the node.
            status: Of the node; problems are reported there.
        """
        self._status = status
        self._gaps: list[TransportGaps] = []
        self._unprocessed = 0
        self._losses = LossWatch(f"images of '{name}'", EXPORT_LINE, partial(status.warn, kind="transport"))
        self._synchronizer = StereoSynchronizer(name, config, handlers, status.error)
        qos = profile(config.reliability, config.queue_depth)
        topics: list[tuple[str, type[Any]]] = []
        image = "image_raw" if config.rectify else "image_rect"
        if config.image_transport != "compressed":
            topics.append((image, Image))
        if config.image_transport != "raw":
            topics.append((f"{image}/compressed", CompressedImage))
        for side in SIDES:
            on_info = partial(self._synchronizer.add_camera_info, side)
            endpoints.add_subscription(CameraInfo, f"{name}/{side}/camera_info", on_info, qos)
            for topic, kind in topics:
                endpoints.add_subscription(kind, f"{name}/{side}/{topic}", self._image_callback(side), qos)

    @property
    def rig(self) -> StereoRig | None:
        """The rig, None until camera_info of both cameras was received."""
        return self._synchronizer.rig

    def restart(self) -> None:
        """Forget what waits and which stamp was last."""
        self._synchronizer.restart()

    def is_ahead_of(self, now_ns: int) -> bool:
        """Tell whether the last pair lies so far after a moment that the clock must have jumped back since."""
        return self._synchronizer.is_ahead_of(now_ns)

    def count_unprocessed(self) -> None:
        """Count a pair that was handed over but could not be processed."""
        self._unprocessed += 1

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        dropped = self._synchronizer.dropped
        return {
            "dropped_in_transport": sum(gaps.lost for gaps in self._gaps),
            "dropped_unpaired": self._synchronizer.unpaired,
            "dropped_rejected": dropped.rejected + self._unprocessed,
            "dropped_stale": dropped.stale,
            "dropped_without_camera_info": dropped.without_camera_info,
        }

    def _image_callback(self, side: Side) -> Callable[..., None]:
        gaps = TransportGaps()
        self._gaps.append(gaps)

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - Image or CompressedImage
            self._losses.add(gaps.add(info))
            self._status.health.note_arrival()
            self._synchronizer.add_image(side, ReceivedImage(message, MessageTimes.of(info)))

        return received
