"""True poses: their origin in files and topics, the body to which they refer, and checks of their plausibility."""
