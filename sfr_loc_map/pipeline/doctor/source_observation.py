"""Observes a source of files (data set folder, KITTI, EuRoC) as the messages that it would be played as."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.pipeline.doctor.observation import EXPECTED, MESSAGES_KEPT, Observation, ObservedTopic


def observe_source(path: Path, *, extrinsics_given: bool, progress: Callable[[], None] = lambda: None) -> Observation:
    """Observe a source of files: every image is read.

    Args:
        path: Data set folder, KITTI or EuRoC sequence.
        extrinsics_given: Whether a parameter file has the extrinsics of the stereo rig.
        progress: Called after each pair.
    """
    collector = _Collector()
    subject, broken, in_file, left_out = f"'{path}'", "", False, 0
    try:
        source = open_source(path)
        subject = f"{source.format} source '{path}'"
        in_file = source.loc is not None and source.loc.rig.T_rb_sb is not None
        left_out = source.left_out
        collector.read(source, progress)
    except InputError as error:
        broken = str(error)
    return Observation(
        subject,
        live=False,
        topics=collector.topics,
        extrinsics_given=extrinsics_given,
        extrinsics_in_tf=in_file,
        broken=broken,
        left_out=left_out,
    )


class _Collector:
    """Collects the stamps and the first messages of a source; what was read before an error stays."""

    def __init__(self) -> None:
        self._stamps: dict[str, list[int]] = {}
        self._messages: dict[str, list[Any]] = {}

    def read(self, source: Source, progress: Callable[[], None]) -> None:
        """Read a source.

        Raises:
            InputError: If it is broken.
        """
        if source.loc is not None:
            self._read_drive(source.loc, progress)
        if source.nav is not None:
            self._read_panorama(source.nav, progress)

    @property
    def topics(self) -> dict[str, ObservedTopic]:
        """What was read, by the names of topics."""
        return {
            name: ObservedTopic(
                name, EXPECTED[name], stamps_ns=np.array(stamps, np.int64), messages=tuple(self._messages[name])
            )
            for name, stamps in self._stamps.items()
        }

    def _read_drive(self, drive: LocSequence, progress: Callable[[], None]) -> None:
        self._note_rig("loc", drive.rig)
        truth = drive.ground_truth
        if truth is not None:
            for i, stamp_ns in enumerate(truth.stamps_ns.tolist()):
                pose = (truth.positions[i], truth.quats_xyzw[i])
                self._note("ground_truth/odometry", stamp_ns, bag_messages.odometry, *pose)
        for pair in drive.pairs():
            self._note_pair("loc", pair)
            progress()

    def _read_panorama(self, panorama: NavSequence, progress: Callable[[], None]) -> None:
        self._note_rig("nav", panorama.rig)
        for posed in panorama.pairs():
            stamp_ns = posed.pair.stamp_ns
            self._note_pair("nav", posed.pair)
            self._note("nav/pose", stamp_ns, bag_messages.pose, posed.T_lm_navsb)
            if posed.truth is not None:
                self._stamps.setdefault("ground_truth/points", []).append(stamp_ns)
                self._messages.setdefault("ground_truth/points", [])
            progress()

    def _note_rig(self, task: str, rig: StereoRig) -> None:
        for side in SIDES:
            self._note(f"{task}/{side}/camera_info", 0, bag_messages.camera_info, rig, task, side)

    def _note_pair(self, task: str, pair: StereoPair) -> None:
        for side in SIDES:
            image = getattr(pair, side)
            self._note(f"{task}/{side}/image_rect", pair.stamp_ns, bag_messages.image, image, task, side)

    def _note(self, name: str, stamp_ns: int, make: Callable[..., Any], *values: object) -> None:
        """Note a stamp of a topic, and the message that `make` makes of it and the values while few are kept."""
        self._stamps.setdefault(name, []).append(stamp_ns)
        kept = self._messages.setdefault(name, [])
        if len(kept) < MESSAGES_KEPT:
            kept.append(make(stamp_ns, *values))
