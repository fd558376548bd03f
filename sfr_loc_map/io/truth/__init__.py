"""True poses: their origin, the body to which they refer, and checks of their plausibility."""
