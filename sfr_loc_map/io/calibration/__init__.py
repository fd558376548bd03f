"""Calibrations of a stereo pair, of the suite and of other programs, and the rectification of its images."""
