"""The metrics of the specification: errors, time and memory."""
