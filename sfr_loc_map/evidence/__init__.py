"""Evidence from a recording alone, without ground truth: runs that should agree, and whether they do."""
