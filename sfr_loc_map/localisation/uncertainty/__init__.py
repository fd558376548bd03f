"""Uncertainty of poses and steps: what enlarges a covariance, and by how much.

This docstring states all formulas with their default values. `error_sources.ErrorSources` names each value and states
its origin. The covariance of a pose is the sum of seven terms:

    covariance of a pose = external + keyframes + this_pair + kept_motion + correlated + disparity + attitude

Names: f is the focal length, px, and b the baseline, m. Z_map is the median depth, m, of the landmarks of the map, and
Z_tracked that of the tracked landmarks. `given_keyframes` is the covariance of a pose given the keyframes, the inverse
of `Tracks.information`. `yaw_sigma_px` is the standard deviation of the right camera's yaw, px, and `remaining_px` is
the part of the estimated yaw that is not corrected yet, px (`online_calibration.YawEstimate`).

**The terms of a pose** (`pose_covariance.PoseTerms`) are covariances of position and attitude of the left camera in the
world. Where the list says "position x" or "attitude x", x is the standard deviation along each axis.

- `external`, the error of the external pose: the covariance that was stated with the pose. It is 0 for an exact start
  pose.
- `keyframes`, errors since the external pose: 2.0 times the covariance of the newest keyframe in its window, from the
  bundle adjustment. When a window begins, also the first one, `this_pair`, `kept_motion` and the blur of its first
  image are added. If an external pose applied within a window, what had accumulated up to that pose is subtracted.
- `this_pair`, errors of this pair alone: 2.0 `given_keyframes`; blur, which is attitude 0.03 px / f and position
  Z_map 0.03 px / f; and `unobserved`, if a finding requires it.
- `kept_motion`, errors since the last known pose: `unobserved`, while the last pose is kept.
- `correlated`, errors since the external pose: attitude hypot(0.0007 px, 0.17 RMS of the residual disparities) / (f b)
  for each metre of the path; and `ambiguity` for each pair whose findings require it. The standard deviations of all
  steps are added, and not their squares.
- `disparity`, errors since the external pose: position hypot(0.01 px, `yaw_sigma_px`, 0.5 `remaining_px`) Z_map / (f b)
  for each metre of the displacement; and the part of the yaw that was not corrected at a step, px, times Z_map / (f b),
  for each metre of this step.
- `attitude`: attitude 0.25 hypot(`yaw_sigma_px`, `bent_px`) / f since the start of the run, where `bent_px` is the yaw
  to be corrected; and attitude 0.1 / f times the sum of the absolute drift corrections since the external pose, px.

A step backwards cancels a step forwards in `disparity`, but not in `correlated`. An attitude error displaces later
positions. `external`, `keyframes` and `correlated` are therefore propagated from the position where the error arose. An
external pose does not end the attitude error of an uncertain yaw, because the yaw also bends the later path.

**What findings and events add.** `unobserved` is the covariance of the motion of RB during a time without images, or
with images that may be stale. `ambiguity` is the error if another motion is the true motion:

    v = min(max(1.0 m/s, last speed), 50 m/s)            w = min(max(0.5 rad/s, last turn rate), 6 rad/s)
    unobserved: standard deviations  v t, v t, 0.3 v t (vertical);  0.2 w t, 0.2 w t (tilt), w t (heading)
    ambiguity:  standard deviation of each axis  max(distance to the other pose, estimated motion, v t or w t)

The speeds are the parameters `motion.unseen_speed_m_s` to `motion.max_turn_rad_s`, and t is the time since the last
known pose. The last known pose is the pose of an accepted pair, the pose of a pair that begins a window, or an external
pose (`LastPose.known_ns`). The standard deviation of an angle is at most 1.81 rad, that of an unknown angle.

| finding or event | adds | to the term | until |
|---|---|---|---|
| finding with `Inflation.UNOBSERVED` | `unobserved` | `this_pair` | next accepted pair |
| finding with `Inflation.AMBIGUITY` | `ambiguity` | `correlated` | external pose |
| kept pair | `unobserved` | `kept_motion` | next accepted pair |
| a window begins | `unobserved`, and the blur of the first image | `keyframes` | external pose |
| external pose for a past pair | `this_pair` of that pair | `external` | external pose |
| external pose between two distant pairs | `unobserved`, t to the nearer pair | `external` | external pose |
| external pose after the last accepted pair | `unobserved`, t from its stamp on | `kept_motion` | next accepted pair |
| ... and the next accepted pair | last `this_pair`; `unobserved`, t to the stamp | `external` | external pose |
| sheared rows, even without a finding | shift of the pose by the shear | `noise` of the step | next pair |
| lost pair | 9999 m^2 and 9999 rad^2 replace the covariance | all | next pair that is not lost |

`findings.RULES` lists the inflation of each finding. Two pairs are distant if a pair between them is missing or was
refused. If a window begins before the next accepted pair, what was added until then moves to `keyframes`, and remains
there until the next external pose.

**The covariance of a step**, the motion of RB between two poses, is composed of the errors of the step
(`StepEstimate.motion_covariance`). The covariances of the poses are not used, because consecutive poses share most of
their errors:

    covariance of a step = step + noise + noise_before + systematic^2 + speed_change

- `step` (`step_covariance`), errors of images, independent from step to step: 1.5 max(`variance_factor`, 0.2)
  `step_ratio` times the sum of 2.0 times the covariance between the two newest keyframes, and position 0.01 px
  Z_tracked / f. `step_ratio` is the optical flow of the step divided by that between the keyframes (at least a quarter
  of the flow that triggers a keyframe), and is at least 0.02. `added` (below) is added to this product.
- `noise` (`pose_noise`), white noise of a pose, which cancels between consecutive steps: 0.5 max(`variance_factor`,
  0.2) `given_keyframes`; attitude 1e-5 rad; and sqrt(max(1 - 1 / `chi2`, 0)) times the shift of the pose by sheared
  rows (`right_camera.RowShear`). `noise_before` is that of the previous pose.
- `systematic` (`systematic_step`), errors common to all steps, which add up with their sign: position hypot(0.01 px,
  `yaw_sigma_px`, `remaining_px`) Z_tracked / (f b) times the displacement; and the attitude of `correlated` without
  `ambiguity`.
- `speed_change`, for the mean velocity: `unobserved` after tracking was lost, else 0.

`variance_factor` is the running ratio of the squared residuals to their stated variance, 1 if the noise model is right.
`added` (`PublishedPose.accepted`) has three parts: what findings add to the two poses of the step, the displacement of
the previous pose by a correction of the yaw, and the motion while the previous pose was kept. An added error of a pose
has opposite signs in the steps to and from that pose. Each of the two steps contains the covariance of this error,
which is conservative. The parts of the previous pose are zero if its pair began a window, because the step is measured
from the image of that pair.

**An example.** A rig with f = 500 px and b = 0.2 m has driven 10 m straight ahead from an exact start pose, with
0.3 m/s at 10 Hz. Z_map is 5 m, sigma of the yaw 0.02 px, and lens residuals are not significant. The standard
deviations of the terms are:

| term | computation | position | attitude |
|---|---|---|---|
| `keyframes` | from the adjustment, for example 2 mm: sqrt(2.0) 2 mm; blur of the first image | 2.9 mm | 60 urad |
| `this_pair` | blur: 0.03 / 500 rad, times 5 m (`given_keyframes` is smaller) | 0.3 mm | 60 urad |
| `correlated` | lens: 0.0007 / (500 0.2) rad/m, times 10 m; at a mean distance of 5 m | 0.35 mm | 70 urad |
| `disparity` | hypot(0.01, 0.02) px 5 m / (500 0.2) px m, times 10 m | 11 mm | |
| `attitude` | 0.25 0.02 / 500 rad | | 10 urad |
| sum of variances | | 12 mm | 110 urad |

The findings and events of the next pairs add, for 0.1 s, which is one period:

| finding or event | computation | horizontal position | heading |
|---|---|---|---|
| `PARTIAL_TRANSFER` (unobserved) | max(1.0, 0.3) m/s and 0.5 rad/s, times 0.1 s | 0.10 m | 0.05 rad |
| three pairs `AMBIGUOUS`, 0.04 m apart | 3 max(0.04, 0.03, 0.10) m | 0.30 m | 0.15 rad |
| second kept pair | as unobserved, for 0.2 s | 0.20 m | 0.10 rad |
| window after 1 s without poses | as unobserved, for 1 s | 1.0 m | 0.5 rad |

After `PARTIAL_TRANSFER`, the next accepted pair has 12 mm again. After the ambiguous pairs, all later poses have at
least 0.30 m until the next external pose.

**The modules** contain values and functions that change no value. `path.PathState` holds the two states and updates
them with each pair, and `Localiser` composes the covariance of a published pose (`pose_terms`):

| module | content |
|---|---|
| `error_sources` | parameters of the error sources; constants of a run; what unobserved motions and findings add |
| `pose_covariance` | state of the pose: errors of the present pose, and how each event changes them; terms of a pose |
| `step_covariance` | terms of a step; state of the step: the pose published last |

The path of a finding to the covariance is

    Finding --findings.RULES--> Verdict.inflation --> AcceptedPair.inflation --inflation_of--> AddedError
        AddedError.unobserved_rb --> PathErrors.unobserved_motion --> this_pair
        AddedError.ambiguity     --> PathSums.correlated          --> correlated
        both (of_step)           --> PublishedPose.accepted       --> the steps to and from the pose

**A new error source** requires a parameter in `ErrorSources`, the formula in the function that uses it, and:

| the error is | code |
|---|---|
| of one pose only | a field of `PathErrors`, set in `accepted` and part of `this_pair`; a term of `pose_noise` |
| | zero in `window_begun` and `anchored`; zero in `adjusted`, too, if the error of a keyframe contains it |
| a sum along the path | a field of `PathSums`, with its increment in `sums_after_step` and its difference in `since` |
| | a term of `PoseTerms`, computed in `pose_terms` |
| common to all steps | as for a sum, and a term of `systematic_step` |
| independent from step to step | as for a sum of variances, and a term of `step_covariance` |
| required by a finding | a flag of `findings.Inflation`, the findings with this flag in `findings.RULES` |
| | a field of `AddedError`, set in `inflation_of` and part of `of_step`; its use in `PathErrors.accepted` |
"""
