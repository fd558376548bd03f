"""What is expected of each subject, and how much of it is judged, missing or wrong.

`shortfall_kinds` is the table of what can be missing or wrong. `drive` counts the expected items of a drive, and
`expected_items` those of maps, calls and live runs. `copies` finds poses that are not measurements.
"""
