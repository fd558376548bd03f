"""The conversion of estimates from another convention of poses, and the search for a convention that is not declared.

`pose_convention` converts poses by the settings that a user declares. The other modules diagnose a mismatch:

    estimate, truth ── disagreement ──┬── mismatches ─────┬── convention_diagnosis.diagnose ── Diagnosis
                                      └── offset_search ──┘

`disagreement` defines the compared poses and the disagreement of each sub-trajectory, `mismatches` lists the mismatches
and their corrections, and `offset_search` searches for an offset of the stamps. `convention_diagnosis` defines the rule
by which one mismatch is chosen.
"""
