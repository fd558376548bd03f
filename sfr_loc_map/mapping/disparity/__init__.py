"""Estimation of the disparity image of a stereo pair, its standard deviation and its valid pixels.

In names, `disparity_map` is a `DisparityMap`, and `disparity_px` is an image of disparities, which kernels call
`disparity`. A hole is a region of invalid pixels. Filling a hole makes its pixels valid (`hole_filling`). Pixels that
the semi-global matching rejects are called unmatched.
"""
