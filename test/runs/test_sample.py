"""The sample bag is what the simulator makes of its scenario; its map is that of the truth."""

from dataclasses import replace

import numpy as np
import pytest

from helpers import ROOT
from helpers.hazard_truth import hazard_accuracy
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import panorama_of
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import FusedMap
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.suite_names import Task

SAMPLE = ROOT / "sample" / "sample.mcap"


def test_sample_has_the_truth_of_its_scenario_and_is_small_enough_to_clone() -> None:
    plan = Plan.make(build(SimulationConfig, load_yaml(ROOT / "config" / "simulation" / "sample.yaml")))
    source, expected = open_source(SAMPLE), plan.trajectory()
    assert (len(source.loc), len(source.nav)) == (plan.count(Task.LOCALISATION), plan.count(Task.MAPPING))
    truth = source.loc.ground_truth
    assert np.array_equal(truth.stamps_ns, expected.stamps_ns)
    assert np.allclose(truth.positions, expected.positions, rtol=0, atol=1e-9)
    for frame, pair in enumerate(source.nav.pairs()):
        assert np.allclose(pair.T_lm_navsb.matrix, plan.lm_pose(frame).matrix, rtol=0, atol=1e-9)
        assert np.isfinite(pair.truth[-1]).all()
    assert sum(file.stat().st_size for file in SAMPLE.iterdir()) < 29e6


def mapped(baseline_factor: float) -> FusedMap:
    nav = panorama_of(open_source(SAMPLE))
    mapper = Mapper(replace(nav.rig, baseline_m=baseline_factor * nav.rig.baseline_m), MappingConfig())
    return mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, i) for i, item in enumerate(nav.pairs())])


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_a_wrong_baseline_is_named_where_pairs_overlap(factor: float) -> None:
    assert any("check the baseline" in line for line in mapped(factor).warnings)


@pytest.mark.slow
def test_the_map_has_no_warning_no_points_in_the_sky_and_the_hazards_of_the_truth() -> None:
    truths = [item.truth for item in panorama_of(open_source(SAMPLE)).pairs() if item.truth is not None]
    fused = mapped(1.0)
    assert not fused.warnings
    true = np.stack(truths)[fused.cloud.pair, fused.cloud.v, fused.cloud.u]
    centres = np.stack([pose.translation for pose in fused.poses_lm_left])[fused.cloud.pair]
    near = np.linalg.norm(fused.cloud.xyz - centres, axis=1) < 15.0
    assert np.isfinite(true[near]).all()
    hazard = hazard_accuracy(fused, truths)
    assert (hazard.cells > 3000, hazard.hazards > 100) == (True, True)
    assert min(hazard.precision, hazard.recall) > 0.9
