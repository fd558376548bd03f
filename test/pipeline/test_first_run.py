"""The first run on a machine, which compiles, gives the same bits as all later ones, which load what was compiled."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENES = Path(__file__).parents[1] / "scenes"
RUN = """
import hashlib
from made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair, true_pose
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper

digest = hashlib.sha256()
localiser = Localiser(LOC_RIG, LocalisationConfig(window_keyframes=3), true_pose(0))
for index in range(0, 12, 3):
    estimate = localiser.process(loc_pair(index))
    digest.update(estimate.T_ds_rb.matrix.tobytes() + estimate.covariance.tobytes())
    assert estimate.state.value != "lost"
assert localiser.last_result is not None
item = nav_pair(0)
points = Mapper(NAV_RIG, MappingConfig()).process(item.pair, item.T_lm_navsb, 0)
digest.update(points.cloud.xyz.tobytes() + points.cloud.sigma.tobytes())
assert len(points.cloud.xyz) > 1000
print(digest.hexdigest())
"""


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_run_that_compiles_gives_the_bits_of_one_that_loads(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(SCENES)}
    results = [
        subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=False)
        for _ in range(2)
    ]
    assert [result.returncode for result in results] == [0, 0], results[0].stderr + results[1].stderr
    assert any(tmp_path.rglob("*.nbi"))
    assert results[0].stdout == results[1].stdout != ""
