"""The score: the table of figures with the limits by which it is judged, the verdicts, and the caveats."""
