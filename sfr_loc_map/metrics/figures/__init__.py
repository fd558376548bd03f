"""The table of figures: the catalogue of all figures, the rows of a score and their parts, and the records beside them.

`catalogue` lists every figure, `row_part` every kind of part, and `rows` defines a row. `records` and `details` define
what a score contains besides the rows, and `results` what each subject (trajectory, map, calls) returns.
"""
