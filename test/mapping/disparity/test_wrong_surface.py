"""The network beside jumps belongs to the constants that its features are made with."""

import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.mapping.disparity import wrong_surface


def test_a_network_that_was_trained_with_other_constants_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    load = wrong_surface.edge_network.__wrapped__  # without the cache
    assert load().hidden.shape[1] == len(wrong_surface.EdgeFeatures._fields)
    monkeypatch.setattr(wrong_surface, "SURFACE_RADIUS", wrong_surface.SURFACE_RADIUS + 1)
    with pytest.raises(MappingError, match="SURFACE_RADIUS"):
        load()
