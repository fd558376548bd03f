"""Replays a source through the running nodes: start them, play, collect their results, end them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sfr_loc_map.errors import InputError, MappingError
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.command_process import CommandProcess
from sfr_loc_map.nodes.process.live_process import LivePage
from sfr_loc_map.nodes.process.supervisor import Supervisor, first_signal_stops, sigterm_as_interrupt
from sfr_loc_map.nodes.replay.external_node import external_node
from sfr_loc_map.nodes.replay.options import ReplayOptions, node_arguments, pairs_per_map
from sfr_loc_map.nodes.replay.player import Player
from sfr_loc_map.nodes.replay.replay_node import ReplayNode
from sfr_loc_map.nodes.replay.result_collector import ResultCollector
from sfr_loc_map.nodes.replay.results import ReplayResults
from sfr_loc_map.nodes.replay.static_frames import publish_extrinsics
from sfr_loc_map.pipeline.controls import HELP, Controls, Keyboard
from sfr_loc_map.pipeline.message_stream import POINTS_TOPIC, end_of, messages_of, start_at, topics_of

AGAIN = "plays again from"
"""Beginning of the line that announces another run."""


def replay(
    source: Source, options: ReplayOptions, progress: Callable[[str], None], say: Callable[[str], None]
) -> ReplayResults:
    """Replay a source through the nodes as processes of their own.

    Args:
        source: An opened source.
        options: Options of the replay.
        progress: Called with `loc` or `nav` for each stereo pair published.
        say: Called with what is being done.

    Returns:
        What the nodes have published in the last run that was played to its end, without one in the last that has a
        result. The first SIGINT or SIGTERM while it plays ends it as the operator's key does.

    Raises:
        InputError: If the source is broken, or a node refuses its input.
        MappingError: If there are more mapping pairs than a map may have.
        NodeError: If a node ends or does not answer.
    """
    end_s = check_source(source, options.offset_s)
    environment.isolate()
    environment.prepare()
    topics = topics_of(source, options.remap)
    with tempfile.TemporaryDirectory(prefix="sfr-replay-") as name:
        folder = Path(name)
        os.environ.setdefault("ROS_LOG_DIR", str(folder / "log"))
        with sigterm_as_interrupt(), Supervisor(folder) as supervisor:
            for node_name, arguments in node_arguments(source, options, folder).items():
                supervisor.start(node_name, arguments)
            with Keyboard() as keyboard, _command(options, folder) as command, ReplayNode(supervisor) as node:
                external = external_node(node, source, options.external, command)
                collector = ResultCollector(node, external)
                controls = Controls(rate=options.rate, paused=options.paused, loop=options.loop, end_s=end_s)
                player = Player(node, collector, topics, controls, keyboard)
                if source.loc is not None and source.loc.rig.T_rb_sb is not None:
                    publish_extrinsics(node.node, source.loc.rig.T_rb_sb)
                _wait_until_ready(options.page, node, player, say)
                if keyboard.is_there:
                    say(HELP)
                with first_signal_stops(controls.stop) as interrupted:
                    _play(source, options, player, progress, say)
                    say("collecting")
                    results = collector.finish(pairs_per_map(source), has_map_truth=POINTS_TOPIC in topics)
                    results.interrupted = interrupted()
                if external is not None:
                    external.observe(results)
                if options.page is not None:
                    options.page.run_is_over()
                return results


def _wait_until_ready(page: LivePage | None, node: ReplayNode, player: Player, say: Callable[[str], None]) -> None:
    """Wait for the page, where there is one, and for the nodes."""
    say("waiting for the nodes")
    if page is not None and not node.wait_for_page(page):
        say("the page is not connected yet: what is played before is missing there")
    player.wait_until_ready()
    node.supervisor.note_segments()


@contextmanager
def _command(options: ReplayOptions, folder: Path) -> Iterator[CommandProcess | None]:
    """Run the command of an external node, where there is one."""
    if options.external is None or not options.external.command:
        yield None
        return
    with CommandProcess(options.external.command, folder) as process:
        yield process


def _play(
    source: Source,
    options: ReplayOptions,
    player: Player,
    progress: Callable[[str], None],
    say: Callable[[str], None],
) -> None:
    """Play one run after the other, as the controls want."""
    controls = player.controls
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
        player.collector.results.whole = not controls.interrupted
        at_end = controls.seek_s is None
        offset_s, announcement = controls.next_start_s(), AGAIN
        if offset_s is not None:
            maps = len(player.collector.results.published_stamps("nav")) // max(pairs_per_map(source), 1)
            player.collector.settle(maps if at_end else 0)


def check_source(source: Source, offset_s: float = 0.0) -> float:
    """Check what would fail late; return the position of the last pair, seconds.

    Args:
        source: An opened source.
        offset_s: Where it shall start.

    Raises:
        InputError: If the source has no pairs, none after the offset, or the extrinsics of its cameras are not known.
        MappingError: If it has more mapping pairs than a map may have.
    """
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
