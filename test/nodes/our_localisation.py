"""A localisation node of your own, without copied code."""

from geometry_msgs.msg import PointStamped

from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.runner import run


class OurLocalisation(LocalisationNode):
    """Also publishes the position alone, and answers where it is."""

    def setup(self) -> None:
        """Create one more publisher."""
        super().setup()
        self._position = self.endpoints.add_publisher(PointStamped, "our/position", 10)
        self._last: PoseEstimate | None = None

    def subscribe(self) -> None:
        """Offer one more service."""
        super().subscribe()
        self.add_service("~/where", self._where)

    def publish_estimate(self, estimate: PoseEstimate) -> None:
        """Publish as usual, and the position; called in the worker's thread, in the order of the pairs."""
        super().publish_estimate(estimate)
        if estimate.state is TrackingState.LOST:
            return
        self._last = estimate
        message = PointStamped()
        message.header.frame_id = self.config.ds_frame
        message.point.x, message.point.y, message.point.z = estimate.T_ds_rb.translation.tolist()
        self._position.publish(message)

    def _where(self) -> str:
        """Answer after the pairs that wait."""
        return "nowhere yet" if self._last is None else f"at {self._last.T_ds_rb.translation.round(3).tolist()}"


def main() -> int:
    """Run the node."""
    return run(OurLocalisation)


if __name__ == "__main__":
    raise SystemExit(main())
