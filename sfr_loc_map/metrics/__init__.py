"""The metrics of the specification: errors, time and memory.

What is imported here is light: the score as a value, its JSON, conditions and limits. The functions that compute scores
stand in `trajectory_score`, `cloud_error`, `resource_score` and `build`.
"""

from sfr_loc_map.metrics.condition import Condition, ConditionKind
from sfr_loc_map.metrics.modes import AssociationMode, CallKind, CloudKind, Rebase, VerdictState
from sfr_loc_map.metrics.score import MapScore, MemoryScore, Provenance, Score, TimingScore, TrajectoryScore, Verdict
from sfr_loc_map.metrics.score_json import from_dict, from_json, to_dict, to_json

__all__ = [
    "AssociationMode",
    "CallKind",
    "CloudKind",
    "Condition",
    "ConditionKind",
    "MapScore",
    "MemoryScore",
    "Provenance",
    "Rebase",
    "Score",
    "TimingScore",
    "TrajectoryScore",
    "Verdict",
    "VerdictState",
    "from_dict",
    "from_json",
    "to_dict",
    "to_json",
]
