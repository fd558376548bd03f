"""The ground among the rigid motions in an image: how it is identified by its motion, and what follows for a pose.

The ground is identified by its motion, not by its position in the image. The motion of the ground is the motion that
more landmarks follow and that continues the previous motion. Landmarks of another motion (own body, dirt on the lens,
moving objects) are no longer tracked, and their image cells are excluded for several pairs. If the images do not
distinguish two motions, the pose is ambiguous.

The folder consists of five boxes, one module each:

                           left image              tracks of the landmarks
                               |                              |
                               v                              v
                       +---------------+   cells   +---------------------+
            +--------->| 1 cell_change |---------->| 2 rigid_motion      |  landmarks and cells that agree with a
            | earlier  | moved or not  |           | track, search, agree|  motion; search for further motions
            | image    +---------------+           +---------------------+
            |                                                 | main motion, further motions
            |                                                 v
    +---------------+          earlier pairs       +---------------------+
    | 5 memory      |----------------------------->| 3 evidence          |  is the main motion contradicted or unusual?
    | between pairs |                              | what the pair shows |  is there a body, a second exposure, a
    +---------------+                              +---------------------+  second motion?
            ^                                                 | Evidence, which contains the memory
            | `GroundMemory.after_pair`:                      v
            | what the pair shows (`Shown`),       +---------------------+
            | agreement of the main motion, and <--| 4 selection         |  the first case of `selection.CASES` whose
            | the selected motion                  | table of cases      |  condition is true
                                                   +---------------------+
                                                              |
                                                              v
                                  Ground: tracks of the ground, at most one finding, excluded landmarks

`double_exposure` is the kernel of box 3 that detects a second exposure. `selection` also has examples of pairs in
succession. `GroundMemory` is the only state. It is an immutable value, which the localiser keeps and replaces after its
verdict on the pair (`GroundMemory.after_verdict`).

The memory has one state machine. Its state is the phase, the number of consistent pairs until the phase ends, and two
counters. The diagram shows in parentheses how many consistent pairs end an uncertainty (`memory` lists all
transitions):

       +------ pair lost, new window ------+
       v                                   |
    LEARNING -- third consistent pair --> IDENTIFIED
       |  ^                                |
       |  |                                | uncertain ground (for 3 pairs)
       |  |                                v
       |  +-- last of these pairs ------- UNCERTAIN
       |      is consistent                ^
       |                                   |
       +-- uncertain ground (for 10) ------+

    transfers       number of partially transferred pairs in a row
    recovery_pairs  number of pairs with motion until earlier faults have no effect

A pair shows an *uncertain ground* if two motions compete, if the image contradicts the motion, or if about half of the
landmarks are unexplained. A pair is *consistent* with the earlier pairs if one motion explains the pair, if the image
moved, and if few cells are excluded as dynamic. In addition, landmarks must follow the motion in the cells that were
unexplained earlier. Some cases also depend on the memory: `DECIDED` requires an identified ground, `GROUND_UNCERTAIN`
requires a ground that stays uncertain, `UNEXPLAINED` requires a typical fraction of unexplained landmarks, and
`PARTIAL_TRANSFER` requires that few pairs in a row were transferred. During a recovery, a pair whose case has no
finding is `RECOVERING`.

While the ground is not identified, the motion that is not selected may be the ground's. Each pair with a second motion,
or with an unexplained part of the image, is therefore degraded. Unexplained landmarks in the first tracked pair of a
window are an exception, because their usual fraction is not known yet. A motion of the rover's own body degrades the
pair, too, but is not ambiguous: only the covariance of this pose is larger, because the cells of the body are excluded
from the next pairs.

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
| own body | content of stationary cells, if the landmarks outside these cells agree on a motion |
| main motion | motion of the given tracks, which may be any motion, trusted or not |
| unexplained landmark | outlier of a motion, in view and outside fixed cells |
| other motion | rigid motion of the landmarks that the main motion does not explain |
| contradicted motion | motion that predicts a standstill in cells that changed |
| unusual motion | motion with more unexplained landmarks than usual on this ground |

Each module contains the thresholds that it uses. A threshold without another source was chosen by hand on rendered
drives with injected faults. With these values, clean drives have no findings, and no error of a faulty drive exceeds
15 stated standard deviations without a finding.
"""
