"""What is expected of each subject, and how much of it is judged, missing or wrong.

    1. count     expected_items, drive (gaps), copies, trajectory.{other_frames, standing} ─► rows of completeness
    2. compare   rows, SHORTFALLS (shortfall_kinds), limits ─► judging.incomplete ─► shortfalls with their scope
    3. apply     shortfalls, SUBJECTS (figures.subjects) ─► judging.judge ─► a pass of a limit becomes incomplete

1. `drive` counts the expected, judged, missing and extra items of a drive, with the `gaps` between its estimates, and
   `expected_items` those of every other subject. `copies` counts poses that are not measurements.
2. `shortfall_kinds` is the table of everything that can be missing or wrong: the largest complete value of each row,
   and the limits that replace it.
3. A shortfall affects the limits on its scope (the drive, the map, or the calls of one kind).
"""
