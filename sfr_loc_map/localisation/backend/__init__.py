"""Joint estimate of keyframes and landmarks: sliding window, bundle adjustment and online calibration."""
