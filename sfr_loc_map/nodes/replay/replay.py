"""Replays a source through the running nodes: start them, play, collect their results, end them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from sfr_loc_map.errors import InputError, MappingError
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.extrinsics import publish_extrinsics
from sfr_loc_map.nodes.processes import Supervisor, first_signal_stops, sigterm_as_interrupt, user_command
from sfr_loc_map.nodes.replay.collector import ResultCollector
from sfr_loc_map.nodes.replay.external import external_node
from sfr_loc_map.nodes.replay.graph_node import ReplayNode
from sfr_loc_map.nodes.replay.options import ReplayOptions, node_arguments
from sfr_loc_map.nodes.replay.player import Player
from sfr_loc_map.nodes.replay.results import ReplayResults
from sfr_loc_map.pipeline.controls import HELP, Controls, Keyboard
from sfr_loc_map.pipeline.message_stream import POINTS_TOPIC, end_of, messages_of, start_at, topics_of

AGAIN = "plays again from"  #: Beginning of the line that announces another run.


def replay(
    source: Source, options: ReplayOptions, progress: Callable[[str], None], say: Callable[[str], None]
) -> ReplayResults:
    """Replay a source through the nodes as processes of their own.

    Returns:
        What the nodes have published in the last run that was played to its end, without one in the last that has a
        result. The first SIGINT or SIGTERM while it plays ends it as the operator's key does.

    Raises:
        InputError: If the source is broken, or a node refuses its input.
        MappingError: If there are more mapping pairs than a map may have.
        NodeError: If a node ends or does not answer.
    """
    end_s, external = check_source(source, options.offset_s), options.external
    environment.isolate()
    environment.prepare()
    topics = topics_of(source, options.remap)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sfr-replay-")))
        os.environ.setdefault("ROS_LOG_DIR", str(folder / "log"))
        stack.enter_context(sigterm_as_interrupt())
        supervisor = stack.enter_context(Supervisor(folder))
        for node_name, arguments in node_arguments(source, options, folder).items():
            supervisor.start(node_name, arguments)
        keyboard, command = stack.enter_context(Keyboard()), None
        if external is not None and external.command:
            command = stack.enter_context(user_command(external.command, folder))
        node = stack.enter_context(ReplayNode(supervisor))
        other = None if external is None else external_node(node, source, external, command)
        controls = Controls(rate=options.rate, paused=options.paused, loop=options.loop, end_s=end_s)
        player = Player(node, ResultCollector(node, other), topics, controls, keyboard)
        if source.loc is not None and source.loc.rig.T_rb_sb is not None:
            publish_extrinsics(node.node, source.loc.rig.T_rb_sb)
        say("waiting for the nodes")
        if options.page is not None and not node.wait_for_page(options.page):
            say("the page is not connected yet: what is played before is missing there")
        player.wait_until_ready()
        supervisor.note_segments()
        if keyboard.is_there:
            say(HELP)
        with first_signal_stops(controls.stop) as interrupted:
            _play(source, options, player, progress, say)
            say("collecting")
            results = player.collector.finish(_pairs_per_map(source), has_map_truth=POINTS_TOPIC in topics)
            results.interrupted = interrupted()
        if other is not None:
            other.observe(results)
        if options.page is not None:
            options.page.run_is_over()
        return results


def _pairs_per_map(source: Source) -> int:
    return len(source.nav) if source.nav is not None else 0


def _play(
    source: Source, options: ReplayOptions, player: Player, progress: Callable[[str], None], say: Callable[[str], None]
) -> None:
    """Play one run after the other, as the controls want."""
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
        player.play(start_at(messages_of(source, options.remap), offset_s, controls.moved_to), progress)
        collector.results.whole = not controls.interrupted
        at_end = controls.seek_s is None
        offset_s, announcement = controls.next_start_s(), AGAIN
        if offset_s is not None:
            maps = len(collector.results.published_stamps("nav")) // max(_pairs_per_map(source), 1)
            collector.settle(maps if at_end else 0)


def check_source(source: Source, offset_s: float = 0.0) -> float:
    """Check what would fail late; return the position of the last pair, seconds."""
    if source.loc is not None and source.loc.rig.T_rb_sb is None:
        raise InputError(
            f"'{source.path}' does not say where the stereo rig is on the rover (T_rb_locsb): add it to rig.json, or "
            f"rb to locsb to /tf_static of the bag"
        )
    if source.nav is not None and not 1 <= len(source.nav) <= MAX_PAIRS:
        raise MappingError(
            f"a map is made of 1 to {MAX_PAIRS} stereo pairs, the source has {len(source.nav)}: split it"
        )
    if source.loc is not None and not len(source.loc):
        raise InputError(f"'{source.path}' has no stereo pair: at least one is needed")
    end_s = end_of(source)
    if offset_s > end_s:
        raise InputError(f"its last pair is at {end_s:.3f} s: an offset of {offset_s:g} s leaves nothing")
    return end_s
