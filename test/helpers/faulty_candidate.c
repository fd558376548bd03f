/* A candidate that stands still, and does at each call what the word of its number in its configuration says. */
#include "sfr_candidate.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define LEAK 30000000
#define KNOWN (200 << 20) /* bytes that are asked for, written and freed within a call */
#ifndef KIND
#define KIND "" /* for a harness, which has no configuration */
#endif
#ifndef STATED_ABI
#define STATED_ABI SFR_CANDIDATE_ABI
#endif

struct sfr_candidate {
    char kinds[16][16];
    int calls;
};

uint32_t sfr_candidate_abi(void)
{
    return STATED_ABI;
}

const char *sfr_candidate_version(void)
{
    return "faulty 1";
}

sfr_candidate *sfr_candidate_create(const sfr_rig *rig, const char *config, char *message, size_t message_size)
{
    sfr_candidate *self = calloc(1, sizeof *self);
    if (strcmp(config, "refuse") == 0 || rig->size != sizeof *rig) {
        snprintf(message, message_size, "this rig is not to my taste");
        return NULL;
    }
    if (*config == 0)
        config = KIND;
    for (int number = 0, used = 0; number < 16 && sscanf(config, "%15s%n", self->kinds[number], &used) == 1; number++)
        config += used;
    return self;
}

void sfr_candidate_destroy(sfr_candidate *self)
{
    free(self);
}

int32_t sfr_candidate_process(sfr_candidate *self, int64_t stamp_ns, const uint8_t *left, const uint8_t *right,
                              sfr_pose *pose, double *covariance, int32_t *status)
{
    const char *kind = self->calls < 16 ? self->kinds[self->calls++] : "";
    (void)left, (void)right;
    pose->stamp_ns = stamp_ns;
    pose->quat_xyzw[3] = 1.0;
    *status = SFR_TRACKING;
    for (int i = 0; i < 36; i++)
        covariance[i] = i % 7 == 0 ? 0.01 * (1 + i / 7) : 0.0;
    if (strcmp(kind, "crash") == 0)
        abort();
    if (strcmp(kind, "hang") == 0)
        for (;;)
            sleep(1);
    if (strcmp(self->kinds[0], "leak") == 0) {
        static volatile char *kept;
        kept = malloc(LEAK);
        for (size_t byte = 0; byte < LEAK; byte += 512)
            kept[byte] = 1;
    }
    if (strcmp(self->kinds[0], "allocate") == 0) {
        volatile char *known = malloc(KNOWN);
        for (size_t byte = 0; byte < KNOWN; byte += 512)
            known[byte] = 1;
        free((void *)known);
    }
    if (strcmp(kind, "nan") == 0)
        pose->position_m[1] = NAN;
    if (strcmp(kind, "stamp") == 0)
        pose->stamp_ns += 1;
    if (strcmp(kind, "quaternion") == 0)
        pose->quat_xyzw[3] = 3.0;
    if (strcmp(kind, "covariance") == 0)
        covariance[7] = -1.0;
    if (strcmp(kind, "beyond") == 0)
        covariance[36] = 0.0;
    if (strcmp(kind, "status") == 0)
        *status = 9;
    if (strcmp(kind, "lost") == 0)
        *status = SFR_LOST;
    return strcmp(kind, "fail") == 0 ? 7 : SFR_OK;
}

#ifdef PAIR_BY_PAIR
int32_t sfr_candidate_map(sfr_candidate *self, const sfr_pair *pair, const double *T_lm_navsb, sfr_point *points,
                          size_t capacity, size_t *count)
#else
int32_t sfr_candidate_map_pairs(sfr_candidate *self, const sfr_pair *pairs, size_t pair_count, const double *T_lm_navsb,
                                sfr_map_point *points, size_t capacity, size_t *count, int32_t *fused)
#endif
{
    const char *kind = self->calls < 16 ? self->kinds[self->calls++] : "";
    (void)T_lm_navsb;
#ifdef PAIR_BY_PAIR
    (void)pair;
    *count = 1;
    points[0] = (sfr_point){1.0f, 2.0f, 3.0f, 0.1f, 4, 5};
#else
    (void)pairs;
    *count = pair_count, *fused = strcmp(kind, "fused") == 0 ? 5 : 0;
    for (size_t i = 0; i < pair_count; i++)
        points[i] = (sfr_map_point){1.0f, 2.0f, 3.0f, 0.1f, 4, 5, (uint16_t)i, 0};
    if (strcmp(kind, "pair") == 0)
        points[0].pair = (uint16_t)pair_count;
#endif
    if (strcmp(kind, "crash") == 0)
        abort();
    if (strcmp(kind, "many") == 0)
        *count = capacity + 1;
    if (strcmp(kind, "beyond") == 0)
        points[capacity].x = 1.0f;
    if (strcmp(kind, "pixel") == 0)
        points[0].u = 60000;
    if (strcmp(kind, "nan") == 0)
        points[0].y = NAN;
    if (strcmp(kind, "negative") == 0)
        points[0].sigma = -0.1f;
    return strcmp(kind, "fail") == 0 ? 7 : SFR_OK;
}
