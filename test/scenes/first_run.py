"""Bits of a short run of the localiser and of the mapper.

`make test` runs this once for each where nothing is compiled yet, and keeps the digest with that of the code beside the
environment; the test runs it again, where all is loaded. So nothing is compiled only to be compared.

    python test/scenes/first_run.py localisation|mapping [--keep]
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import sfr_loc_map
from sfr_loc_map.suite.plan import code_fingerprint


def localisation() -> str:
    """Return the digest of poses and covariances of four pairs."""
    from made_scene import LOC_RIG, loc_pair, true_pose

    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.localisation.localiser import Localiser

    Localiser.warm_up()
    digest = hashlib.sha256()
    localiser = Localiser(LOC_RIG, LocalisationConfig(window_keyframes=3), true_pose(0))
    for index in range(0, 12, 3):
        estimate = localiser.process(loc_pair(index))
        digest.update(estimate.T_ds_rb.matrix.tobytes() + estimate.covariance.tobytes())
        assert estimate.state.value != "lost"
    assert localiser.last_result is not None
    return digest.hexdigest()


def mapping() -> str:
    """Return the digest of the cloud of one pair."""
    from made_scene import NAV_RIG, nav_pair

    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.mapping.mapper import Mapper

    mapper = Mapper(NAV_RIG, MappingConfig())
    mapper.warm_up()
    item = nav_pair(0)
    cloud = mapper.process(item.pair, item.T_lm_navsb, 0).cloud
    assert len(cloud.xyz) > 1000
    return hashlib.sha256(cloud.xyz.tobytes() + cloud.sigma.tobytes()).hexdigest()


RUNS = {"localisation": localisation, "mapping": mapping}
KEPT = f"{sys.prefix}/.first_run_{{}}.json"
"""The file that keeps the digest of a compiling run."""


def kept_digest(part: str) -> str | None:
    """Return the digest of the compiling run of this very code, None where none was kept."""
    try:
        found = json.loads(Path(KEPT.format(part)).read_text())
    except FileNotFoundError:
        return None
    return str(found["digest"]) if found["code"] == code_fingerprint() else None


if __name__ == "__main__":
    part, *options = sys.argv[1:]
    compiled_before = any((Path(sfr_loc_map.__file__).parent / part).rglob("*.nbi"))
    digest = RUNS[part]()
    if "--keep" in options and not compiled_before:
        Path(KEPT.format(part)).write_text(json.dumps({"code": code_fingerprint(), "digest": digest}))
    print(digest)
