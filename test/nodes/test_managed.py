"""The nodes as managed nodes over DDS: states, live parameters, overload, health, quality of service, time."""

# ruff: noqa: E402 - ROS may be absent
import json
import time
from pathlib import Path
from signal import SIGCONT, SIGINT, SIGSTOP, SIGTERM
from typing import Any

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from made_scene import LOC_RIG, PERIOD_NS, loc_pair, true_pose
from nav_msgs.msg import Odometry
from processes import Process, ReferenceMethod, node_process, wait_until
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scenes import MOUNT, calls, problems, raw, send_infos, send_pair
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import draw_tracks
from sfr_loc_map.nodes.diagnostics.key_values import Level, level_of, values_of
from sfr_loc_map.nodes.input.odometry_buffer import OdometryBuffer
from sfr_loc_map.nodes.messages.fields import header_msg, time_msg
from sfr_loc_map.nodes.messages.pose import odometry_row

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
)


CONFIG = Path(__file__).resolve().parents[2] / "config"
OTHER_FRAME = Transform.from_quat([7.0, -2.0, 1.0], [0.0, 0.0, 0.6, 0.8])


class Manager(ReferenceMethod):
    """A peer that drives one node."""

    def __init__(self, node: str = "localisation_node") -> None:
        super().__init__()
        self.name = node
        self.diagnostics = self.listen(DiagnosticArray, "/diagnostics")
        self.odometry = self.listen(Odometry, "localisation/odometry")

    def ask(self, kind: type[Any], service: str, request: Any) -> Any:
        client = self.node.create_client(kind, f"{self.name}/{service}")
        self.until(client.service_is_ready, f"service {service}")
        future = client.call_async(request)
        self.until(future.done, f"answer of {service}")
        return future.result()

    def change(self, transition: int) -> tuple[bool, str]:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.ask(ChangeState, "change_state", request).success, self.state()

    def state(self) -> str:
        return str(self.ask(GetState, "get_state", GetState.Request()).current_state.label)

    def set(self, **values: float | int) -> tuple[bool, str]:
        parameters = []
        for name, value in values.items():
            kind = ParameterType.PARAMETER_DOUBLE if isinstance(value, float) else ParameterType.PARAMETER_INTEGER
            field = "double_value" if isinstance(value, float) else "integer_value"
            parameters.append(
                Parameter(name=name.replace("__", "."), value=ParameterValue(type=kind, **{field: value}))
            )
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self.ask(SetParametersAtomically, "set_parameters_atomically", request).result
        return result.successful, result.reason

    def play(self, index: int, shift_ns: int = 0) -> tuple[float, ...]:
        """Send a pair and return the position that comes back; wait for what the call says of itself, too."""
        count = len(self.odometry)
        pair = loc_pair(index)
        stamp_ns = pair.stamp_ns + shift_ns
        told = len(calls(self.diagnostics))
        send_pair(self, "loc", StereoPair(stamp_ns, pair.left, pair.right))
        self.until(lambda: len(self.odometry) > count and len(calls(self.diagnostics)) > told, "odometry")
        return odometry_row(self.odometry[-1])[1]

    def health(self) -> list[DiagnosticStatus]:
        return [s for array in self.diagnostics for s in array.status if s.name == f"{self.name}: health"]

    def well(self, level: Level, words: str = "") -> DiagnosticStatus:
        def found() -> DiagnosticStatus | None:
            last = self.health()[-1:]
            return last[0] if last and level_of(last[0]) is level and words in last[0].message else None

        return self.until(found, f"health {level.name} '{words}'")


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


def test_a_transition_that_fails_is_named_and_can_be_tried_again(ros: None, tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    arguments = ["--ros-args", "-p", "autostart:=false", "-p", f"limits_file:={limits}"]
    with node_process(tmp_path, "monitor_node", *arguments) as node, Manager("monitor_node") as peer:
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "configure failed: cannot read" in node.text
        peer.well(Level.ERROR, "configure failed: cannot read")
        limits.write_text("timing:\n  localisation_p95_s: 1.0\n", encoding="utf-8")
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")
        assert node.end(SIGINT) == 0


def test_parameters_change_live_as_a_whole_or_not_at_all(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        configurations = peer.listen(String, "localisation/configuration", latched=True)
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        ok, reason = peer.set(localisation__max_features=300, localisation__keyframe_share=7.0)
        assert not ok
        assert "keyframe_share" in reason
        ok, reason = peer.set(queue_size=7)
        assert (ok, "read-only" in reason) == (False, True)
        assert peer.set(localisation__max_features=300, localisation__keyframe_share=0.5) == (True, "")

        def adopted() -> bool:
            values = json.loads(configurations[-1].data)
            return (values["localisation.max_features"], values["localisation.keyframe_share"]) == (300, 0.5)

        peer.until(adopted, "the configuration")
        before = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        assert peer.play(2) == pytest.approx(at, abs=1e-12)  # starts anew at its last pose
        step = np.linalg.norm(true_pose(1).translation - true_pose(0).translation)
        after = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        # which it knows no better than before, and the rover has gone on by a step meanwhile
        assert np.linalg.eigvalsh(after - before - 0.8 * np.diag([step**2] * 3 + [0] * 3)).min() > -1e-12
        localiser = Localiser(LOC_RIG, LocalisationConfig(max_features=300, keyframe_share=0.5), Transform.identity())
        features = [localiser.process(loc_pair(index)).statistics.features for index in (2, 3)]
        peer.play(3)
        found = [float(values_of(status)["statistic.features"]) for status in calls(peer.diagnostics)[-2:]]
        assert found == features


def test_what_comes_too_fast_is_dropped_by_the_rule_and_counted(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "overload:=newest_first", "-p", "input.queue_depth:=100"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, Manager() as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        node.popen.send_signal(SIGSTOP)
        for index in range(1, 21):
            send_pair(peer, "loc", loc_pair(index))
        peer.spin(0.3)
        node.popen.send_signal(SIGCONT)
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
import sys, time
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.process.runner import run

class Odd(LocalisationNode):
    def _process(self, received):
        self.seen = getattr(self, "seen", 0) + 1
        {before}
        super()._process(received)

sys.exit(run(lambda: Odd("odd_node")))
"""


def odd_node(folder: Path, before: str) -> Process:
    script = folder / "odd.py"
    script.write_text(SUBCLASS.format(before=before), encoding="utf-8")
    return Process(folder / "odd.log", str(script), "--ros-args", *MOUNT)


def test_the_node_answers_while_a_pair_is_worked_on(ros: None, tmp_path: Path) -> None:
    with odd_node(tmp_path, "print('works', flush=True); time.sleep(2.0)") as node, Manager("odd_node") as peer:
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


def test_a_fault_that_no_one_foresaw_is_told_and_survived(ros: None, tmp_path: Path) -> None:
    with odd_node(tmp_path, "assert self.seen != 3, 'a third'") as node, Manager("odd_node") as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        send_pair(peer, "loc", loc_pair(2))
        peer.well(Level.ERROR, "internal fault, localisation restarts: AssertionError: a third")
        assert "Traceback" in node.text
        assert peer.play(3) == pytest.approx(at, abs=1e-12)
        values = values_of(calls(peer.diagnostics)[-1])
        assert int(values["dropped_rejected"]) == 1
        assert node.end(SIGINT) == 0


def test_wheel_odometry_tells_where_to_look(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "motion_prior.wait_s:=0.5"]
    prior = OdometryBuffer(10**9)
    localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
    with node_process(tmp_path, "localisation_node", *arguments) as node, Manager() as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        # the subscription takes best effort: what is sent before it knows the publisher does not come
        early = bag_messages.odometry(loc_pair(0).stamp_ns - 10**10, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        early.child_frame_id = "rb"
        peer.publish(Odometry, "motion_prior", raw(early))
        peer.spin(1.0)
        expected, sent = [], []
        for index, ahead in ((0, 0), (1, 0), (2, -1), (12, 1)):
            pair = loc_pair(index)
            # in a frame of its own; before, at and after the stamp of the pair
            for moment in range(len(sent), index + 1 + ahead):
                pose = OTHER_FRAME @ true_pose(moment)
                message = bag_messages.odometry(loc_pair(moment).stamp_ns, pose.translation, pose.quat_xyzw)
                message.child_frame_id = "rb"
                sent.append(moment)
                prior.add(loc_pair(moment).stamp_ns, Transform.from_quat(pose.translation, pose.quat_xyzw))
                peer.publish(Odometry, "motion_prior", raw(message), arrival=True)
            before_ns = loc_pair({1: 0, 2: 1, 12: 2}.get(index, 0)).stamp_ns
            motion = prior.between(before_ns, pair.stamp_ns, 0.0) if index else None
            expected.append(tuple(localiser.process(pair, motion).T_ds_rb.translation))
            peer.play(index)
        assert [odometry_row(message)[1] for message in peer.odometry] == expected
        used = ["statistic.motion_prior" in values_of(status) for status in calls(peer.diagnostics)]
        assert used == [False, True, False, True]
        stranger = Odometry(child_frame_id="camera")
        peer.publish(Odometry, "motion_prior", stranger)
        node.wait_for("motion_prior is of 'camera', of 'rb' (parameter rb_frame) is needed; ignored")


def test_two_rovers_in_two_namespaces_do_not_hear_each_other(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", "--params-file", str(CONFIG / "rep105.yaml"), *MOUNT, "-r"]
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    with (
        node_process(folders[0], "localisation_node", *arguments, "__ns:=/rover1") as first,
        node_process(folders[1], "localisation_node", *arguments, "__ns:=/rover2") as second,
        ReferenceMethod() as peer,
    ):
        odometry = [peer.listen(Odometry, f"/rover{number}/localisation/odometry") for number in (1, 2)]
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        plays = ((1, [0, 1, 2, 3]), (2, [10, 11, 12]))
        expected = []
        for node, (number, indices) in zip((first, second), plays, strict=True):
            node.wait_for("listens to")
            send_infos(peer, "loc", LOC_RIG, f"/rover{number}/")
            localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
            expected.append([tuple(localiser.process(loc_pair(i)).T_ds_rb.translation) for i in indices])
        for index in range(4):
            for number, indices in plays:
                if index < len(indices):
                    send_pair(peer, "loc", loc_pair(indices[index]), f"/rover{number}/")
        peer.until(lambda: [len(found) for found in odometry] == [4, 3], "all odometry")
        assert [[odometry_row(message)[1] for message in found] for found in odometry] == expected
        frames = {(m.header.frame_id, m.child_frame_id) for found in odometry for m in found}
        assert frames == {("odom", "base_link")}
        peer.until(lambda: len(calls(diagnostics)) == 7, "all calls")
        names = [status.name for status in calls(diagnostics)]
        assert sorted(names) == ["rover1/localisation_node: call"] * 4 + ["rover2/localisation_node: call"] * 3
        assert [node.end(SIGINT) for node in (first, second)] == [0, 0]


def test_latency_is_measured_where_clocks_can_be_compared(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)  # of the year 2023: its stamp says nothing of latency
        old = values_of(calls(peer.diagnostics)[-1])
        assert "latency_stamp_to_publish_s" not in old
        shift = time.time_ns() - loc_pair(1).stamp_ns
        peer.play(1, shift)
        values = {k: float(v) for k, v in values_of(calls(peer.diagnostics)[-1]).items() if k.startswith("latency_")}
        transport, inside, whole = (
            values[f"latency_{name}_s"] for name in ("transport", "receive_to_publish", "stamp_to_publish")
        )
        took = float(values_of(calls(peer.diagnostics)[-1])["processing_time_s"])
        assert 0.0 < transport < 1.0
        assert took <= inside <= whole + 1e-3
        assert whole < 5.0


def test_health_says_what_is_wrong_and_when_it_is_over(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "health.stale_after_s:=1.0", "-p", "health.window_s:=1.0"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, Manager() as peer:
        node.wait_for("listens to")
        peer.well(Level.STALE, "nothing came for more than 1 s")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        peer.well(Level.WARN, "initialising")
        peer.play(1)
        status = peer.well(Level.OK, "tracking")
        values = values_of(status)
        assert float(values["processed_hz"]) > 0
        assert int(values["resident_memory_bytes"]) > 50e6
        assert float(values["last_processing_time_s"]) > 0
        black = np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)
        send_pair(peer, "loc", StereoPair(loc_pair(2).stamp_ns, black, black))
        peer.well(Level.ERROR, "lost")
        peer.play(3)
        peer.well(Level.OK, "tracking")
        lower = [np.roll(loc_pair(index).right, 1, axis=0) for index in range(4, 7)]
        for index, right in enumerate(lower, 4):
            send_pair(peer, "loc", StereoPair(loc_pair(index).stamp_ns, loc_pair(index).left, right))
        peer.call("localisation_node/reset")
        for index, right in enumerate(lower, 7):
            send_pair(peer, "loc", StereoPair(loc_pair(index).stamp_ns, loc_pair(index - 3).left, right))
        peer.well(Level.WARN, "vertical disparity of more than")
        peer.well(Level.STALE)


def test_quality_of_service_that_does_not_fit_is_named(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        node.wait_for("listens to")
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        node.wait_for("a publisher of /loc/left/image_rect offers less RELIABILITY than this node requests")
        peer.well(Level.WARN, "/loc/left/image_rect offers less RELIABILITY")
    arguments = ["--ros-args", *MOUNT, "-p", "input.reliability:=best_effort", "-p", "output_reliability:=best_effort"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, ReferenceMethod() as peer:
        node.wait_for("listens to")
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        peer.listen(Odometry, "localisation/odometry")
        node.wait_for("a subscriber of /localisation/odometry requests more RELIABILITY than this node offers")
        assert "offers less" not in node.text


def test_another_rig_begins_anew_and_says_so(ros: None, tmp_path: Path) -> None:
    from dataclasses import replace

    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        send_infos(peer, "loc", replace(LOC_RIG, fx=151.0, fy=151.0))
        node.wait_for("camera_info has changed: localisation restarts at its last pose")
        assert peer.play(2) == pytest.approx(at, abs=1e-12)
        assert not [s for array in peer.diagnostics for s in array.status if s.name.endswith(": input")]
        huge = replace(LOC_RIG, width=65_536, height=65_536)
        send_infos(peer, "loc", huge)
        node.wait_for("camera_info of loc says 65536 x 65536: images of up to")
        peer.play(3)  # the rig known stays


def test_a_clock_that_goes_back_begins_a_new_run(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "use_sim_time:=true"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, Manager() as peer:
        node.wait_for("listens to")

        def tick(stamp_ns: int) -> None:
            peer.publish(Clock, "/clock", Clock(clock=time_msg(stamp_ns)), arrival=True)
            peer.spin(0.2)

        begin = loc_pair(0).stamp_ns
        send_infos(peer, "loc", LOC_RIG)
        for index in range(30):
            tick(begin + index * PERIOD_NS) if index % 10 == 0 else None
            peer.play(index) if index < 3 or index > 27 else None
        assert peer.play(30) != pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        tick(begin)
        node.wait_for("the clock has gone back: localisation restarts at its first pose")
        assert peer.play(0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        assert "stamps have gone back" not in node.text  # once is enough
        latency = values_of(calls(peer.diagnostics)[-1])["latency_stamp_to_publish_s"]
        assert float(latency) < 60.0  # by the simulated clock


def test_pictures_that_claim_to_be_huge_do_no_harm(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        before = psutil.Process(node.popen.pid).memory_info().rss
        size = (65_535).to_bytes(4, "big")
        bomb = b"\x89PNG\r\n\x1a\n" + (13).to_bytes(4, "big") + b"IHDR" + size + size + b"\x10\x06\0\0\0" + bytes(64)
        for side in ("left", "right"):
            header = header_msg(loc_pair(0).stamp_ns - 5, "")
            picture = CompressedImage(header=header, format="png", data=bomb)
            peer.publish(CompressedImage, f"loc/{side}/image_rect/compressed", picture)
        peer.until(lambda: any("is 65535 x 65535" in text for text in problems(peer.diagnostics)), "refusal")
        for side in ("left", "right"):
            mosaic = Image(header=header_msg(loc_pair(0).stamp_ns - 3, ""), width=160, height=120, step=160)
            mosaic.encoding, mosaic.data = "bayer_rggb8", bytes(160 * 120)
            peer.publish(Image, f"loc/{side}/image_rect", mosaic)
        peer.until(lambda: any("Bayer mosaics are not supported" in t for t in problems(peer.diagnostics)), "refusal")
        peer.play(0)
        assert psutil.Process(node.popen.pid).memory_info().rss - before < 100e6


def test_the_debug_picture_shows_what_the_localiser_found(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, Manager() as peer:
        node.wait_for("listens to")
        pictures = peer.listen(Image, "localisation/debug_image")
        send_infos(peer, "loc", LOC_RIG)
        localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
        for index in range(3):
            peer.play(index)
            peer.until(lambda count=index: len(pictures) > count, "the debug picture")
            pair = loc_pair(index)
            estimate = localiser.process(pair)
            drawn = draw_tracks(pair.left, localiser.last_result, estimate)
            sent = pictures[-1]
            assert (sent.encoding, sent.step, stamp_of(sent)) == ("bgr8", 3 * sent.width, pair.stamp_ns)
            assert np.array_equal(np.frombuffer(sent.data, np.uint8).reshape(drawn.shape), drawn)
