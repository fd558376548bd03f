"""From a stereo pair to measurements: pyramids, corners, patches and the pose that fits them."""
