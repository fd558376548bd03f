"""Text tables of stamped poses, and tables of numbers as files.

A trajectory file is read in these steps; each type is the result of one step:

    first lines     ─► columns/table_head         TableHead       lines before the rows, cells of the first rows
    TableHead       ─► columns/user_columns       StatedColumns   columns as the user names them, or
                       columns/header_columns                     as a header names them, or
                       columns/row_layouts                        as the only layout that the rows fit
    StatedColumns   ─► column_detection, checks/  PoseColumns     complete columns with all units
    all lines       ─► cells/text_table           TableRows       stamps and numbers of the valid rows
    TableRows       ─► row_poses, numbered_stamps                 poses, covariances and stamps
    poses           ─► checks/run_checks                          one run of one body
                       trajectory_file            LoadedTrajectory

`trajectory_writer` writes trajectories, and `table_file` other tables. The folders import only those before them:
`cells` (text to rows of numbers), `columns`, `checks`, and the modules beside them.
"""
