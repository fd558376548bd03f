"""The table of figures: the catalogue of all figures, the rows of a score and their parts, and the other records.

`subjects` states which figures, expected items and task belong together. `catalogue` lists every figure,
`row_part` every kind of part, and `rows` defines a row. `records` and `details` define what a score contains besides
the rows, and `results` what the scores of the trajectory, the map and the calls return.
"""
