"""True poses: their origin in files and topics, the body to which they refer, and checks of their plausibility.

`read` decides between the origins of the truth. Every origin gives a `RecordedTruth` (`recorded`), and `conversion`
makes a `geometry.trajectory.Truth` of it: the possible poses (`pose_checks`) as poses of RB. `of_bag` reads the poses
of a topic by `messages`, which nodes also call, or those of a frame on /tf. `geodesy` converts geographic positions.
`names` classifies topics, frames and files by their names. The settings are in `config`.
"""
