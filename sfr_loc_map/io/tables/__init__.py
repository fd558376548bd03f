"""Text tables of stamped poses, and tables of numbers as files.

From the bottom: `number_text` and `stamps` read the text of a cell, `decimal_marks` judges the commas in numbers, and
`text_table` reads the rows of a table. `table_head` contains the lines before the rows, from which `column_names` (a
header) or `row_layouts` (no header) determine the `pose_columns`, with `length_units`. `column_detection` decides
between both, and `quaternion_order` checks the order of quaternions by comments and by the motion (`vehicle_motion`).
`trajectory_file` reads trajectories with all of these modules, and takes the stamps of poses that have none from
`numbered_stamps`. `trajectory_writer` writes trajectories, and `table_file` other tables.
"""
