"""Sources of images: what `sfr.open` gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.api.notebook import facts_html
from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.api.trajectory import Trajectory
from sfr_loc_map.io import registry, sequence


@dataclass(frozen=True, slots=True, repr=False)
class Source(sequence.Source):
    """An opened data set folder, ROS bag, KITTI or EuRoC sequence.

    `source.loc` is the drive and `source.nav` the mapping pairs, None where the source has none: `len(source.loc)`,
    `source.loc.rig`, `for pair in source.loc.pairs()`.
    """

    @property
    def truth(self) -> Trajectory | None:
        """True poses of RB in DS, None where the source has none."""
        found = None if self.loc is None else self.loc.ground_truth
        return None if found is None or not len(found) else Trajectory.of(found)

    def __repr__(self) -> str:
        """Return path, format and what there is."""
        return f"Source({str(self.path)!r}, {', '.join(self._facts())})"

    def _repr_html_(self) -> str:
        return facts_html("Source", {"path": str(self.path), "holds": ", ".join(self._facts())})

    def _facts(self) -> list[str]:
        facts = [self.format]
        if self.loc is not None:
            facts.append(f"{len(self.loc)} localisation pairs")
            facts.append("with truth" if self.truth is not None else "without truth")
        if self.nav is not None:
            facts.append(f"{len(self.nav)} mapping pairs")
        return facts


def open(source: PathLike | sequence.Source, remap: Mapping[str, str] | None = None) -> Source:
    """Open a source: the format is detected.

    Args:
        source: A data set folder, ROS bag, KITTI or EuRoC sequence.
        remap: Topics of a bag under other names: `{"/cam0/image": "loc/left/image_rect"}`.

    Raises:
        InputError: If there is nothing, nothing that is known, or it is broken.
    """
    if isinstance(source, Source):
        return source
    found = source if isinstance(source, sequence.Source) else registry.open_source(Path(source), remap)
    return Source(found.path, found.format, found.loc, found.nav, found.left_out)
