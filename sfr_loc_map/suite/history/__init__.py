"""Changes of the figures of a suite from night to night. A night is one run of the suite, in a folder of its own.

    folders ── night.read_nights ──> Night... ── history.find_changes ──> History with each Change
                                                   │ for each figure, its values (job, night)
                                                   └─ shifts.find_shifts ──> Shift...

`scales.py` defines on which scale, such as the logarithm, each kind of figure is compared.
"""
