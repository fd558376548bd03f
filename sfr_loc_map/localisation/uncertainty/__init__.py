"""Uncertainty of poses and steps: error sources, their sums along the path, and the covariances.

    tracks, map, calibration        findings
          |                            |
          |                            v
          |                       AddedError ------------------------+
          |                            |                             |
          v                            v                             v
    PathSums -------------------> PathErrors                   PublishedPose ----> StepEstimate
                                       |                  (of the last and of this pose)
                                       v
                                   PoseTerms ----> covariance of the pose

| module | content |
|---|---|
| `error_sources` | parameters of the error sources; constants of a run; what unobserved motions and findings add |
| `pose_covariance` | state of the pose: errors of the present pose, and how each event changes them; terms of a pose |
| `step_covariance` | terms of a step; state of the step: the pose published last |

All functions are pure, and each states its formula. `path.PathState` holds the two states and updates them with each
pair. `Localiser` composes the covariance of a published pose (`pose_terms`).

Names in the formulas: f is the focal length, px, and b the baseline, m. Z_map is the median depth, m, of the landmarks
of the map, which enters the terms of a pose. Z_tracked is that of the tracked landmarks, which enters the terms of a
step. `given_keyframes` is the covariance of a pose given the keyframes, the inverse of `Tracks.information`.
`yaw_sigma_px` is the standard deviation of the right camera's yaw, and `target_px` is the yaw to be corrected.
`corrected_px` is the part of this yaw that is already corrected, `remaining_px` the rest
(`online_calibration.YawEstimate`). `lens_turn` is the rotation per metre by residual lens distortion
(`RoverModel.lens_turn_per_m`). Other names are fields of `ErrorSources`, or are explained beside the formula.

**The covariance of a pose** of the left camera in the world is the sum of seven terms (`PoseTerms`):

    pose = external + keyframes + this_pair + kept_motion + correlated + disparity + attitude

| term | errors of | estimated from | changes with | counted since |
|---|---|---|---|---|
| `external` | the external pose, `this_pair` of its pair | the operator, or the start pose | external pose | |
| `keyframes` | keyframes and earlier windows | bundle adjustment | keyframe, new window | external pose |
| `this_pair` | the image of this pair alone | tracks of the pair, findings | accepted pair, keyframe, | the pair |
| | | | new window, external pose | |
| `kept_motion` | the motion while a pose is kept | last speed, time | kept pair | last accepted pose |
| `correlated` | lens distortion, ambiguous motions | residual disparities, findings | step | external pose |
| `disparity` | errors common to all disparities | yaw of the windows | step, keyframe | external pose |
| `attitude` | the yaw of the right camera | yaw of the windows | keyframe | start of the run |
| | the drift of the right camera | drift corrections | drift correction | external pose |

An external pose does not end the attitude error of an uncertain yaw, because the yaw also bends the later path.

**The covariance of a step**, the motion of RB between two poses, is composed of the errors of the step and not computed
from `pose`, because consecutive poses share most of their errors:

    motion = step + noise + noise_before + systematic^2 + speed_change     (`StepEstimate.motion_covariance`)

| part | error source | function |
|---|---|---|
| `step` | images, independent from step to step | `step_covariance` |
| | findings of the two poses, correction of the yaw, kept pose | `added` (below) |
| `noise` | white noise of a pose, which cancels between consecutive steps | `pose_noise` |
| `systematic` | errors common to all steps, which add up with their sign | `systematic_step` |
| `speed_change` | mean velocity of a motion that was unobserved after tracking was lost | `unobserved_motion` |

`added` (`PublishedPose.accepted`) has three parts: what findings add to the two poses of the step
(`AddedError.of_step`), the displacement of the previous pose by a correction of the yaw, and the motion while the
previous pose was kept. An added error of a pose has opposite signs in the steps to and from that pose. Each of the two
steps contains the covariance of this error, which is conservative (`PublishedPose.shared_with_next_step`). The parts of
the previous pose are zero if its pair began a window, because the step is measured from the image of that pair.

**What findings and events add** (`error_sources`):

| finding or event | adds | to the term | until |
|---|---|---|---|
| finding with `Inflation.UNOBSERVED` | unobserved, since the last known pose | `this_pair` | next accepted pair |
| finding with `Inflation.AMBIGUITY` | `ambiguity`; the sigmas of several pairs add up | `correlated` | external pose |
| kept pair | unobserved, since the last known pose or a later external pose | `kept_motion` | next accepted pair |
| sheared rows, even without a finding | factor max(`shear_chi2`, 1) (`pose_noise`) | `noise` of the step | next pair |
| a window begins | unobserved, as for a kept pair; `blur` of the image | `keyframes` | external pose |
| external pose for a past pair | `this_pair` of this pair | `external` | external pose |
| external pose between pairs that are not consecutive | unobserved, to the nearer pair | `external` | external pose |
| external pose after the last accepted pair | unobserved, from its stamp on | `kept_motion` | next accepted pair |
| and the next accepted pair | `this_pair` of the last pair; unobserved, to the stamp | `external` | external pose |
| lost pair | the covariance of an unknown pose replaces all (`lost_covariance`) | all | next pair that is not lost |

`unobserved` is the covariance of an unobserved motion (`unobserved_motion`), and `ambiguity` is the error if another
motion is the true motion (`inflation_of`). The path of a finding to the covariance is

    Finding --findings.RULES--> Verdict.inflation --> AcceptedPair.inflation --inflation_of--> AddedError
        AddedError.unobserved_rb --> PathErrors.unobserved_motion --> this_pair
        AddedError.ambiguity     --> PathSums.correlated          --> correlated
        both (of_step)           --> PublishedPose.accepted       --> the steps to and from the pose

The last known pose is the pose of an accepted pair, the pose of a pair that begins a window, or an external pose
(`LastPose.known_ns`). If a window begins before the next accepted pair, the errors of the window contain what was added
until then, and the term lasts until the next external pose.

**An example.** A rig with f = 500 px and b = 0.2 m has driven 10 m straight ahead from an exact start pose, with
0.3 m/s at 10 Hz. Z_map is 5 m, sigma of the yaw 0.02 px, and lens residuals are not significant. The standard
deviations of the terms are:

| term | computation | position | attitude |
|---|---|---|---|
| `keyframes` | from the adjustment, for example 2 mm: sqrt(2.0) 2 mm | 2.8 mm | |
| `this_pair` | blur: 0.03 / 500 rad, times 5 m (`given_keyframes` is smaller) | 0.3 mm | 60 urad |
| `correlated` | lens: 0.0007 / (500 0.2) rad/m, times 10 m; at a mean distance of 5 m | 0.35 mm | 70 urad |
| `disparity` | hypot(0.01, 0.02) px 5 m / (500 0.2) px m, times 10 m | 11 mm | |
| `attitude` | 0.25 0.02 / 500 rad | | 10 urad |
| sum of variances | | 12 mm | 93 urad |

The findings and events of the next pairs add, for 0.1 s, which is one period:

| finding or event | computation | horizontal position | heading |
|---|---|---|---|
| `PARTIAL_TRANSFER` (unobserved) | max(1.0, 0.3) m/s and 0.5 rad/s, times 0.1 s | 0.10 m | 0.05 rad |
| three pairs `AMBIGUOUS`, 0.04 m apart | 3 max(0.04, 0.03, 0.10) m | 0.30 m | 0.15 rad |
| second kept pair | as unobserved, for 0.2 s | 0.20 m | 0.10 rad |
| window after 1 s without poses | as unobserved, for 1 s | 1.0 m | 0.5 rad |

After `PARTIAL_TRANSFER`, the next accepted pair has 12 mm again. After the ambiguous pairs, all later poses have at
least 0.30 m until the next external pose.

**A new error source** requires a parameter in `ErrorSources`, the formula in the function that uses it, and:

| the error is | code |
|---|---|
| of one pose only | a field of `PathErrors`, set in `accepted` and part of `this_pair`; a term of `pose_noise` |
| | zero in `window_begun` and `anchored`; zero in `adjusted`, too, if the error of a keyframe contains it |
| a sum along the path | a field of `PathSums`, with its increment in `sums_after_step` and its difference in `since` |
| | a term of `PoseTerms`, computed in `pose_terms` and added in `total` |
| common to all steps | as for a sum, and a term of `systematic_step` |
| independent from step to step | as for a sum of variances, and a term of `step_covariance` |
| required by a finding | a flag of `findings.Inflation`, the findings with this flag in `findings.RULES` |
| | a field of `AddedError`, set in `inflation_of` and part of `of_step`; its use in `PathErrors.accepted` |
"""
