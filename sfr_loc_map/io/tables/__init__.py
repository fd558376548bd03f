"""Text tables of stamped poses: how a trajectory file is read and written.

    first lines ─► table_head          lines before the rows (titles and units), and cells of the first rows
    head        ─► column_detection    PoseColumns: the columns as the user (user_columns), a header (header_columns) or
                                       a layout (row_layouts) states them, checked by the numbers (motion_checks)
    all lines   ─► text_table          TableRows: stamps and numbers of the valid rows (cell_grid)
    rows        ─► trajectory_file     LoadedTrajectory: poses and covariances (row_poses), stamps (numbered_stamps), of
                                       one run of one body (run_checks)
    poses       ─► trajectory_writer   the file of a trajectory

`titles` states the content and the unit of a column by its title, and `length_units` the units of lengths.
`pose_columns` has the names of the columns and formats, and `loaded_trajectory` the result.
"""
