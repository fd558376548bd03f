"""What the nodes receive with: images to pairs, poses, extrinsics, true poses, and which run a stamp belongs to."""
