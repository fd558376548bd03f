"""The stereo pairs of one map to come: mapped one by one, then fused."""

from __future__ import annotations

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import FusedMap, Mapper, PairMap


class MappingSession:
    """Owns the mapper of a node and the pairs mapped so far; to be used by one thread.

    Attributes:
        last_ns: Stamp of the last pair that was mapped.
    """

    def __init__(self, config: MappingConfig) -> None:
        """Start without a rig."""
        self.last_ns = 0
        self._config = config
        self._rig: StereoRig | None = None
        self._mapper: Mapper | None = None
        self._pairs: list[PairMap] = []

    def __len__(self) -> int:
        """Return how many pairs the map to come has."""
        return len(self._pairs)

    def is_other_rig(self, rig: StereoRig) -> bool:
        """Tell whether a rig differs from the present one."""
        return self._rig is not None and not self._rig.same_cameras(rig)

    def set_rig(self, rig: StereoRig) -> None:
        """Start a new map with a rig, unless it is the present one.

        Raises:
            SfrError: If the configuration does not fit the rig: pairs are then refused.
        """
        if self._rig is not None and not self.is_other_rig(rig):
            return
        self.restart()
        self._rig, self._mapper = rig, None
        self._mapper = Mapper(rig, self._config)

    def set_config(self, config: MappingConfig) -> None:
        """Map the next pairs with another configuration; those of the map begun stay as they are."""
        self._config = config
        if self._rig is not None:
            self._mapper = Mapper(self._rig, config)

    def restart(self) -> None:
        """Start a new map."""
        self._pairs.clear()

    @property
    def has_mapper(self) -> bool:
        """Whether rig and configuration are known and fit."""
        return self._mapper is not None

    def map_pair(self, pair: StereoPair, T_lm_sb: Transform) -> PairMap:
        """Map a pair and keep the result for the fusion.

        Raises:
            SfrError: If it cannot be mapped.
        """
        result = self._present_mapper().process(pair, T_lm_sb, len(self._pairs))
        self._pairs.append(result)
        self.last_ns = result.stamp_ns
        return result

    def fuse(self) -> FusedMap:
        """Fuse the pairs and start a new map.

        Raises:
            SfrError: If there are none.
        """
        pairs, self._pairs = self._pairs, []
        return self._present_mapper().fuse(pairs)

    def searched_px(self, rig: StereoRig) -> tuple[float, float]:
        """Return the smallest and the largest disparity that is searched with a rig."""
        product = rig.fx * rig.baseline_m
        return product / self._config.max_range_m, product / self._config.min_range_m

    def _present_mapper(self) -> Mapper:
        if self._mapper is None:
            raise InputError("there is no camera_info yet: publish that of both navigation cameras")
        return self._mapper
