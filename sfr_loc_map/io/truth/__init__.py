"""True poses: their origin in files and topics, the body to which they refer, and checks of their plausibility.

`read` decides between the origins of the truth. Every origin gives a `RecordedTruth` (`recorded`), and `conversion`
makes a `geometry.trajectory.Truth` of it: the possible poses (`pose_checks`) as poses of RB. The settings are in
`config`.
"""
