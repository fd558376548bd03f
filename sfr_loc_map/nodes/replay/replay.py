"""Replays a source through the running nodes: start them, play as an operator wants, collect their results, end them.

The controls are services and parameters named as those of the rosbag2 player: services `~/pause`, `~/resume`,
`~/toggle_paused`, `~/is_paused`, `~/play_next`, `~/stop` (std_srvs/Trigger; the answer gives the position) and
`~/set_loop` (std_srvs/SetBool); parameters `rate` and `seek_s` (continues there).
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

from sfr_loc_map import signals
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.metrics.completeness import MISSING_SHARE
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.extrinsics import publish_extrinsics
from sfr_loc_map.nodes.messages import header_msg, message_type, pose_msg
from sfr_loc_map.nodes.peer import POLL_S
from sfr_loc_map.nodes.processes import Supervisor, user_command
from sfr_loc_map.nodes.replay.collector import ResultCollector
from sfr_loc_map.nodes.replay.external import external_node
from sfr_loc_map.nodes.replay.graph_node import ANSWER_TIMEOUT_S, ReplayNode
from sfr_loc_map.nodes.replay.options import ReplayOptions, node_arguments
from sfr_loc_map.nodes.replay.results import ReplayResults
from sfr_loc_map.pipeline import message_stream
from sfr_loc_map.pipeline.controls import HELP, Controls, Keyboard
from sfr_loc_map.pipeline.offline import check_count

AGAIN = "plays again from"  #: Beginning of the line that announces another run.
START_TIMEOUT_S = 300.0  #: The first start after an installation compiles the kernels.
SETTLE_S = 0.3
SOURCE_DEPTH = 20
SEEK, RATE = "seek_s", "rate"


class Player:
    """Publishes messages as the operator's controls want."""

    def __init__(
        self,
        node: ReplayNode,
        collector: ResultCollector,
        topics: Mapping[str, str],
        controls: Controls,
        keyboard: Keyboard,
    ) -> None:
        """Advertise the topics, given with their types, and the services of the controls."""
        self.collector, self.controls = collector, controls
        self._node, self._keyboard = node, keyboard
        depth = QoSProfile(depth=SOURCE_DEPTH)
        self._publishers = {
            name: node.node.create_publisher(message_type(kind), name, depth) for name, kind in topics.items()
        }
        self._initial_pose = node.node.create_publisher(PoseWithCovarianceStamped, "initialpose", depth)
        self._poses_set: list[PoseWithCovarianceStamped] = []  # acknowledgements of Fast DDS come after up to 3 s
        node.node.create_subscription(
            PoseWithCovarianceStamped, "localisation/initialpose_set", self._poses_set.append, depth
        )
        self._resets = {n: node.node.create_client(Trigger, f"{n}/reset") for n in node.supervisor.processes}
        _offer_controls(node.node, controls)

    def wait_until_ready(self) -> None:
        """Wait until all nodes listen and are connected to this one and to each other."""
        graph = self._node.node

        def ready() -> bool:
            if not all(client.service_is_ready() for client in self._resets.values()):
                return False
            publishers = [*self._publishers.values()]
            if "localisation_node" in self._resets:  # an external node may listen to it in any way
                publishers.append(self._initial_pose)
            return all(p.get_subscription_count() == graph.count_subscribers(p.topic_name) for p in publishers)

        self._node.wait_for(ready, START_TIMEOUT_S, lambda: f"the nodes {', '.join(self._resets)} did not start")
        external = self.collector.external
        if external is not None:
            rig = f"{external.options.task.rig}/"
            images = [name for name in self._publishers if name.startswith(rig) and "image_rect" in name]
            external.wait_until_ready(images)
        self._node.wait_for_connections()

    def set_pose(self, start: StartPose) -> None:
        """Publish the pose at which localisation starts, in its own world frame, and wait until it is received."""
        message = PoseWithCovarianceStamped(header=header_msg(start.stamp_ns or 0, ""))
        message.pose.pose = pose_msg(start.T_ds_rb, start.T_ds_rb.file_quat_xyzw)
        self._poses_set.clear()
        self._initial_pose.publish(message)
        if "localisation_node" not in self._resets:
            return  # an external node may listen to it or not
        problem = "localisation_node did not receive initialpose"
        self._node.wait_for(lambda: bool(self._poses_set), ANSWER_TIMEOUT_S, lambda: problem)

    def reset_nodes(self) -> None:
        """Reset the nodes and the results for another run."""
        for name, client in self._resets.items():
            self._node.call(client, f"{name} did not reset")
        self._node.spin_for(SETTLE_S)  # results on their way
        self.collector.begin_run()

    def play(self, messages: Iterator[message_stream.Message], progress: Callable[[str], None]) -> None:
        """Publish messages until their end or until the controls interrupt; tell the task of each stereo pair."""
        pairs, pacer, collector = message_stream.PairTracker(), message_stream.Pacer(self.controls), self.collector
        for message in messages:
            self._hold(pacer, message)
            if self.controls.interrupted:
                return
            sent_s = time.monotonic()
            self._publishers[message.topic].publish(message.raw)
            for pair in pairs.add(message):
                collector.published(*pair, sent_s)
                if self.controls.rate > 0:
                    self._node.supervisor.check()
                    if collector.external is not None:
                        collector.external.look_after()
                else:
                    collector.wait_for_pair(*pair)
                self.controls.steps = max(self.controls.steps - 1, 0)
                progress(pair[0])

    def _hold(self, pacer: message_stream.Pacer, message: message_stream.Message) -> None:
        while True:
            for key in self._keyboard.pressed():
                self.controls.key(key)
            wait_s = pacer.wait_s(message)
            if self.controls.interrupted or not (wait_s or self.controls.held):
                break
            self._node.spin_for(min(wait_s or POLL_S, POLL_S))
        self._node.executor.spin_once(timeout_sec=0.0)


def _offer_controls(node: Node, controls: Controls) -> None:
    actions: dict[str, Callable[[], None]] = {
        "pause": partial(controls.hold, True),
        "resume": partial(controls.hold, False),
        "toggle_paused": controls.toggle,
        "is_paused": lambda: None,
        "play_next": controls.step,
        "stop": controls.stop,
    }

    def server(name: str, action: Callable[[], None]) -> Callable[..., Trigger.Response]:
        def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            action()
            response.success = controls.paused if name == "is_paused" else True
            response.message = f"{'paused' if controls.paused else 'playing'} at {controls.position_s:.3f} s"
            return response

        return serve

    def set_loop(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        controls.loop = bool(request.data)
        response.success = True
        return response

    def check(changes: list[Parameter]) -> SetParametersResult:
        reason = ""
        for name, value in ((change.name, change.value) for change in changes if change.name in (RATE, SEEK)):
            if not isinstance(value, float) or not 0.0 <= value < math.inf:
                reason = "a number of 0.0 or more is needed"
            elif name == SEEK and value > controls.end_s:
                reason = f"the last pair is at {controls.end_s:.3f} s: nothing is left after it"
        return SetParametersResult(successful=not reason, reason=reason)

    def changed(changes: list[Parameter]) -> None:
        for change in changes:
            if change.name == RATE:
                controls.rate = change.value
            elif change.name == SEEK:
                controls.seek(change.value)

    for name, action in actions.items():
        node.create_service(Trigger, f"~/{name}", server(name, action))
    node.create_service(SetBool, "~/set_loop", set_loop)
    rate_text = "0: lock step; else multiple of the recorded speed."
    node.declare_parameter(RATE, controls.rate, ParameterDescriptor(description=rate_text))
    node.declare_parameter(SEEK, 0.0, ParameterDescriptor(description="Set it to continue there. [s]"))
    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(changed)


def replay(
    source: Source, options: ReplayOptions, progress: Callable[[str], None], say: Callable[[str], None]
) -> ReplayResults:
    """Replay a source through the nodes as processes of their own.

    Returns what they have published in the last run that was played to its end, without one in the last that has a
    result. The first signal while it plays ends it as the operator's key does.
    """
    end_s, external = check_source(source, options.offset_s), options.external
    environment.isolate()
    environment.prepare()
    topics = message_stream.topics_of(source)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sfr-replay-")))
        os.environ.setdefault("ROS_LOG_DIR", str(folder / "log"))
        supervisor = stack.enter_context(Supervisor(folder))
        for node_name, arguments in node_arguments(source, options, folder).items():
            supervisor.start(node_name, arguments)
        keyboard, command = stack.enter_context(Keyboard()), None
        if external is not None and external.command:
            command = stack.enter_context(user_command(external.command, folder))
        node = stack.enter_context(ReplayNode(supervisor))
        other = None if external is None else external_node(node, source, external, command)
        controls = Controls(rate=options.rate, paused=options.paused, loop=options.loop, end_s=end_s)
        pairs_per_map = 0 if source.nav is None else len(source.nav)
        player = Player(node, ResultCollector(node, pairs_per_map, other), topics, controls, keyboard)
        if source.loc is not None and source.loc.rig.T_rb_sb is not None:
            publish_extrinsics(node.node, source.loc.rig.T_rb_sb)
        say("waiting for the nodes")
        if options.page is not None and not node.wait_for_page(options.page):
            say("the page is not connected yet: what is played before is missing there")
        player.wait_until_ready()
        if keyboard.is_there:
            say(HELP)
        with signals.stopping(controls.stop) as interrupted:
            _play(source, options, player, progress, say)
            say("collecting")
            results = player.collector.finish(has_map_truth=message_stream.POINTS_TOPIC in topics)
            results.interrupted = interrupted()
            signals.hold()  # what was played is there to be scored
        if other is not None:
            other.observe(results)
        if options.page is not None:
            images = 0 if source.loc is None else len(source.loc)
            posed = len({stamp_ns for stamp_ns, _, _ in results.rows})
            whole = images - posed <= MISSING_SHARE * images
            options.page.run_is_over(missing="" if whole else "not every image of the source has a pose")
        return results


def _play(
    source: Source, options: ReplayOptions, player: Player, progress: Callable[[str], None], say: Callable[[str], None]
) -> None:
    controls, collector = player.controls, player.collector
    offset_s: float | None = options.offset_s
    announcement = "plays from"
    while offset_s is not None:
        if announcement == AGAIN:
            player.reset_nodes()
        pose = options.start(offset_s) if source.loc is not None else None
        if pose is not None:
            player.set_pose(pose)
        say(f"{announcement} {offset_s:g} s")
        player.play(message_stream.start_at(message_stream.messages_of(source), offset_s, controls.moved_to), progress)
        collector.results.whole = not controls.interrupted
        at_end = controls.seek_s is None
        offset_s, announcement = controls.next_start_s(), AGAIN
        if offset_s is not None:
            collector.settle(collector.whole_maps if at_end else 0)


def check_source(source: Source, offset_s: float = 0.0) -> float:
    """Check what would fail late; return the position of the last pair, seconds."""
    if source.loc is not None and source.loc.rig.T_rb_sb is None:
        raise InputError(
            f"'{source.path}' does not say where the stereo rig is on the rover (T_rb_locsb): give extrinsics in "
            f"sfr.yaml (sfr init DIR --from SRC), in rig.json, or on /tf_static of the bag"
        )
    if source.nav is not None:
        check_count(source.nav)
    if source.loc is not None and not len(source.loc):
        raise InputError(f"'{source.path}' has no stereo pair: at least one is needed")
    end_s = message_stream.end_of(source)
    if offset_s > end_s:
        raise InputError(f"its last pair is at {end_s:.3f} s: an offset of {offset_s:g} s leaves nothing")
    return end_s
