"""Estimation of the disparity map of a stereo pair; `estimation` draws the stages and names the module of each.

A disparity, in pixels, is the column in the left image minus the column in the right image. A hole is a region of
invalid pixels. Filling a hole makes its pixels valid (`hole_filling`). Pixels that the semi-global matching rejects are
called unmatched.
"""
