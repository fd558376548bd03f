"""Cells of the left image that do not move with the ground: they are excluded for a number of pairs."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.ground.cell_change import cell_counts
from sfr_loc_map.localisation.ground.memory import DYNAMIC_LIFE, FIXED_LIFE, ExcludedCells
from sfr_loc_map.localisation.ground.rigid_motion import Exclusion

SHAPE = (128, 160)
NOTHING = np.zeros(cell_counts(SHAPE), np.bool_)


def one_cell() -> Mask:
    """Return one cell of the image."""
    cells = NOTHING.copy()
    cells[3, 4] = True
    return cells


def after(
    excluded: ExcludedCells,
    *,
    fixed: Mask = NOTHING,
    dynamic: Mask = NOTHING,
    stationary: Mask = NOTHING,
    has_excluded: bool = False,
) -> ExcludedCells:
    """Return the excluded cells after a pair."""
    rows = np.zeros(int(has_excluded), np.intp)
    return excluded.after_pair(Exclusion(rows, fixed, dynamic), stationary, SHAPE)


def test_cells_age_also_in_pairs_in_which_no_landmark_is_excluded() -> None:
    excluded = after(ExcludedCells.none(SHAPE), fixed=one_cell())
    assert excluded.life.any()
    assert excluded.mask is None
    for _ in range(FIXED_LIFE):
        excluded = after(excluded)
    assert not excluded.life.any()
    assert after(excluded, has_excluded=True).mask is None


def test_cells_that_are_fixed_do_not_age_while_their_texture_stays() -> None:
    excluded = after(ExcludedCells.none(SHAPE), fixed=one_cell())
    for _ in range(2 * FIXED_LIFE):
        excluded = after(excluded, stationary=one_cell())
    mask = after(excluded, has_excluded=True).mask
    assert mask is not None
    assert mask.any()
    assert not mask.all()


@pytest.mark.parametrize(("is_fixed", "life"), [(True, FIXED_LIFE), (False, DYNAMIC_LIFE)])
def test_the_pair_that_excludes_a_cell_is_the_first_of_its_life(is_fixed: bool, life: int) -> None:
    cells = {"fixed": one_cell()} if is_fixed else {"dynamic": one_cell()}
    excluded = after(ExcludedCells.none(SHAPE), has_excluded=True, **cells)
    masked = 0
    while excluded.mask is not None:
        masked += 1
        assert masked < life
        excluded = after(excluded)
    assert masked == life - 1
