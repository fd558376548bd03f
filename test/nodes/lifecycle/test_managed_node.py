"""The states of a managed node, its live parameters, its queue and its quality of service."""

# ruff: noqa: E402 - ROS may be absent
import json
import math
import time
from pathlib import Path
from signal import SIGINT, SIGTERM

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from lifecycle_msgs.msg import Transition
from made_scene import LOC_RIG, loc_pair, true_pose
from nav_msgs.msg import Odometry
from peers import Capture, LocalNode, Manager
from processes import Peer, Process, node_process, wait_until
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scenes import MOUNT, calls, send_infos, send_pair
from sensor_msgs.msg import Image
from std_msgs.msg import String

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.nodes.diagnostics import Level, values_of
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.messages.pose import odometry_row
from sfr_loc_map.nodes.monitor_node import MonitorNode
from sfr_loc_map.nodes.stereo_input import ReceivedPair

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
)


@pytest.mark.slow
def test_a_node_goes_through_its_states_and_receives_only_when_active(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "autostart:=false"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, Manager() as peer:
        assert peer.state() == "unconfigured"
        assert peer.change(ACTIVATE) == (False, "unconfigured")  # there is no such step from here
        assert peer.node.count_publishers("localisation/odometry") == 0
        assert values_of(peer.well(Level.OK, "unconfigured"))["lifecycle"] == "unconfigured"
        assert peer.change(CONFIGURE) == (True, "inactive")
        peer.until(lambda: peer.node.count_publishers("localisation/odometry") == 1, "the publisher")
        assert peer.node.count_subscribers("loc/left/image_rect") == 0
        assert peer.change(ACTIVATE) == (True, "active")
        assert peer.change(CONFIGURE) == (False, "active")
        send_infos(peer, "loc", LOC_RIG)
        first = peer.play(0), peer.play(1)
        assert peer.change(DEACTIVATE) == (True, "inactive")
        peer.until(lambda: peer.node.count_subscribers("loc/left/image_rect") == 0, "no listener")
        assert not peer.call("localisation_node/reset").success
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(2)  # goes on where it was: no start at the origin
        localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
        expected = [tuple(localiser.process(loc_pair(index)).T_ds_rb.translation) for index in range(3)]
        assert [*first, odometry_row(peer.odometry[-1])[1]] == expected
        assert peer.change(DEACTIVATE) == (True, "inactive")
        assert peer.change(CLEANUP) == (True, "unconfigured")
        peer.until(lambda: peer.node.count_publishers("localisation/odometry") == 0, "no publisher")
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(3) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)  # nothing is left of before
        assert peer.change(Transition.TRANSITION_ACTIVE_SHUTDOWN) == (True, "finalized")
        assert node.end(SIGTERM) == 0
        assert "Traceback" not in node.text


def test_a_transition_that_fails_is_named_and_can_be_tried_again(ros: None, capfd: Capture, tmp_path: Path) -> None:
    limits, precious = tmp_path / "limits.yaml", tmp_path / "thesis"
    (precious / "chapter").mkdir(parents=True)
    arguments = ["--ros-args", "-p", "autostart:=false", "-p", f"limits_file:={limits}"]
    arguments += ["-p", f"save_file:={precious}", "-p", "save_period_s:=1.0"]
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as node:
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "configure failed: cannot read" in node.text
        peer.well(Level.ERROR, "configure failed: cannot read")
        limits.write_text("timing:\n  localisation_p95_s: 1.0\n", encoding="utf-8")
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "a folder that is not empty is there" in node.text
        assert (precious / "chapter").is_dir()
        (precious / "chapter").rmdir()
        precious.rmdir()
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")


def test_parameters_change_live_as_a_whole_or_not_at_all(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, "--ros-args", *MOUNT):
        configurations = peer.listen(String, "localisation/configuration", latched=True)
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        ok, reason = peer.set(localisation__max_features=300, localisation__min_tracked=7)
        assert not ok
        assert "min_tracked" in reason
        for absurd in (
            {"localisation__motion__max_speed_m_s": 1e300},
            {"localisation__motion__max_turn_rad_s": math.inf},
        ):
            ok, reason = peer.set(**absurd)
            assert not ok
            assert "range" in reason
        ok, reason = peer.set(queue_size=7)
        assert (ok, "read-only" in reason) == (False, True)
        assert peer.set(localisation__max_features=300, localisation__min_tracked=20) == (True, "")

        def adopted() -> bool:
            values = json.loads(configurations[-1].data)
            return (values["localisation.max_features"], values["localisation.min_tracked"]) == (300, 20)

        peer.until(adopted, "the configuration")
        before = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        assert peer.play(2) == pytest.approx(at, abs=1e-12)  # restarts at its last pose
        step = np.linalg.norm(true_pose(1).translation - true_pose(0).translation)
        after = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        # which it knows no better than before, and the rover has gone on by a step meanwhile
        assert np.linalg.eigvalsh(after - before - 0.8 * np.diag([step**2] * 3 + [0] * 3)).min() > -1e-12
        localiser = Localiser(LOC_RIG, LocalisationConfig(max_features=300, min_tracked=20), Transform.identity())
        features = [localiser.process(loc_pair(index)).statistics.features for index in (2, 3)]
        peer.play(3)
        found = [float(values_of(status)["statistic.features"]) for status in calls(peer.diagnostics)[-2:]]
        assert found == features


def test_what_comes_too_fast_is_dropped_by_the_rule_and_counted(ros: None, capfd: Capture) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "overload:=newest_first", "-p", "input.queue_depth:=100"]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments):
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        for index in range(1, 21):  # nobody receives meanwhile
            send_pair(peer, "loc", loc_pair(index))
        last = str(loc_pair(20).stamp_ns)
        peer.until(lambda: values_of(calls(peer.diagnostics)[-1])["stamp_ns"] == last, "the newest pair")
        stamps = [int(values_of(status)["stamp_ns"]) for status in calls(peer.diagnostics)]
        assert stamps == sorted(stamps)
        values = values_of(calls(peer.diagnostics)[-1])
        dropped = int(values["dropped_overload"])
        lost = int(values["dropped_in_transport"]) + int(values["dropped_unpaired"])
        assert dropped > 0
        assert dropped + lost / 2 == 21 - len(stamps)
        peer.well(Level.WARN, "dropped_overload")


SUBCLASS = """
import sys
import time
from sfr_loc_map.nodes.stereo_input import ReceivedPair
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.runner import run

class Slow(LocalisationNode):
    def _process(self, received):
        print("works", flush=True)
        time.sleep(2.0)
        super()._process(received)

sys.exit(run(lambda: Slow("slow_node")))
"""


def slow_node(folder: Path) -> Process:
    script = folder / "slow.py"
    script.write_text(SUBCLASS, encoding="utf-8")
    return Process(folder / "slow.log", str(script), "--ros-args", *MOUNT)


@pytest.mark.slow
def test_the_node_answers_while_a_pair_is_worked_on(ros: None, tmp_path: Path) -> None:
    with slow_node(tmp_path) as node, Manager("slow_node") as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.state()  # the service is known now
        send_pair(peer, "loc", loc_pair(0))
        send_pair(peer, "loc", loc_pair(1))
        node.wait_for("works")
        begin = time.monotonic()
        assert peer.state() == "active"
        assert peer.set(localisation__max_features=300) == (True, "")
        assert time.monotonic() - begin < 1.0
        assert not peer.odometry
        # what is under way is finished and published, what waits is not begun
        assert peer.change(DEACTIVATE) == (True, "inactive")
        peer.until(lambda: peer.odometry, "the result of the pair under way")
        peer.spin(0.3)
        assert len(peer.odometry) == 1
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        send_pair(peer, "loc", loc_pair(2))
        wait_until(lambda: node.text.count("works") == 2, "work again")
        assert node.end(SIGINT, SIGTERM, SIGINT) == 0
        assert "Traceback" not in node.text


class FailsAtThird(LocalisationNode):
    """Has a fault at its third pair."""

    pairs = 0

    def _process(self, received: ReceivedPair) -> None:
        self.pairs += 1
        assert self.pairs != 3, "a third"
        super()._process(received)


def test_a_fault_that_was_not_foreseen_is_reported_and_survived(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, FailsAtThird, "--ros-args", *MOUNT) as node:
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        send_pair(peer, "loc", loc_pair(2))
        peer.well(Level.ERROR, "internal fault, localisation restarts: AssertionError: a third")
        assert "Traceback" in node.text
        assert peer.play(3) == pytest.approx(at, abs=1e-12)
        values = values_of(calls(peer.diagnostics)[-1])
        assert int(values["dropped_rejected"]) == 1


def test_quality_of_service_that_does_not_fit_is_named(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, "--ros-args", *MOUNT) as node:
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        node.wait_for("a publisher of /loc/left/image_rect offers less RELIABILITY than this node requests")
        peer.well(Level.WARN, "/loc/left/image_rect offers less RELIABILITY")
    arguments = ["--ros-args", *MOUNT, "-p", "input.reliability:=best_effort", "-p", "output_reliability:=best_effort"]
    with Peer() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments) as node:
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        peer.listen(Odometry, "localisation/odometry")
        node.wait_for("a subscriber of /localisation/odometry requests more RELIABILITY than this node offers")
        assert "offers less" not in node.text
