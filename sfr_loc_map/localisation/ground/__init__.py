"""The ground among the rigid motions in an image: how it is identified by its motion, and what follows for a pose.

The ground is identified by its motion, not by its position in the image. Two state machines persist between pairs
(`identification`). The first one states which motion is the ground's:

| from | a pair | to |
|---|---|---|
| `LEARNING` | agrees, for the third time | `IDENTIFIED` |
| `LEARNING` | agrees only partly | `LEARNING`, counted from the start |
| `LEARNING`, `IDENTIFIED` | is lost, or begins a window | `LEARNING`, counted from the start |
| `IDENTIFIED` | doubts | `IN_DOUBT` for 3 pairs |
| `LEARNING` | doubts | `IN_DOUBT` for 10 pairs |
| `IN_DOUBT` | doubts | `IN_DOUBT`, for 10 pairs if more than 3 were left, otherwise for 3 pairs |
| `IN_DOUBT` | agrees: the last of these pairs | `LEARNING` |

A pair *agrees* if one motion explains it, the image moved, few cells are excluded as dynamic, and landmarks follow the
motion also in the cells that were unexplained earlier. A pair *doubts* if two motions compete, if the image contradicts
the motion, or if about half of the landmarks are unexplained. An unusual pair that does not agree prolongs a doubt.

The second one states whether faults of earlier images have an effect (`ImageFaults`):

| a pair | transfers in a row | moving pairs to recovery |
|---|---|---|
| is partially transferred | + 1 | at least 3, or the number of transfers if smaller |
| has stale rows | at least 1 | at least 1, or 10 if most rows are stale |
| shows a double exposure, an ambiguity or a doubt | 0 | at least 3 |
| has no fault, and the image moved | 0 | - 1 |
| begins a window | 0 | 0 |

The phase determines what a pair does to its pose. `cases` contains the complete table of the cases, and
`findings.RULES` the actions. U and A are the inflations of the covariance by an unobserved motion and by an ambiguity
(`findings.Inflation`).

| the pair shows | `LEARNING` | `IDENTIFIED` | `IN_DOUBT` |
|---|---|---|---|
| one motion, agreeing or partly agreeing | accepted | accepted | degraded (A) |
| one motion, before the recovery is complete | degraded (U) | degraded (U) | degraded (A) |
| one motion, and the image did not move | accepted | accepted | degraded |
| more unexplained landmarks than usual | degraded (A) | degraded (U) | degraded (A) |
| about half of the landmarks unexplained, in 10 pairs in a row | degraded (A) | degraded (U) | degraded (A) |
| the same in further pairs | degraded (A) | degraded (A) | degraded (A) |
| two motions, one of them a standstill, in 10 pairs in a row | degraded (A) | degraded (U) | degraded (A) |
| stationary texture, and one motion outside it: a body | degraded (U) | accepted | degraded (U) |
| the same after a standstill, if most landmarks are stationary | degraded (A) | accepted | degraded (A) |
| two exposures that are blended | degraded (U) | degraded (U) | degraded (U) |
| two motions, one of them with far more weight | degraded (A) | accepted | degraded (A) |
| two motions of similar weight | degraded (A) | degraded (A) | degraded (A) |
| changed cells that the pose leaves in place | kept from 5 % of all cells | kept from 40 % | kept from 5 % |

While the ground is not identified, the motion that is not selected may be the ground's. Each pair with a second motion,
or with an unexplained part of the image, is therefore degraded. Unexplained landmarks in the first tracked pair of a
window are an exception, because their usual fraction is not known yet. Beside a body, only the covariance of that pose
is larger, because the cells of the body are excluded from the next pairs. This assumes that the rover moves. If an
object already moves in the first tracked pair of a window, beside a rover at rest, the pose follows the object.

| term | meaning |
|---|---|
| partial transfer | image whose rows belong to two exposures (`stale_images`) |
| double exposure | image in which two exposures are blended (`double_exposure`) |
| moving pair | pair with a trusted pose, whose image moved |
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
| `evidence`, `cases` | what a pair shows, and the tables of the cases and their effects |
| `identification`, `memory` | the two state machines, and the images and cells that persist between pairs |
| `excluded_cells` | cells that are excluded for several pairs |
| `cell_change`, `cell_motion`, `double_exposure`, `motion_tools` | measurements in the images |
"""
