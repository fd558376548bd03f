"""Sources, scores, processes and checks that several tests use.

Images of known geometry
    made_scene: a rover in front of a textured wall, as pairs, folder or bag. The default source of a test.
    loc_drive: its pairs for the localiser. node_scenes: its pairs as ROS messages.
    made_worlds: random pairs in each format that is written, and blobs at known pixels.
    wall, disparity_world, map_scenes: surfaces for the parts of the mapper and for its score.
Sources of other programs, and invalid sources
    kalibr_chains, made_layouts, made_ros1, message_bags, pose_tables: files as other programs write them.
    broken_sources: sources with one fault each.
Trajectories and scores
    scored_drives, judge: drives with their limits, for tests of `sfr score`.
    random_drives: random estimates. honest_drives: estimates without a convention mismatch.
    trajectory_pairs: ten pairs that differ in length, rate, gaps, stamps, scale and position.
    strategies: random transforms for hypothesis.
    metrics_reference: the formulas of the specification with loops. hazard_truth: hazards of the true points.
    made_scores, score_rows: scores with every part, and their rows. made_suites: suites of estimates.
Processes
    cli_result: commands in the process of the test. processes: commands and nodes as processes. compile_c: libraries.
    peer: a node that publishes and receives. manager: a peer that manages one node in the process of the test.
    dds_client, rover_process: other participants of a ROS domain.
    misbehaving_class, misbehaving_node, misbehaving_jobs, faulty_external_node: methods, nodes and jobs that fail.
    faulty_candidate.c, slow_clock.c, repaid_clock.c: a library under test, and two libraries that slow the clock.
Live page
    live_run, page_server, browser.

Fixtures are in the `conftest.py` of the folder of a test or above: `sfr` (a command), `scheduler` (of a suite),
`own_domain`, `ros` and `shared_data` in `test/`; `files`, `judge`, `source`, `cloud`, `images` and `localised` in
`scoring/`; `drive`, `build`, `faulty` and `example` in `methods/`; `folder`, `estimate` and `cloud` in `api/`;
`made_once` in `cli/`; `config` in `simulation/`; `world` in `io/`; `two_views` in `mapping/multiview/`; `score` in
`suite/`. A fixture of a module or session calls `cli_result.run_sfr`, because the fixture `sfr` is of one test.
"""

from pathlib import Path

HELPERS = Path(__file__).resolve().parent
ROOT = HELPERS.parents[1]
