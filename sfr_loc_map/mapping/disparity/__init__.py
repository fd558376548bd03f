"""From a stereo pair to a disparity image, its standard deviation and its valid pixels.

A `disparity_map` is a `DisparityMap`. `disparity_px` is an image of disparities alone, which kernels and their
arguments call `disparity`. A hole is a set of invalid pixels, and to fill means to make them valid (`hole_filling`).
Pixels that the semi-global matching has rejected are unmatched.
"""
