"""The sample bag is what the simulator makes of its scenario."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.config import build, load_yaml
from sfr_loc_map.constants import Task
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.plan import Plan

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample" / "sample.mcap"


def test_sample_has_the_truth_of_its_scenario() -> None:
    scenario = ROOT / "config" / "simulation" / "sample.yaml"
    plan = Plan.make(build(SimulationConfig, load_yaml(scenario)))
    source = open_source(SAMPLE, {})
    assert source.loc is not None
    assert source.nav is not None
    assert (len(source.loc), len(source.nav)) == (plan.count(Task.LOCALISATION), plan.count(Task.MAPPING))
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


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.6, 1.0, 1.4])
def test_a_wrong_baseline_is_named_where_pairs_overlap(factor: float) -> None:
    nav = open_source(SAMPLE, {}).nav
    assert nav is not None
    mapper = Mapper(replace(nav.rig, baseline_m=factor * nav.rig.baseline_m), MappingConfig())
    fused = mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, i) for i, item in enumerate(nav.pairs())])
    assert any("check the baseline" in line for line in fused.warnings) == (factor != 1.0)
