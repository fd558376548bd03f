"""The calls of a localiser or mapper: state, cost and statistics of each call of `process`.

A call has three forms. The record of one call (`call_record`) is also published as JSON on `<node>/call`
(`call_message`). The file of the calls of a run (`call_files`) has a row for each call. The calls in memory
(`call_stats`) are columns, from a file or from records that are added one by one (`growing_calls`); scores read this
form.

| `CallRecord` and JSON | stats.csv | `CallStats` |
|---|---|---|
| `stamp_ns`, `state` | the same | `calls` |
| `processing_time_s` (None if unknown, JSON: 0) | the same (NaN; empty and 0 are read as NaN) | `calls.seconds` |
| `peak_rss_bytes`, `above_idle_bytes` | the same, and `memory_method` | `calls` |
| `statistics` | a column for each | `calls.stage_s`, `processes` |
| `covariance` `(6, 6)` | `COVARIANCE_NAMES` (upper triangle) | `covariance` (upper triangle) |
| `step` | `STEP_NAMES` | `steps` |
| `finding` | the same | `findings`, counted by their kind |
| `images_sha256` | the same | `identity`, only from a file |
| `reason` | the same | |
| `task`, which follows from `state` | follows from `state` | follows from `state` |
| `pair_stamps_ns`, `fused`, `times`, `counts`, `version` | | |
| | method, pose, `cloud_sha256`, `replay_rate` | `methods`, `identity` |

`run_identity` identifies the run of calls by its poses, images, cloud and rate, so that a score detects calls of
another run. `call_poses` assigns the states, covariances and steps of calls to the poses of their run.
`call_findings` counts the findings on a method that its calls state.
"""
