"""From a stereo pair to a disparity image, its standard deviation and its valid pixels."""
