"""Estimation of the disparity map of a stereo pair; `estimation` draws the stages and names the module of each.

In names, `disparity_px` is an image of disparities, which kernels call `disparity`. A hole is a region of invalid
pixels. Filling a hole makes its pixels valid (`hole_filling`). Pixels that the semi-global matching rejects are called
unmatched.

The docstrings of constants refer to measurements/mapper_trials.md, in which each constant is found by its name. That
page defines the real pairs and the five pairs. docs/measurements.md describes the sample and the development panorama.
"""
