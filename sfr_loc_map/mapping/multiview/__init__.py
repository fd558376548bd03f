"""Fusion of the views of several stereo pairs.

Content that is fixed to the image is removed, poses are registered on request, and points are fused along their rays.
"""
