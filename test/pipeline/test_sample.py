"""The sample bag is what the simulator makes of its scenario."""

from pathlib import Path

import numpy as np

from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.world import LOC, NAV, Plan

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample" / "sample.mcap"


def test_sample_has_the_truth_of_its_scenario() -> None:
    scenario = ROOT / "config" / "simulation" / "sample.yaml"
    plan = Plan.make(build(SimulationConfig, load_yaml(scenario)))
    source = open_source(SAMPLE, {})
    assert source.loc is not None
    assert source.nav is not None
    assert (len(source.loc), len(source.nav)) == (plan.count(LOC), plan.count(NAV))
    truth = source.loc.ground_truth
    assert truth is not None
    expected = plan.trajectory()
    assert np.array_equal(truth.stamps_ns, expected.stamps_ns)
    assert np.allclose(truth.positions, expected.positions, rtol=0, atol=1e-9)
    for frame, pair in enumerate(source.nav.pairs()):
        assert np.allclose(pair.T_lm_navsb.matrix, plan.lm_pose(frame).matrix, rtol=0, atol=1e-9)
        assert pair.truth is not None
        assert np.isfinite(pair.truth[-1]).all()


def test_sample_is_small_enough_to_clone() -> None:
    assert sum(file.stat().st_size for file in SAMPLE.iterdir()) < 20e6
