"""Stereo visual localisation: a trajectory from a sequence of stereo pairs."""
