/* sfr_candidate.h: the C interface of a localiser or mapper under test in sfr_loc_map. C99, no dependency.
 *
 * A candidate is a shared library that defines the functions below: all of the first part, and of the second and third
 * part what it can do. `sfr localise SRC --method lib:./libmine.so` loads it in a process of its own, calls
 * sfr_candidate_process once for each pair, and measures wall-clock time and peak memory around that call alone.
 * The same source can be linked into a program for the target: see docs/candidates.md.
 *
 * Conventions
 *   - Images are 8-bit grey, rectified, width * height bytes without padding, row by row; both cameras have the camera
 *     matrix of the rig. They are valid during the call only. Pixel centres are at integer coordinates.
 *   - Left optical frame: x right, y down, z forward; Z = fx baseline_m / disparity, disparity = u_left - u_right > 0.
 *   - RB is the rover body frame. NAVSB is the frame of the mapping cameras, LM the local map frame.
 *   - T_a_b takes points in b to a: 12 doubles, the upper three rows of the homogeneous matrix, row by row.
 *   - Quaternions are Hamilton, x y z w, scalar last, and rotate components in the child frame to the parent frame.
 *   - Metres, radians, nanoseconds.
 *   - Functions are called by one thread, one at a time. Whatever a candidate prints goes to its log.
 *   - A function that can fail returns 0 (SFR_OK) or any other number; that pair is then lost and the run goes on.
 */
#ifndef SFR_CANDIDATE_H
#define SFR_CANDIDATE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Version of this interface. Version 2 added sfr_candidate_map_pairs; a library of version 1 is still taken, any other
 * one is refused by name and number. */
#define SFR_CANDIDATE_ABI 2

#if defined(_WIN32)
#define SFR_CANDIDATE_API __declspec(dllexport)
#elif defined(__GNUC__)
#define SFR_CANDIDATE_API __attribute__((visibility("default")))
#else
#define SFR_CANDIDATE_API
#endif

#define SFR_OK 0

/* State of the localiser after a call. */
enum sfr_status {
    SFR_INITIALISING = 0,
    SFR_TRACKING = 1,
    SFR_DEGRADED = 2, /* a pose with an honest, larger covariance */
    SFR_LOST = 3      /* pose and covariance do not count */
};

/* The rectified stereo rig. */
typedef struct sfr_rig {
    uint32_t size; /* sizeof(sfr_rig), set by the caller */
    int32_t width, height;
    int32_t reserved;
    double fx, fy, cx, cy; /* pixels */
    double baseline_m;
    double T_rb_left[12];    /* takes points in the left optical frame to RB; for mapping the identity */
    double T_navsb_left[12]; /* takes points in the left optical frame to NAVSB */
} sfr_rig;

/* Pose of RB in RB at the first pair: the identity at the first pair. */
typedef struct sfr_pose {
    uint32_t size;      /* sizeof(sfr_pose), set by the caller */
    uint32_t reserved;
    int64_t stamp_ns;   /* stamp of the pair that the pose belongs to: set it to the one given */
    double position_m[3];
    double quat_xyzw[4];
} sfr_pose;

/* One pair for mapping. */
typedef struct sfr_pair {
    uint32_t size;  /* sizeof(sfr_pair), set by the caller */
    int32_t index;  /* number of the pair within its set: 0, 1 or 2 */
    int64_t stamp_ns;
    const uint8_t *left, *right;
} sfr_pair;

/* One point of a map of several pairs. */
typedef struct sfr_map_point {
    float x, y, z; /* metres, in LM */
    float sigma;   /* metres, one standard deviation along the ray */
    uint16_t u, v; /* column and row of the left pixel, of the pair that weighs most in the point */
    uint16_t pair; /* number of that pair within its set */
    uint16_t reserved;
} sfr_map_point;

/* One point of a map of one pair. */
typedef struct sfr_point {
    float x, y, z; /* metres, in LM */
    float sigma;   /* metres, one standard deviation along the ray */
    uint16_t u, v; /* column and row of the left pixel */
} sfr_point;

typedef struct sfr_candidate sfr_candidate; /* the candidate's own */

/* ---- Part 1: every candidate ---------------------------------------------------------------------------------- */

/* Return SFR_CANDIDATE_ABI. */
SFR_CANDIDATE_API uint32_t sfr_candidate_abi(void);

/* Return the candidate's own version, a text that stays valid. */
SFR_CANDIDATE_API const char *sfr_candidate_version(void);

/* Make a candidate; load and allocate here, this is not timed.
 * config: text of the file that --config named, empty without one.
 * message: where to write, with its final zero, why it cannot be made.
 * Return NULL if it cannot be made. */
SFR_CANDIDATE_API sfr_candidate *sfr_candidate_create(const sfr_rig *rig, const char *config, char *message,
                                                      size_t message_size);

/* Free what sfr_candidate_create made. */
SFR_CANDIDATE_API void sfr_candidate_destroy(sfr_candidate *candidate);

/* ---- Part 2: localisers --------------------------------------------------------------------------------------- */

/* Estimate the pose at one pair; pairs come in the order of their stamps.
 * covariance: 36 doubles, row by row: position (m) in the frame of the pose, then rotation (rad) about the fixed axes
 *   of that frame. NaN on entry; left so, it counts as not stated.
 * status: a value of enum sfr_status. */
SFR_CANDIDATE_API int32_t sfr_candidate_process(sfr_candidate *candidate, int64_t stamp_ns, const uint8_t *left,
                                                const uint8_t *right, sfr_pose *pose, double *covariance,
                                                int32_t *status);

/* ---- Part 3: mappers: one of the two; the first is the call that the specification judges ------------------------ */

/* Write the cloud of a set of one to three pairs: time and memory of this call are the mapper's.
 * T_lm_navsb: 12 doubles for each pair, takes points in NAVSB to LM.
 * points: room for `capacity` points, which is pair_count * width * height.
 * count: number of points written.
 * fused: 1 on entry; set it to 0 if surfaces that several pairs see are in the cloud once for each. */
SFR_CANDIDATE_API int32_t sfr_candidate_map_pairs(sfr_candidate *candidate, const sfr_pair *pairs, size_t pair_count,
                                                  const double *T_lm_navsb, sfr_map_point *points, size_t capacity,
                                                  size_t *count, int32_t *fused);

/* Write the points that one pair sees; called for each pair of a set where sfr_candidate_map_pairs is missing.
 * T_lm_navsb: 12 doubles, takes points in NAVSB to LM.
 * points: room for `capacity` points, which is width * height.
 * count: number of points written. */
SFR_CANDIDATE_API int32_t sfr_candidate_map(sfr_candidate *candidate, const sfr_pair *pair, const double *T_lm_navsb,
                                            sfr_point *points, size_t capacity, size_t *count);

#ifdef __cplusplus
}
#endif

#endif
