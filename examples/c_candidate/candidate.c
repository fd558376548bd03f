/* An example of a candidate in C: a localiser and a mapper with the interface sfr_candidate.h. Not tuned for accuracy.
 *
 * Localiser: corners are detected on a grid, and their depth is measured by block matching along the row. In the next
 * left image they are searched by block matching around the position that the last motion predicts. The motion is
 * estimated by Gauss-Newton on the reprojection error with Tukey weights.
 * Mapper: block matching along the row, with a check of the disparities of neighbouring pixels.
 * Build: cc -std=c99 -O2 -fPIC -shared -I../../include -o libcandidate.so candidate.c -lm
 */
#include "sfr_candidate.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BLOCK 4       /* half the side of a block, pixels */
#define CELL 16       /* side of a cell, with one corner per cell, pixels */
#define MARGIN 12     /* border without corners, pixels */
#define SEARCH 14     /* search radius around the predicted position of a corner, pixels */
#define MAX_CORNERS 4096
#define MIN_CORNERS 12
#define ITERATIONS 12

typedef struct {
    double x, y;     /* pixel in the left image */
    double point[3]; /* metres, left optical frame */
} corner;

struct sfr_candidate {
    sfr_rig rig;
    int max_disparity;
    int started;
    int count;
    corner corners[MAX_CORNERS];
    uint8_t *previous; /* left image of the previous pair */
    double motion[12]; /* last known pose of the left camera relative to the previous pair */
    double pose[12];   /* pose of the left camera relative to the first pair */
};

/* ---- Transforms: 12 doubles, the upper three rows ---------------------------------------------------------------- */

static void compose(const double *a, const double *b, double *out)
{
    double made[12];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            made[4 * i + j] = j == 3 ? a[4 * i + 3] : 0.0;
            for (int k = 0; k < 3; k++)
                made[4 * i + j] += a[4 * i + k] * b[4 * k + j];
        }
    memcpy(out, made, sizeof made);
}

static void invert(const double *a, double *out)
{
    double made[12];
    for (int i = 0; i < 3; i++) {
        made[4 * i + 3] = 0.0;
        for (int j = 0; j < 3; j++) {
            made[4 * i + j] = a[4 * j + i];
            made[4 * i + 3] -= a[4 * j + i] * a[4 * j + 3];
        }
    }
    memcpy(out, made, sizeof made);
}

static void identity(double *out)
{
    memset(out, 0, 12 * sizeof *out);
    out[0] = out[5] = out[10] = 1.0;
}

static void apply(const double *a, const double *point, double *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = a[4 * i] * point[0] + a[4 * i + 1] * point[1] + a[4 * i + 2] * point[2] + a[4 * i + 3];
}

/* Rotation vector w and translation v as a transform (Rodrigues). */
static void from_step(const double *step, double *out)
{
    const double *w = step + 3;
    double angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
    double s = angle < 1e-12 ? 1.0 : sin(angle) / angle;
    double c = angle < 1e-12 ? 0.5 : (1.0 - cos(angle)) / (angle * angle);
    double k[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double square = 0.0;
            for (int m = 0; m < 3; m++)
                square += k[3 * i + m] * k[3 * m + j];
            out[4 * i + j] = (i == j) + s * k[3 * i + j] + c * square;
        }
        out[4 * i + 3] = step[i];
    }
}

static void to_quaternion(const double *a, double *q)
{
    double trace = a[0] + a[5] + a[10];
    if (trace > 0.0) {
        double s = 2.0 * sqrt(trace + 1.0);
        q[0] = (a[9] - a[6]) / s, q[1] = (a[2] - a[8]) / s, q[2] = (a[4] - a[1]) / s, q[3] = 0.25 * s;
        return;
    }
    int i = a[5] > a[0] ? 1 : 0;
    i = a[10] > a[5 * i] ? 2 : i;
    int j = (i + 1) % 3, k = (i + 2) % 3;
    double s = 2.0 * sqrt(1.0 + a[5 * i] - a[5 * j] - a[5 * k]);
    q[i] = 0.25 * s;
    q[j] = (a[4 * j + i] + a[4 * i + j]) / s;
    q[k] = (a[4 * k + i] + a[4 * i + k]) / s;
    q[3] = (a[4 * k + j] - a[4 * j + k]) / s;
}

/* ---- Block matching ---------------------------------------------------------------------------------------------- */

static int difference(const uint8_t *a, const uint8_t *b, int width)
{
    int sum = 0;
    for (int y = -BLOCK; y <= BLOCK; y++)
        for (int x = -BLOCK; x <= BLOCK; x++)
            sum += abs((int)a[y * width + x] - (int)b[y * width + x]);
    return sum;
}

/* Vertex of the parabola through three values, -0.5 to 0.5. */
static double vertex(int before, int best, int after)
{
    int curvature = before - 2 * best + after;
    return curvature > 0 ? 0.5 * (before - after) / curvature : 0.0;
}

/* Return the disparity of a left pixel, or a negative value if the best disparity is ambiguous. */
static double disparity_at(const uint8_t *left, const uint8_t *right, int width, int x, int y, int largest)
{
    int costs[1024], best = -1, limit = x - BLOCK < largest ? x - BLOCK : largest;
    if (limit < 3)
        return -1.0;
    for (int d = 0; d <= limit; d++) {
        costs[d] = difference(left + y * width + x, right + y * width + x - d, width);
        if (best < 0 || costs[d] < costs[best])
            best = d;
    }
    for (int d = 0; d <= limit; d++)
        if (abs(d - best) > 1 && costs[d] * 10 < costs[best] * 11)
            return -1.0; /* another disparity is nearly as good */
    if (best < 1 || best >= limit)
        return -1.0;
    return best + vertex(costs[best - 1], costs[best], costs[best + 1]);
}

/* ---- Localiser --------------------------------------------------------------------------------------------------- */

/* Select the pixel with the largest gradient in each cell, and triangulate its point. */
static void find_corners(sfr_candidate *self, const uint8_t *left, const uint8_t *right)
{
    const sfr_rig *rig = &self->rig;
    int width = rig->width, height = rig->height;
    self->count = 0;
    for (int top = MARGIN; top + CELL <= height - MARGIN; top += CELL)
        for (int side = MARGIN; side + CELL <= width - MARGIN && self->count < MAX_CORNERS; side += CELL) {
            int best = 0, at_x = 0, at_y = 0;
            for (int y = top; y < top + CELL; y++)
                for (int x = side; x < side + CELL; x++) {
                    const uint8_t *p = left + y * width + x;
                    int gx = abs(p[1] - p[-1]), gy = abs(p[width] - p[-width]);
                    int strength = gx < gy ? gx : gy;
                    if (strength > best)
                        best = strength, at_x = x, at_y = y;
                }
            if (best < 6)
                continue;
            double d = disparity_at(left, right, width, at_x, at_y, self->max_disparity);
            if (d < 0.5)
                continue;
            corner *made = &self->corners[self->count++];
            double z = rig->fx * rig->baseline_m / d;
            made->x = at_x, made->y = at_y;
            made->point[0] = (at_x - rig->cx) / rig->fx * z;
            made->point[1] = (at_y - rig->cy) / rig->fy * z;
            made->point[2] = z;
        }
}

static int project(const sfr_rig *rig, const double *point, double *x, double *y)
{
    if (point[2] < 0.05)
        return 0;
    *x = rig->fx * point[0] / point[2] + rig->cx;
    *y = rig->fy * point[1] / point[2] + rig->cy;
    return *x > MARGIN && *y > MARGIN && *x < rig->width - MARGIN && *y < rig->height - MARGIN;
}

/* Search a corner in the new left image near (x, y); return whether it was found. */
static int track(const sfr_candidate *self, const corner *old, const uint8_t *left, double x, double y, double *found)
{
    int width = self->rig.width, height = self->rig.height, reach = SEARCH, best = -1, at_x = 0, at_y = 0;
    const uint8_t *block = self->previous + (int)old->y * width + (int)old->x;
    int x0 = (int)lround(x), y0 = (int)lround(y), low = BLOCK + 1;
    for (int v = y0 - reach; v <= y0 + reach; v++)
        for (int u = x0 - reach; u <= x0 + reach; u++) {
            if (u < low || v < low || u >= width - low || v >= height - low)
                continue;
            int cost = difference(block, left + v * width + u, width);
            if (best < 0 || cost < best)
                best = cost, at_x = u, at_y = v;
        }
    if (best < 0 || best > 15 * (2 * BLOCK + 1) * (2 * BLOCK + 1))
        return 0;
    const uint8_t *p = left + at_y * width + at_x;
    found[0] = at_x + vertex(difference(block, p - 1, width), best, difference(block, p + 1, width));
    found[1] = at_y + vertex(difference(block, p - width, width), best, difference(block, p + width, width));
    return 1;
}

/* Solve the symmetric system a x = b of 6 unknowns by elimination; return 0 if the system is singular. */
static int solve(double a[6][7])
{
    for (int i = 0; i < 6; i++) {
        int pivot = i;
        for (int r = i + 1; r < 6; r++)
            if (fabs(a[r][i]) > fabs(a[pivot][i]))
                pivot = r;
        if (fabs(a[pivot][i]) < 1e-12)
            return 0;
        for (int c = 0; c < 7; c++) {
            double kept = a[i][c];
            a[i][c] = a[pivot][c], a[pivot][c] = kept;
        }
        for (int r = 0; r < 6; r++)
            if (r != i) {
                double f = a[r][i] / a[i][i];
                for (int c = i; c < 7; c++)
                    a[r][c] -= f * a[i][c];
            }
    }
    return 1;
}

/* Refine T_now_before by the pixels; return the number of inliers. */
static int fit(const sfr_rig *rig, const corner *corners, double (*pixels)[2], int count, double *T_now_before)
{
    int agreeing = 0;
    for (int round = 0; round < ITERATIONS; round++) {
        double system[6][7] = {{0}}, scale = round < 4 ? 12.0 : 3.0;
        agreeing = 0;
        for (int i = 0; i < count; i++) {
            double p[3], x, y;
            apply(T_now_before, corners[i].point, p);
            if (!project(rig, p, &x, &y))
                continue;
            double error[2] = {pixels[i][0] - x, pixels[i][1] - y}, z = p[2];
            double ratio = (error[0] * error[0] + error[1] * error[1]) / (scale * scale);
            if (ratio >= 1.0)
                continue;
            agreeing++;
            double weight = (1.0 - ratio) * (1.0 - ratio);
            double rows[2][6] = {
                {rig->fx / z, 0, -rig->fx * p[0] / (z * z), 0, 0, 0},
                {0, rig->fy / z, -rig->fy * p[1] / (z * z), 0, 0, 0}};
            for (int r = 0; r < 2; r++) { /* a rotation w moves the point by w x p */
                double *j = rows[r];
                j[3] = j[2] * p[1] - j[1] * p[2];
                j[4] = j[0] * p[2] - j[2] * p[0];
                j[5] = j[1] * p[0] - j[0] * p[1];
                for (int m = 0; m < 6; m++) {
                    for (int n = 0; n < 6; n++)
                        system[m][n] += weight * j[m] * j[n];
                    system[m][6] += weight * j[m] * error[r];
                }
            }
        }
        if (agreeing < MIN_CORNERS || !solve(system))
            return 0;
        double step[6], turn[12];
        for (int m = 0; m < 6; m++)
            step[m] = system[m][6] / system[m][m];
        from_step(step, turn);
        compose(turn, T_now_before, T_now_before);
    }
    return agreeing;
}

/* Estimate the motion since the previous pair; return whether the estimate succeeded. */
static int move(sfr_candidate *self, const uint8_t *left)
{
    static double pixels[MAX_CORNERS][2];
    static corner seen[MAX_CORNERS];
    double T_now_before[12], point[3], x, y;
    int count = 0;
    invert(self->motion, T_now_before);
    for (int i = 0; i < self->count; i++) {
        apply(T_now_before, self->corners[i].point, point);
        if (project(&self->rig, point, &x, &y) && track(self, &self->corners[i], left, x, y, pixels[count]))
            seen[count++] = self->corners[i];
    }
    if (count < MIN_CORNERS || fit(&self->rig, seen, pixels, count, T_now_before) < MIN_CORNERS)
        return 0;
    invert(T_now_before, self->motion);
    compose(self->pose, self->motion, self->pose);
    return 1;
}

int32_t sfr_candidate_process(sfr_candidate *self, int64_t stamp_ns, const uint8_t *left, const uint8_t *right,
                              sfr_pose *pose, double *covariance, int32_t *status)
{
    size_t size = (size_t)self->rig.width * (size_t)self->rig.height;
    double T_left_rb[12], T_start_rb[12];
    *status = !self->started ? SFR_INITIALISING : move(self, left) ? SFR_TRACKING : SFR_LOST;
    self->started = 1;
    find_corners(self, left, right);
    memcpy(self->previous, left, size);
    /* convert the motion of the camera to the motion of the rover: T_rb_left T_first_now T_left_rb */
    invert(self->rig.T_rb_left, T_left_rb);
    compose(self->rig.T_rb_left, self->pose, T_start_rb);
    compose(T_start_rb, T_left_rb, T_start_rb);
    pose->stamp_ns = stamp_ns;
    for (int i = 0; i < 3; i++)
        pose->position_m[i] = T_start_rb[4 * i + 3];
    to_quaternion(T_start_rb, pose->quat_xyzw);
    (void)covariance; /* not stated */
    return SFR_OK;
}

/* ---- Mapper ------------------------------------------------------------------------------------------------------ */

/* Append the points of one pair after the first `written` points; return the new number of points. */
static size_t map_pair(const sfr_candidate *self, const sfr_pair *pair, const double *T_lm_navsb, sfr_map_point *points,
                       size_t capacity, size_t written)
{
    const sfr_rig *rig = &self->rig;
    int width = rig->width, height = rig->height;
    double T_lm_left[12], scale = rig->fx * rig->baseline_m;
    compose(T_lm_navsb, rig->T_navsb_left, T_lm_left);
    for (int y = BLOCK; y < height - BLOCK; y++) {
        double before = -1.0;
        for (int x = BLOCK; x < width - BLOCK; x++) {
            double d = disparity_at(pair->left, pair->right, width, x, y, self->max_disparity);
            int steady = d > 0.5 && before > 0.0 && fabs(d - before) < 1.0;
            before = d;
            if (!steady || written >= capacity)
                continue;
            double z = scale / d, seen[3] = {(x - rig->cx) / rig->fx * z, (y - rig->cy) / rig->fy * z, z}, made[3];
            double ray = sqrt(seen[0] * seen[0] + seen[1] * seen[1] + z * z) / z;
            apply(T_lm_left, seen, made);
            sfr_map_point *point = &points[written++];
            point->x = (float)made[0], point->y = (float)made[1], point->z = (float)made[2];
            point->sigma = (float)(0.5 * ray * z * z / scale); /* half a pixel of disparity */
            point->u = (uint16_t)x, point->v = (uint16_t)y, point->pair = (uint16_t)pair->index;
            point->reserved = 0;
        }
    }
    return written;
}

int32_t sfr_candidate_map_pairs(sfr_candidate *self, const sfr_pair *pairs, size_t pair_count, const double *T_lm_navsb,
                                sfr_map_point *points, size_t capacity, size_t *count, int32_t *fused)
{
    *count = 0, *fused = 0; /* the points of all pairs are kept */
    for (size_t i = 0; i < pair_count; i++)
        *count = map_pair(self, &pairs[i], T_lm_navsb + 12 * i, points, capacity, *count);
    return SFR_OK;
}

/* ---- Life -------------------------------------------------------------------------------------------------------- */

uint32_t sfr_candidate_abi(void)
{
    return SFR_CANDIDATE_ABI;
}

const char *sfr_candidate_version(void)
{
    return "example 1.0";
}

sfr_candidate *sfr_candidate_create(const sfr_rig *rig, const char *config, char *message, size_t message_size)
{
    int max_disparity = rig->width / 4;
    if (rig->size != sizeof(sfr_rig)) {
        snprintf(message, message_size, "sfr_rig has %u bytes, this was built for %u", rig->size,
                 (unsigned)sizeof(sfr_rig));
        return NULL;
    }
    if (*config && sscanf(config, "max_disparity: %d", &max_disparity) != 1) {
        snprintf(message, message_size, "the configuration 'max_disparity: PIXELS' is required");
        return NULL;
    }
    if (max_disparity < 4 || max_disparity > 1023) {
        snprintf(message, message_size, "max_disparity is %d: 4 to 1023 is required", max_disparity);
        return NULL;
    }
    sfr_candidate *self = calloc(1, sizeof *self);
    uint8_t *previous = calloc((size_t)rig->width, (size_t)rig->height);
    if (self == NULL || previous == NULL) {
        snprintf(message, message_size, "out of memory");
        free(self);
        free(previous);
        return NULL;
    }
    self->rig = *rig;
    self->max_disparity = max_disparity;
    self->previous = previous;
    identity(self->motion);
    identity(self->pose);
    return self;
}

void sfr_candidate_destroy(sfr_candidate *self)
{
    if (self != NULL)
        free(self->previous);
    free(self);
}
