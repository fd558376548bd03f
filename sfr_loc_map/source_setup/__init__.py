"""What a source contains, and the files that describe it: an inferred sfr.yaml, initial parameters and limits."""
