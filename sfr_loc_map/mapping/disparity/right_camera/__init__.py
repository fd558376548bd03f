"""The deviation of the right camera from a rectified camera with the exposure of the left camera.

right_image_correction    removes the exposure and the vertical disparity from the right image
rotation                  measures the rotation of the camera that explains the vertical disparity
vertical_disparity        fits a polynomial to the vertical disparity, for both
"""
