"""Replay a source through the nodes: start the nodes, play, collect the results, end the nodes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map import signals
from sfr_loc_map.errors import InputError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io import message_stream
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live.page_process import shown_on
from sfr_loc_map.replay.arguments_by_node import arguments_by_node, pairs_per_map
from sfr_loc_map.replay.collector import ResultCollector
from sfr_loc_map.replay.external import external_node
from sfr_loc_map.replay.options import ReplayOptions
from sfr_loc_map.replay.player import Player
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.processes import ChildProcess, Supervisor, user_command
from sfr_loc_map.ros.static_transforms import publish_extrinsics
from sfr_loc_map.runs.offline import check_count
from sfr_loc_map.topics import Role, names

Say = Callable[[str], None]
Progress = Callable[[str], None]


class Participants(NamedTuple):
    """Player and collector of a replay, and the ROS node through which both communicate with the started nodes."""

    peer: ReplayPeer
    player: Player
    collector: ResultCollector


def replay(source: Source, options: ReplayOptions, results: ReceivedResults, *, progress: Progress, say: Say) -> bool:
    """Replay a source through the nodes, and add what they publish to `results`.

    Returns whether a signal ended the replay early. After an error, `results` contains what was received until then.
    `progress` is called with the rig of each played pair.
    """
    check_source(source, options.offset_s)
    with shown_on(options.page), started_participants(source, options, results, say) as participants:
        with signals.stopping(participants.player.stop) as interrupted:
            say(f"playing from {options.offset_s:g} s")
            play_and_collect(source, options, participants, progress)
            was_interrupted = interrupted()
            signals.hold()  # the played part is still scored
        if options.page is not None:
            options.page.run_is_over()
        return was_interrupted


def play_and_collect(source: Source, options: ReplayOptions, participants: Participants, progress: Progress) -> None:
    """Publish a source until its end or until the player is stopped, then wait for the missing results."""
    _, player, collector = participants
    pairs = message_stream.PairTracker(message_stream.parts_of_pairs(source))
    if options.start is not None:
        player.set_pose(options.start)

    def on_sent(message: message_stream.Message) -> None:
        sent_s = time.monotonic()
        completed = pairs.add(message)
        if completed is not None:
            rig, stamp_ns = completed
            collector.note_sent(rig, stamp_ns, sent_s)
            progress(rig)

    messages = message_stream.messages_of(source)
    end_s = options.offset_s + options.duration_s
    try:
        with checked_clock():
            player.play(message_stream.between(messages, options.offset_s, end_s), on_sent)
            collector.finish()
    finally:
        collector.close()


@contextmanager
def started_participants(
    source: Source, options: ReplayOptions, results: ReceivedResults, say: Say
) -> Iterator[Participants]:
    """Start the nodes of a replay, create player and collector, and wait until all communicate with each other.

    The processes are ended after the `with` block.
    """
    environment.isolate()
    environment.prepare()
    topics = message_stream.topics_of(source)
    # An external node must not receive the ground truth. The score reads the ground truth from the source.
    if options.external is not None:
        topics = {name: kind for name, kind in topics.items() if name not in names(Role.TRUTH)}
    with ExitStack() as stack:
        supervisor, command = stack.enter_context(_started_processes(source, options))
        peer = stack.enter_context(ReplayPeer(supervisor))
        external = external_node(peer, source, options.external, command, results)
        player = Player(peer, topics, options.rate, paused=options.paused)
        is_lock_step = options.rate <= 0.0
        count = pairs_per_map(source)
        collector = ResultCollector(peer, results, external, pairs_per_map=count, is_lock_step=is_lock_step)
        if source.loc is not None and source.loc.rig.T_rb_sb is not None:
            publish_extrinsics(peer.ros_node, source.loc.rig.T_rb_sb)
        say("waiting for the nodes")
        if options.page is not None and not peer.wait_for_page(options.page):
            say("the page is not connected yet: the start of the replay will be missing there")
        player.wait_until_ready()
        if external is not None:
            external.wait_until_ready(topics)
        yield Participants(peer, player, collector)


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
    end_s = message_stream.end_of(source)
    if offset_s > end_s:
        raise InputError(f"the last pair is at {end_s:.3f} s: an offset of {offset_s:g} s leaves no pair")
