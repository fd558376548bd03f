"""What is expected of each subject, and how much of it is judged, missing or wrong.

`drive` counts the expected, judged, missing and extra items of a drive, with the `gaps` between its estimates, and
`expected_items` those of every other subject. `copies` finds poses that are not measurements. `shortfall_kinds` is the
table of everything that can be missing or wrong, and states when a result is incomplete, how this is found, and what
accepts it.
"""
