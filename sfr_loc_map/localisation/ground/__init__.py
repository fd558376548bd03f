"""The ground among the rigid motions in an image: how it is identified by its motion, and what follows for a pose.

The ground is identified by its motion, not by its position in the image. The motion of the ground is the motion that
more landmarks follow and that continues the previous motion. Landmarks of another motion (own body, dirt on the lens,
moving objects) are no longer tracked, and their image cells are excluded for several pairs. If the images do not
distinguish two motions, the pose is ambiguous.

    left image, earlier image ---- cell_change ----> changed and stationary cells
                                                         |
    tracks of the landmarks ------ cell_motion ----> main motion: landmarks and cells that agree with it
                                                         |
    GroundMemory (earlier pairs) -------------------> Evidence <---- searches, if the case is still open: own body,
                                                         |           second exposure, second motion
                                                         v
                                  first rule of `cases.CASE_RULES` whose condition is true
                                       |                 |                 |
                                       v                 v                 v
                                   Selection          finding         what is learnt
                               (tracks of the ground,                      |
                                excluded landmarks and cells)              v
                                                              GroundMemory (after the pair)

`selection` lists the steps with their functions, and examples. `cases.CASE_RULES` is the only table of decisions, and
`thresholds` has all thresholds of these decisions. `GroundMemory` is the only state. It is an immutable value, which
the localiser keeps and replaces after its verdict on the pair (`Ground.memory_after`).

A pair is *consistent* with the earlier pairs if one motion explains the pair, the image moved, few cells are excluded
as dynamic, and landmarks follow the motion also in the cells that were unexplained earlier. A pair is *inconsistent* if
two motions compete, if the image contradicts the motion, or if about half of the landmarks are unexplained. The ground
is then *uncertain* for several pairs. An unusual pair that is not consistent prolongs an uncertainty.

Two state machines in the memory, `Identification` and `ImageFaults`, connect the cases of successive pairs:

       +------ pair lost, new window ------+
       v                                   |
    LEARNING -- third consistent pair --> IDENTIFIED
       |  ^                                |
       |  |                                | inconsistent pair (for 3 pairs)
       |  |                                v
       |  +-- last of these pairs ------- UNCERTAIN
       |      is consistent                ^
       |                                   |
       +-- inconsistent pair (for 10) -----+

    no fault -- fault, or stale rows --> recovery
       ^                                   |
       +- enough pairs with motion, -------+
          or new window

The case of a pair changes both (`Rule.learns`, `Rule.fault`), and both decide on the case of the next pair: two motions
are `DECIDED` only if the ground is identified, one motion is `UNCONFIRMED` while the ground stays uncertain, and
`TRANSFERRED` requires that few pairs in a row were transferred. During a recovery, a pair whose case has no finding is
`RECOVERING`. `memory` lists all transitions.

While the ground is not identified, the motion that is not selected may be the ground's. Each pair with a second motion,
or with an unexplained part of the image, is therefore degraded. Unexplained landmarks in the first tracked pair of a
window are an exception, because their usual fraction is not known yet. Beside a body, only the covariance of that pose
is larger, because the cells of the body are excluded from the next pairs.

The method has four known limits:

- The rover is assumed to move. If an object already moves in the first tracked pair of a window, beside a rover at
  rest, the pose follows the object.
- After a fault, a rover at rest remains degraded until it moves (`RECOVERING`, `AT_REST_UNCERTAIN`), because images
  of a rover at rest do not show whether the fault has ended.
- If an object moves in much of the view of a rover at rest, the pairs are reported as partially transferred
  (`PARTIAL_TRANSFER`) and as recovering, until the rover moves. The ground is stationary in these images, and so are
  the stale parts of a partial transfer at the moment at which a rover drives off.
- If the ground becomes so rough that each pair has unusually many unexplained landmarks, the pairs remain degraded
  (`UNEXPLAINED`) until a new window begins, because a fault may look the same.

| term | meaning |
|---|---|
| partial transfer | image whose rows belong to two exposures (`stale_images`) |
| double exposure | image in which two exposures are blended (`double_exposure`) |
| pair with motion | pair with a trusted pose, whose image moved |
| stationary cell | textured cell whose content did not move since the earlier image (`cell_change`) |
| fixed cell | stationary cell for which a pose predicts image motion, and therefore fixed to the camera |
| dynamic cell | cell of landmarks that move differently from the ground |
| own body | what stationary cells show if the landmarks outside these cells agree on a motion |
| main motion | motion of the given tracks, which may be any motion, trusted or not |
| unexplained landmark | outlier of a motion, in view and outside fixed cells |
| other motion | rigid motion of the landmarks that the main motion does not explain |
| contradicted motion | motion that predicts a standstill in cells that changed |
| unusual motion | motion with more unexplained landmarks than usual on this ground |

| module | content |
|---|---|
| `selection` | the order of the steps of a pair, with examples |
| `evidence` | what the decisions depend on, and the searches for further motions |
| `cases` | the table of the decisions: condition and consequences of each case, and the tracks that each case selects |
| `memory` | the state between pairs, with its two state machines |
| `motions` | the tools that track and search for a motion |
| `excluded_cells` | cells that are excluded for several pairs |
| `cell_change`, `cell_motion`, `double_exposure` | measurements in the images |
| `thresholds` | the thresholds of all decisions |
"""
