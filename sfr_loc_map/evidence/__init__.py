"""Evidence from a recording without ground truth: agreement of runs that should agree.

`recording.check_recording` checks the drive and the maps of a source:

    source ─┬─ drive ── check.check_drive ──┬── RecordingCheck ── cli.check, check_tables
            └─ maps ─── overlap.check_maps ─┘

`check_drive` runs the localiser several times over the drive and compares the runs:

- runs: `localiser_runs` runs the localiser forward, backward, over every second pair, and with the landmarks of one
  half of the image. `paired_runs` restricts two runs to their common pairs.
- comparisons: `agreement` compares two runs over sub-trajectories, and `revisited` compares the accumulated motion with
  a direct run between two visits of a place.
- `calibration` estimates the rotation of the right camera from the runs.
- further figures: `predicted` (error by source) and `other_estimates` (wheel odometry, other methods).

Each of these modules returns its figures as rows of the table of figures. `check_result` derives the results from these
rows and from the advice for the calibration file. `check_file` reads the JSON of a check for a test report, and derives
the results again by the same function. `kinds` lists the kinds of evidence, with the statistic of each, what it shows
and what it hides.
"""
