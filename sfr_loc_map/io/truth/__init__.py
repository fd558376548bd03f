"""True poses: their origin in files and topics, the body to which they refer, and checks of their plausibility.

`read` decides between the origins of the truth. Recorded poses are a `Trajectory`, or `TrackedPoses` if the source
gives the pose of the body; `TrackedBody.applied` converts them to a `geometry.trajectory.Truth`. `TrackedBody`,
`LiveTruth` and `TruthConfig` are settings.
"""
