"""The stereo pairs of a node: images to pairs (`stereo_input`), poses of pairs, and what a node waits for."""
