"""Replay a source through the nodes: start the nodes, play, collect the results, end the nodes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map import signals
from sfr_loc_map.errors import InputError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io.message_stream import Message, messages_of, topics_of
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live.page_process import PageProcess, shown_on
from sfr_loc_map.replay.arguments_by_node import arguments_by_node, pairs_per_map
from sfr_loc_map.replay.collector import ResultCollector
from sfr_loc_map.replay.external.answer_converters import answer_converter
from sfr_loc_map.replay.external.external_node import ExternalNode, connected_node
from sfr_loc_map.replay.message_store import Received
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.replay.played_pairs import PairTracker, between, end_of, pair_of_message
from sfr_loc_map.replay.player import Player, connected_player
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.replay.result import ReplayResult
from sfr_loc_map.replay.waiting import AwaitedNode, OurMapper, OurNode, ResultWaits
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.processes import ChildProcess, Supervisor, user_command
from sfr_loc_map.ros.static_transforms import publish_extrinsics
from sfr_loc_map.runs.mapper_run import check_count
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import Role, names

Say = Callable[[str], None]
Progress = Callable[[str], None]


class Connected(NamedTuple):
    """A replay whose nodes and page communicate: its player, the collector of its results, and its waits for them."""

    collector: ResultCollector
    player: Player
    waits: ResultWaits
    external: ExternalNode | None

    def result(self, options: ReplayOptions) -> ReplayResult:
        """Return the results.

        Called while an external node still runs, because its process is measured until this call.
        """
        received = self.collector.received
        external = None
        if self.external is not None and received.external_task is not None:
            external = self.external.result(received.of(received.external_task).version)
        return received.result(external, options.rate, options.changed_settings)


def replay(
    source: Source,
    options: ReplayOptions,
    page: PageProcess | None,
    *,
    progress: Progress,
    say: Say,
    on_results: Callable[[ReplayResult], None],
) -> None:
    """Replay a source through the nodes, and show the replay on a live page unless `page` is None.

    `on_results` is called with the results of the nodes at the end of the replay, also before an error is raised,
    unless the error occurs before the nodes are connected. `progress` is called with the rig of each played pair, and
    `say` with a line about each step. InputError if the source cannot be replayed.
    """
    check_source(source, options.offset_s)
    with shown_on(page), connected_replay(source, options, say, page) as connected:
        was_interrupted = False
        try:
            with signals.stopping(connected.player.stop) as interrupted:
                say(f"playing from {options.offset_s:g} s")
                play_and_collect(source, options, connected, progress)
                was_interrupted = interrupted()
                signals.hold()  # the played part is still scored
        finally:
            on_results(replace(connected.result(options), was_interrupted=was_interrupted))
        if page is not None:
            page.played()


def play_and_collect(source: Source, options: ReplayOptions, connected: Connected, progress: Progress) -> None:
    """Publish a source until its end or until the player is stopped, then wait for the missing results."""
    player, waits, received = connected.player, connected.waits, connected.collector.received
    pairs = PairTracker(pair_of_message(source))
    if options.start is not None:
        player.set_pose(options.start)

    def on_sent(message: Message) -> None:
        sent_s = time.monotonic()
        completed = pairs.add(message)
        if completed is not None:
            rig, stamp_ns = completed
            task = Task.of_rig(rig)
            received.add_pair(task, stamp_ns)
            waits.after_pair(task, stamp_ns, sent_s)
            progress(rig)

    messages = messages_of(source)
    end_s = options.offset_s + options.duration_s
    with checked_clock():
        player.play(between(messages, options.offset_s, end_s), on_sent)
        waits.finish()


@contextmanager
def connected_replay(
    source: Source, options: ReplayOptions, say: Say, page: PageProcess | None = None
) -> Iterator[Connected]:
    """Start the nodes of a replay, and yield the replay once all nodes and the page communicate with each other.

    The processes are ended after the `with` block.
    """
    environment.isolate()
    environment.prepare()
    with _started_processes(source, options) as (supervisor, command), ReplayPeer(supervisor) as peer:
        # The nodes discover endpoints in the order of their creation: first those that receive the results, and the
        # publishers of converted answers and of the extrinsics; last those of the player.
        received = Received.without_messages(options.external_task)
        collector = ResultCollector(peer, received)
        converter = None if options.external is None else answer_converter(peer, source, options.external, received)
        if source.loc is not None and source.loc.rig.T_rb_sb is not None:
            publish_extrinsics(peer.ros_node, source.loc.rig.T_rb_sb)
        say("waiting for the nodes")
        if page is not None and not peer.wait_for_page(page):
            say("the page does not receive all messages yet: the start of the replay may be missing on the page")
        topics = topics_of(source)
        if options.external is not None:
            # An external node must not receive the ground truth. The score reads the ground truth from the source.
            topics = {name: kind for name, kind in topics.items() if name not in names(Role.TRUTH)}
        player = connected_player(peer, topics, options.rate, paused=options.paused)
        nodes: dict[Task, AwaitedNode] = {
            Task.LOCALISATION: OurNode(Task.LOCALISATION, collector),
            Task.MAPPING: OurMapper(Task.MAPPING, collector, pairs_per_map(source)),
        }
        external = None
        if options.external is not None and converter is not None:
            external = connected_node(peer, options.external, command, converter, topics)
            nodes[options.external.task] = external
        yield Connected(collector, player, ResultWaits(collector, nodes, options.rate is None), external)


@contextmanager
def _started_processes(source: Source, options: ReplayOptions) -> Iterator[tuple[Supervisor, ChildProcess | None]]:
    """Start each node of the suite as a process, and the command of an external node if given."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sfr-replay-")))
        if "ROS_LOG_DIR" not in os.environ:
            os.environ["ROS_LOG_DIR"] = str(folder / "log")
            stack.callback(os.environ.pop, "ROS_LOG_DIR", None)
        supervisor = stack.enter_context(Supervisor(folder))
        for node_name, arguments in arguments_by_node(source, options, folder).items():
            supervisor.start(node_name, arguments)
        command = None
        if options.external is not None and options.external.command:
            command = stack.enter_context(user_command(options.external.command, folder))
        yield supervisor, command


def check_source(source: Source, offset_s: float = 0.0) -> None:
    """Check a source before the start of the nodes; raise an InputError if the replay would fail later."""
    if source.loc is not None and source.loc.rig.T_rb_sb is None:
        raise InputError(
            f"'{source.path}' has no extrinsics of the stereo rig on the rover (T_rb_locsb): give them in "
            f"sfr.yaml (sfr init DIR --from SRC), in rig.json, or on /tf_static of the bag"
        )
    if source.nav is not None:
        check_count(source.nav)
    if source.loc is not None and not len(source.loc):
        raise InputError(f"'{source.path}' has no stereo pair: at least one is required")
    end_s = end_of(source)
    if offset_s > end_s:
        raise InputError(f"the last pair is at {end_s:.3f} s: an offset of {offset_s:g} s leaves no pair")
