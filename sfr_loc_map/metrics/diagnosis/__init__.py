"""The search for a convention of poses that is not declared.

    estimate, truth ── compared_poses ──┬── mismatches ─────┬── convention_diagnosis.diagnose ── Diagnosis
                                        └── offset_search ──┘

`compared_poses` associates estimate and truth, `mismatches` lists the mismatches and their corrections, `offset_search`
searches for an offset of the stamps, and `disagreement` measures the disagreement that remains after each correction.
`convention_diagnosis` has the rule by which one mismatch is chosen.
"""
