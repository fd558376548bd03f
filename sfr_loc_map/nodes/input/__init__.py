"""What a node receives: stereo pairs, wheel odometry, static transforms."""
