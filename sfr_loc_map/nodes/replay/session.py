"""Replays a source through the running nodes: start them, play, collect their results, end them."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from sfr_loc_map import signals
from sfr_loc_map.errors import InputError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io.bag import message_stream
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.metrics.completeness import MISSING_SHARE
from sfr_loc_map.nodes.input.extrinsics import publish_extrinsics
from sfr_loc_map.nodes.launch.processes import Supervisor, user_command
from sfr_loc_map.nodes.replay.collector import ResultCollector
from sfr_loc_map.nodes.replay.external import ExternalNode, external_node
from sfr_loc_map.nodes.replay.graph_node import ReplayNode
from sfr_loc_map.nodes.replay.options import ReplayOptions, node_arguments
from sfr_loc_map.nodes.replay.pacing import PairTracker
from sfr_loc_map.nodes.replay.player import Player
from sfr_loc_map.nodes.replay.received import Received
from sfr_loc_map.nodes.ros import environment
from sfr_loc_map.runs.offline import check_count
from sfr_loc_map.topics import RECTIFIED, Role, names

Say = Callable[[str], None]


class ReplaySession:
    """The running nodes of a replay, ready to receive; made by `running`."""

    def __init__(
        self,
        source: Source,
        options: ReplayOptions,
        node: ReplayNode,
        player: Player,
        collector: ResultCollector,
        external: ExternalNode | None,
    ) -> None:
        self.node, self.player = node, player
        self._source, self._options, self._collector, self._external = source, options, collector, external

    @property
    def received(self) -> Received:
        """What the nodes have published so far."""
        return self._collector.received

    def play(self, progress: Callable[[str], None]) -> None:
        """Publish the source until its end or until the player is stopped, then wait for the missing results.

        `progress` is called with the rig of each pair that was played.
        """
        options, pairs, collector, external = (self._options, PairTracker(), self._collector, self._external)
        if options.start is not None:
            self.player.set_pose(options.start)

        def published(message: message_stream.Message) -> None:
            sent_s = time.monotonic()
            for rig, stamp_ns in pairs.add(message):
                collector.received.published.add((rig, stamp_ns))
                if external is not None and rig == external.options.task.rig:
                    external.published(stamp_ns, sent_s)
                if options.rate > 0.0:
                    self.node.supervisor.check()
                    if external is not None:
                        external.look_after()
                else:
                    collector.wait_for_pair(rig, stamp_ns)
                progress(rig)

        messages = message_stream.messages_of(self._source)
        end_s = options.offset_s + options.duration_s
        with checked_clock():
            self.player.play(message_stream.between(messages, options.offset_s, end_s), published)
            collector.finish()
        if external is not None:
            collector.received.external = external.observe()


@contextmanager
def running(source: Source, options: ReplayOptions, say: Say) -> Iterator[ReplaySession]:
    """Start the nodes of a replay as processes of their own, and end them with the `with` block."""
    check_source(source, options.offset_s)
    environment.isolate()
    environment.prepare()
    topics = message_stream.topics_of(source)
    if options.external is not None:  # whoever is on the domain may listen: the score has the truth from the source
        topics = {name: kind for name, kind in topics.items() if name not in names(Role.TRUTH)}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sfr-replay-")))
        os.environ.setdefault("ROS_LOG_DIR", str(folder / "log"))
        supervisor = stack.enter_context(Supervisor(folder))
        for node_name, arguments in node_arguments(source, options, folder).items():
            supervisor.start(node_name, arguments)
        command = None
        if options.external is not None and options.external.command:
            command = stack.enter_context(user_command(options.external.command, folder))
        node = stack.enter_context(ReplayNode(supervisor))
        external = None if options.external is None else external_node(node, source, options.external, command)
        player = Player(node, topics, options.rate, paused=options.paused)
        collector = ResultCollector(node, 0 if source.nav is None else len(source.nav), external)
        if source.loc is not None and source.loc.rig.T_rb_sb is not None:
            publish_extrinsics(node.node, source.loc.rig.T_rb_sb)
        say("waiting for the nodes")
        if options.page is not None and not node.wait_for_page(options.page):
            say("the page is not connected yet: what is played before is missing there")
        player.wait_until_ready()
        if external is not None:
            rig = f"{external.options.task.rig}/"
            external.wait_until_ready([name for name in topics if name.startswith(rig) and RECTIFIED in name])
        yield ReplaySession(source, options, node, player, collector, external)


def replay(source: Source, options: ReplayOptions, progress: Callable[[str], None], say: Say) -> tuple[Received, bool]:
    """Replay a source through the nodes; return what they published, and whether a signal ended it early."""
    with running(source, options, say) as session:
        with signals.stopping(session.player.stop) as interrupted:
            say(f"plays from {options.offset_s:g} s")
            session.play(progress)
            was_interrupted = interrupted()
            signals.hold()  # what was played is there to be scored
        received = session.received
        if options.page is not None:
            session.node.call("monitor_node/finish", "monitor_node did not publish its figures")
            images = 0 if source.loc is None else len(source.loc)
            posed = len({stamp_ns for stamp_ns, _, _ in received.rows})
            whole = images - posed <= MISSING_SHARE * images
            options.page.run_is_over(missing="" if whole else "not every image of the source has a pose")
        return received, was_interrupted


def check_source(source: Source, offset_s: float = 0.0) -> None:
    """Check what would fail late."""
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
