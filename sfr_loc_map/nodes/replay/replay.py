"""A source through the running nodes: start them, play, record, end them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sfr_loc_map.config import flatten, load_yaml
from sfr_loc_map.errors import InputError, MappingError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.supervisor import Supervisor, sigterm_as_interrupt
from sfr_loc_map.nodes.replay.keyboard import Keyboard
from sfr_loc_map.nodes.replay.player import Player
from sfr_loc_map.nodes.replay.result_collector import Recording
from sfr_loc_map.pipeline.playback.controls import HELP, Controls
from sfr_loc_map.pipeline.playback.messages import begin_at, messages_of, topics_of

AGAIN = "plays again from"
"""Begin of what is said when the nodes begin anew."""
PLAYED = {"autostart": True, "output_reliability": "reliable"}
"""What a replay needs of each node, whatever a parameter file says."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How a source is replayed.

    Attributes:
        localisation: Parameters of the localiser.
        mapping: Parameters of the mapper.
        score: Settings of the monitor's score.
        limits: Limits that the monitor judges by, None for none.
        start: Returns the pose of RB in DS at the first pair after so many seconds; None for the identity.
        rate: 0: each pair's result is awaited; otherwise multiple of the speed of the stamps.
        offset_s: Where it begins, seconds after the first message.
        paused: Whether it waits for the operator before the first pair.
        loop: Whether it begins again at its end, until the operator or a signal ends it.
        remap: New names of topics by the names in the bag.
        parameter_file: ROS parameter file for all nodes; what is set above comes after it.
    """

    localisation: LocalisationConfig
    mapping: MappingConfig
    score: ScoreConfig
    limits: Path | None
    start: Callable[[float], Transform | None]
    rate: float
    offset_s: float
    paused: bool
    loop: bool
    remap: Mapping[str, str]
    parameter_file: Path | None


def replay(
    source: Source, options: ReplayOptions, progress: Callable[[str], None], say: Callable[[str], None]
) -> Recording:
    """Replay a source through the nodes as processes of their own.

    Args:
        source: An opened source.
        options: How.
        progress: Called with `loc` or `nav` for each stereo pair published.
        say: Called with what is being done.

    Returns:
        What the nodes answered.

    Raises:
        InputError: If the source is broken, or a node refuses what is in it.
        MappingError: If there are more mapping pairs than a map may have.
        NodeError: If a node ends or does not answer.
    """
    check(source)
    environment.isolate()
    environment.prepare()
    with tempfile.TemporaryDirectory(prefix="sfr-replay-") as name:
        folder = Path(name)
        os.environ.setdefault("ROS_LOG_DIR", str(folder / "log"))
        with sigterm_as_interrupt(), Supervisor(folder) as supervisor:
            for node, parameters in _parameters(source, options).items():
                supervisor.start(node, _arguments(folder, node, parameters, options.parameter_file))
            controls = Controls(rate=options.rate, paused=options.paused, loop=options.loop)
            with (
                Keyboard() as keyboard,
                Player(supervisor, topics_of(source, options.remap), controls, keyboard) as player,
            ):
                say("waiting for the nodes")
                player.wait_until_ready()
                if keyboard.there:
                    say(HELP)
                _play(source, options, player, progress, say)
                say("collecting")
                player.finish(_pairs_per_map(source))
                return player.recording


def _play(
    source: Source,
    options: ReplayOptions,
    player: Player,
    progress: Callable[[str], None],
    say: Callable[[str], None],
) -> None:
    """Play from one place after the other, as the controls want."""
    controls = player.controls
    offset_s, anew = options.offset_s, False
    while True:
        if anew:
            player.begin_anew()
        start = options.start(offset_s) if source.loc is not None else None
        if start is not None:
            player.set_pose(start)
        say(f"{AGAIN if anew else 'plays from'} {offset_s:g} s")

        def told(position_s: float) -> None:
            controls.position_s = position_s

        player.play(begin_at(messages_of(source, options.remap), offset_s, told), progress)
        jump_s, controls.jump_s = controls.jump_s, None
        if controls.stopped or (jump_s is None and not controls.loop):
            return
        if jump_s is None:
            player.settle()
        offset_s, anew = jump_s or 0.0, True


def check(source: Source) -> None:
    """Check what would fail late.

    Raises:
        InputError: If the source has no pairs or the place of its cameras is not known.
        MappingError: If it has more mapping pairs than a map may have.
    """
    if source.loc is not None and source.loc.rig.T_rb_sb is None:
        raise InputError(
            f"'{source.path}' does not say where the stereo bench is on the rover (T_rb_locsb): add it to rig.json, or "
            f"rb to locsb to /tf_static of the bag"
        )
    if source.nav is not None and not 1 <= len(source.nav) <= MAX_PAIRS:
        raise MappingError(
            f"a map is made of 1 to {MAX_PAIRS} stereo pairs, the source has {len(source.nav)}: split it"
        )
    if source.loc is not None and not len(source.loc):
        raise InputError(f"'{source.path}' has no stereo pair: at least one is needed")


def _pairs_per_map(source: Source) -> int:
    return len(source.nav) if source.nav is not None else 0


def _parameters(source: Source, options: ReplayOptions) -> dict[str, dict[str, Any]]:
    """Return the nodes to start and their parameters."""
    localisation = _changed("localisation", options.localisation)
    mapping = _changed("mapping", options.mapping) | {"pairs_per_map": _pairs_per_map(source) or MAX_PAIRS}
    monitor = _changed("score", options.score)
    if options.limits is not None:
        monitor["limits_file"] = str(options.limits.resolve())
    if source.loc is not None and source.loc.rig.T_rb_sb is not None:
        place = source.loc.rig.T_rb_sb
        localisation["T_rb_locsb.translation_m"] = place.translation.tolist()
        localisation["T_rb_locsb.quat_xyzw"] = place.file_quat_xyzw.tolist()
    nodes = {"localisation_node": localisation, "mapping_node": mapping, "monitor_node": monitor}
    return {name: parameters | PLAYED for name, parameters in nodes.items()}


def _changed(prefix: str, config: Any) -> dict[str, Any]:  # noqa: ANN401 - any configuration dataclass
    """Return the values that are not the defaults by name, so that a parameter file keeps its say on the others."""
    defaults = flatten(type(config)())
    values = {name: value for name, value in flatten(config).items() if value != defaults[name]}
    return {f"{prefix}.{name}": list(v) if isinstance(v, tuple) else v for name, v in values.items()}


def _arguments(folder: Path, node: str, parameters: dict[str, Any], user_file: Path | None) -> list[str]:
    path = folder / f"{node}.yaml"
    content = {f"/**/{node}": {"ros__parameters": parameters}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    arguments = ["--ros-args"]
    for file in (user_file, path):
        arguments += ["--params-file", str(file)] if file is not None else []
    return arguments


def is_ros_parameter_file(path: Path) -> bool:
    """Tell whether a YAML file has the layout of ROS parameter files.

    Raises:
        ConfigError: If it is not YAML.
    """
    return any(isinstance(block, dict) and "ros__parameters" in block for block in load_yaml(path).values())
