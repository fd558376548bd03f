"""Calibrations of a stereo pair that other programs wrote."""
