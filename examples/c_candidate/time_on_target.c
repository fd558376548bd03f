/* Times a candidate on the target: no ROS, no Python, no dependency but the candidate itself.
 *
 *   cc -std=c99 -O2 -I../../include -o time_on_target time_on_target.c candidate.c -lm
 *   ./time_on_target pairs.raw > target.csv
 *
 * pairs.raw is written by export_pairs.py on the host. target.csv is what `sfr score --target NAME --target-timing
 * target.csv` reads. A target without files or POSIX clock replaces the two functions below `the target's own`.
 */
#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 199309L /* of clock_gettime */
#endif
#include "sfr_candidate.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---- The target's own -------------------------------------------------------------------------------------------- */

static double now_s(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Peak resident memory of the process, bytes; 0 where it is not known. */
static long peak_bytes(void)
{
    char line[256];
    long kib = 0;
    FILE *file = fopen("/proc/self/status", "r");
    while (file != NULL && fgets(line, sizeof line, file) != NULL)
        if (sscanf(line, "VmHWM: %ld", &kib) == 1)
            break;
    if (file != NULL)
        fclose(file);
    return 1024 * kib;
}

/* ---- The run ----------------------------------------------------------------------------------------------------- */

static const char *STATES[] = {"initialising", "tracking", "degraded", "lost"};

int main(int argc, char **argv)
{
    char message[256] = "";
    sfr_rig rig;
    int64_t stamp_ns;
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    if (file == NULL || fread(&rig, sizeof rig, 1, file) != 1 || rig.size != sizeof rig) {
        fprintf(stderr, "usage: %s PAIRS.raw, as export_pairs.py writes it\n", argv[0]);
        return 2;
    }
    size_t size = (size_t)rig.width * (size_t)rig.height;
    uint8_t *images = malloc(2 * size);
    sfr_candidate *candidate = sfr_candidate_create(&rig, "", message, sizeof message);
    if (images == NULL || candidate == NULL) {
        fprintf(stderr, "cannot start: %s\n", message);
        return 1;
    }
    printf("stamp_ns,processing_time_s,state,peak_rss_bytes\n");
    while (fread(&stamp_ns, sizeof stamp_ns, 1, file) == 1 && fread(images, size, 2, file) == 2) {
        sfr_pose pose = {0};
        double covariance[36];
        int32_t status = SFR_LOST;
        pose.size = sizeof pose;
        double begin = now_s();
        int32_t failed = sfr_candidate_process(candidate, stamp_ns, images, images + size, &pose, covariance, &status);
        double seconds = now_s() - begin;
        int known = !failed && status >= 0 && status <= SFR_LOST;
        printf("%" PRId64 ",%.9f,%s,%ld\n", stamp_ns, seconds, STATES[known ? status : SFR_LOST], peak_bytes());
    }
    sfr_candidate_destroy(candidate);
    free(images);
    fclose(file);
    return 0;
}
