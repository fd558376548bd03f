"""Compiles the kernels of a part before they are needed, as `make demo` does beside the installation.

    python -m sfr_loc_map.pipeline.compile_kernels localisation mapping metrics

Each part takes up to a minute of one core the first time, a few seconds to load later. Parts may be compiled in
processes side by side. Nothing has to be compiled in advance: a node does it when it starts.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

from sfr_loc_map.errors import ConfigError


def _localisation() -> None:
    from sfr_loc_map.localisation.localiser import Localiser

    Localiser.warm_up()


def _mapping() -> None:
    from sfr_loc_map.geometry.stereo import StereoRig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.mapping.mapper import Mapper
    from sfr_loc_map.mapping.terrain import grid

    Mapper(StereoRig(320, 240, 300.0, 300.0, 159.5, 119.5, 0.1), MappingConfig()).warm_up()
    grid.warm_up()


def _metrics() -> None:
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.pipeline.online.monitor_score import warm_up

    warm_up(ScoreConfig())


PARTS: Mapping[str, Callable[[], None]] = {"localisation": _localisation, "mapping": _mapping, "metrics": _metrics}


def compile_kernels(parts: list[str]) -> None:
    """Compile the kernels of parts, or load those that are compiled.

    Args:
        parts: Of `localisation`, `mapping`, `metrics`.

    Raises:
        ConfigError: If another part is named.
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise ConfigError(f"no kernels of '{unknown[0]}': give some of {', '.join(PARTS)}")
    for part in parts:
        PARTS[part]()


if __name__ == "__main__":
    compile_kernels(sys.argv[1:])
