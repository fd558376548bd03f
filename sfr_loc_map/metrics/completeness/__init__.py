"""What is expected of each subject, and how much of it is judged, missing or wrong.

`expected_items` counts the expected, judged, missing and extra items of each subject, and `drive` finds the gaps of a
drive. `copies` finds poses that are not measurements. `shortfall_kinds` is the table of all that can be missing or
wrong, and states when a result is incomplete.
"""
