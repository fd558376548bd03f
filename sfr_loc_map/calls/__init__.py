"""The calls of a localiser or mapper: state, cost and statistics of each call of `process`.

The record of a call has three forms (`CallRecord` lists the fields that only the first form has):

    CallRecord (`call_record`)        one call; as JSON on the topic `<node>/call` (`encode_call`, `decode_call`)
    stats.csv (`call_files`)          one row for each call (`save_stats`, `load_call_stats`)
    CallStats (`call_stats`)          the calls of a run as columns, from a file or from records (`call_rows`); scores
                                      read this form

`run_identity` identifies the run of calls by its poses, images, cloud and rate, so that a score detects calls of
another run. `call_poses` assigns the states, covariances and steps of calls to the poses of their run.
`call_findings` counts the findings on a method that its calls state.
"""
