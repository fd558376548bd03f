"""Validity: the status of each pixel (`pixel_status.judge_pixels`).

Modules in the order of the calls:

    saturation           saturated pixels
    pixel_status         the tests in their order, and the simple tests
      segments           segments that are small, or have no content in common with the right image
      jump_network       pixels beside disparity jumps that have the disparity of the wrong surface
"""
