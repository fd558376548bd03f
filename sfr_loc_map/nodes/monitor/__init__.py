"""The parts of the monitor node: the ground truth (`truth_input`), and the output of its score."""
