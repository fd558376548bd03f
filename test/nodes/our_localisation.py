"""A localisation node of one's own, made without copying."""

from geometry_msgs.msg import PointStamped

from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.process.runner import run


class OurLocalisation(LocalisationNode):
    """Also publishes the place alone, and answers where it is."""

    def make(self) -> None:
        """Advertise one more topic."""
        super().make()
        self._place = self.publish_on(PointStamped, "our/place", 10)
        self._last: PoseEstimate | None = None

    def listen(self) -> None:
        """Offer one more service."""
        super().listen()
        self.offer("~/where", self._where)

    def publish_estimate(self, estimate: PoseEstimate) -> None:
        """Publish as ever, and the place; called in the node's thread, in the order of the pairs."""
        super().publish_estimate(estimate)
        if estimate.state is TrackingState.LOST:
            return
        self._last = estimate
        message = PointStamped()
        message.header.frame_id = self.config.ds_frame
        message.point.x, message.point.y, message.point.z = estimate.T_ds_rb.translation.tolist()
        self._place.publish(message)

    def _where(self) -> str:
        """Answer after the pairs that wait."""
        return "nowhere yet" if self._last is None else f"at {self._last.T_ds_rb.translation.round(3).tolist()}"


def main() -> int:
    """Run the node."""
    return run(OurLocalisation)


if __name__ == "__main__":
    raise SystemExit(main())
