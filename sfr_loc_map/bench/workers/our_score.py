"""Our trajectory score as one command: `python our_score.py ESTIMATE TRUTH RESULT SPACING CONDITION...`."""

import sys
from pathlib import Path

from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.pipeline.scoring import ScoreInputs, score_files


def main() -> None:
    """Read, score, write."""
    estimate, truth, result, spacing, *conditions = sys.argv[1:]
    config = ScoreConfig(TrajectoryScoreConfig(conditions=tuple(conditions), spacing=int(spacing)))
    score = score_files(ScoreInputs.of(Path(estimate), Path(truth)), config)
    Path(result).write_text(to_json(score), encoding="utf-8")


if __name__ == "__main__":
    main()
