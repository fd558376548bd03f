"""The parts of the score as frozen records, and their form in JSON."""
