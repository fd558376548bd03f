"""What would stop the suite on a bag or on a running graph, each with its cure."""
