"""Sources of stereo pairs, a module for each layout (a bag is one), and what several layouts share."""
