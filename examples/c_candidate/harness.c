/* Runs a candidate on a target: localisation and mapping calls on pairs from one file, without ROS, Python or this suite.
 *
 *   sfr convert SRC pairs.sfrp
 *   cc -std=c99 -O2 -Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc,--wrap=free -I../../include \
 *      -DSFR_FLAGS='"-O2"' -o harness harness.c candidate.c -lm
 *   ./harness pairs.sfrp results
 *   sfr score results SRC
 *
 * The harness writes estimate.csv (poses), stats.csv (time, memory and state of each call), cloud_N.ply and target.json
 * of one run. docs/howto/target.md describes the format of pairs.sfrp, boards without files (-DSFR_IN_MEMORY,
 * -DSFR_TO_STDOUT), RTEMS, and the measurement of memory. A board without a POSIX clock replaces the functions below
 * `Target-specific functions`.
 */
#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200112L /* of clock_gettime, mkdir */
#endif
#include "sfr_candidate.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

/* Properties that are not defined are unknown, and null in target.json. */
#ifndef SFR_BOARD
#define SFR_BOARD NULL
#endif
#ifndef SFR_OS
#define SFR_OS NULL
#endif
#ifndef SFR_FLAGS
#define SFR_FLAGS NULL
#endif
#ifndef SFR_CLOCK
#define SFR_CLOCK "clock_gettime(CLOCK_MONOTONIC)"
#endif
#ifndef SFR_STACK_BYTES
#define SFR_STACK_BYTES 65536 /* painted before each call; must be less than the free stack of the task */
#endif
#define MAX_PAIRS 3
#define UNKNOWN (-1)

static void fail(const char *what, const char *detail)
{
    fprintf(stderr, "harness: %s%s%s\n", what, detail[0] ? ": " : "", detail);
    exit(2);
}

/* ---- Target-specific functions ----------------------------------------------------------------------------------- */

/* Time, seconds; name the clock by -DSFR_CLOCK. The clock of a development kit goes here. */
static double now_s(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static double clock_resolution_s(void)
{
    struct timespec time;
    if (clock_getres(CLOCK_MONOTONIC, &time) != 0)
        return UNKNOWN;
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Resident memory of the process from /proc of Linux, bytes; UNKNOWN if /proc does not exist. */
static long resident_bytes(const char *key)
{
    long kib = UNKNOWN;
#ifndef SFR_NO_PROC
    char line[256];
    size_t length = strlen(key);
    FILE *file = fopen("/proc/self/status", "r");
    while (file != NULL && fgets(line, sizeof line, file) != NULL)
        if (strncmp(line, key, length) == 0 && sscanf(line + length, ": %ld", &kib) == 1)
            break;
    if (file != NULL)
        fclose(file);
#else
    (void)key;
#endif
    return kib > 0 ? 1024 * kib : UNKNOWN;
}

/* Reset the high-water mark of resident memory to the present value; return whether the reset succeeded. */
static int reset_resident_peak(void)
{
    int done = 0;
#ifndef SFR_NO_PROC
    FILE *file = fopen("/proc/self/clear_refs", "w");
    if (file != NULL) {
        done = fputs("5", file) >= 0;
        done = fclose(file) == 0 && done;
    }
#endif
    return done;
}

/* ---- Heap: every requested block, by --wrap of the linker ---------------------------------------------------------- */

static size_t heap_now, heap_peak, heap_of_harness;
static int heap_is_counted; /* set by the first block, so that a build without --wrap reports unknown */
#define HEAD 16             /* header of each block with its size; keeps the alignment of malloc */

void *__real_malloc(size_t size);
void __real_free(void *block);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *block, size_t size);
void __wrap_free(void *block);

#ifndef SFR_NO_WRAP
void *__wrap_malloc(size_t size)
{
    char *block = size > SIZE_MAX - HEAD ? NULL : __real_malloc(size + HEAD);
    heap_is_counted = 1;
    if (block == NULL)
        return NULL;
    memcpy(block, &size, sizeof size);
    heap_now += size;
    heap_peak = heap_now > heap_peak ? heap_now : heap_peak;
    return block + HEAD;
}

void __wrap_free(void *block)
{
    size_t size;
    if (block == NULL)
        return;
    memcpy(&size, (char *)block - HEAD, sizeof size);
    heap_now -= size;
    __real_free((char *)block - HEAD);
}

void *__wrap_calloc(size_t count, size_t size)
{
    void *block = size && count > SIZE_MAX / size ? NULL : __wrap_malloc(count * size);
    return block == NULL ? NULL : memset(block, 0, count * size);
}

void *__wrap_realloc(void *block, size_t size)
{
    size_t before = 0;
    void *made = __wrap_malloc(size);
    if (made != NULL && block != NULL) {
        memcpy(&before, (char *)block - HEAD, sizeof before);
        memcpy(made, block, before < size ? before : size);
        __wrap_free(block);
    }
    return made;
}
#endif

/* ---- Stack: painted below the present frame before a call, read after it ------------------------------------------- */

#define PAINT 0xA5
#define STACK_MARGIN 512 /* largest offset between the stack frames of the two functions */
#if defined(__GNUC__)
__attribute__((noinline)) static void paint_stack(void)
{
    volatile uint8_t area[SFR_STACK_BYTES];
    for (size_t i = 0; i < sizeof area; i++)
        area[i] = PAINT;
}

/* Return the number of bytes of the painted stack that were written; UNKNOWN if all bytes were written. */
__attribute__((noinline)) static long painted_stack_used(void)
{
    volatile uint8_t area[SFR_STACK_BYTES]; /* same location except for some bytes; the stack grows down from the end */
    size_t kept = STACK_MARGIN;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC diagnostic ignored "-Wuninitialized"
#endif
    while (kept < sizeof area && area[kept] == PAINT)
        kept++;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic pop
#endif
    return kept == STACK_MARGIN ? UNKNOWN : (long)(sizeof area - kept);
}
#else
static void paint_stack(void)
{
}
static long painted_stack_used(void)
{
    return UNKNOWN;
}
#endif

/* ---- One measured call --------------------------------------------------------------------------------------------- */

typedef struct {
    double begin, seconds;
    long idle, resident, heap, stack;
    int resettable;
} usage;

static void begin_call(usage *call)
{
    call->resettable = reset_resident_peak();
    heap_peak = heap_now;
    paint_stack();
    call->begin = now_s();
}

static void end_call(usage *call)
{
    call->seconds = now_s() - call->begin;
    call->stack = painted_stack_used();
    call->heap = heap_is_counted ? (long)(heap_peak - heap_of_harness) : UNKNOWN;
    call->resident = call->resettable ? resident_bytes("VmHWM") : UNKNOWN;
}

/* ---- Pairs: little-endian on every board --------------------------------------------------------------------------- */

#ifdef SFR_IN_MEMORY
extern const uint8_t sfr_pairs[], sfr_pairs_end[]; /* linked in, see docs/howto/target.md */
static const uint8_t *at = sfr_pairs;
static void open_pairs(const char *path)
{
    (void)path;
}
static void take(void *into, size_t size)
{
    if ((size_t)(sfr_pairs_end - at) < size)
        fail("the pairs end early", "convert them again");
    memcpy(into, at, size);
    at += size;
}
#else
static FILE *pairs_file;
static void open_pairs(const char *path)
{
    pairs_file = fopen(path, "rb");
    if (pairs_file == NULL)
        fail("cannot read the pairs", path);
}
static void take(void *into, size_t size)
{
    if (fread(into, 1, size, pairs_file) != size)
        fail("the pairs end early", "convert them again");
}
#endif

static uint64_t take_uint(size_t size)
{
    uint8_t bytes[8];
    uint64_t value = 0;
    take(bytes, size);
    for (size_t i = size; i-- > 0;)
        value = value << 8 | bytes[i];
    return value;
}

static double take_double(void)
{
    uint64_t bits = take_uint(8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void take_doubles(double *into, size_t count)
{
    for (size_t i = 0; i < count; i++)
        into[i] = take_double();
}

/* ---- Results ------------------------------------------------------------------------------------------------------- */

static const char *folder = ".";

/* Open a result; without files it is written to the console after a line `@@ NAME`. */
static FILE *result(const char *name)
{
#ifdef SFR_TO_STDOUT
    printf("@@ %s\n", name);
    return stdout;
#else
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "w");
    if (file == NULL)
        fail("cannot write", path);
    return file;
#endif
}

static void finish(FILE *file)
{
#ifdef SFR_TO_STDOUT
    fflush(file);
#else
    if (fclose(file) != 0)
        fail("cannot write", "a result; is the disk full?");
#endif
}

/* Rows that are kept until the end, so that files are written one after the other and not between two calls. */
typedef struct {
    int64_t stamp_ns;
    double pose[7], seconds;
    long resident, idle, heap, stack;
    const char *state;
} row;

static int failed_maps;
static row *rows;
static size_t row_count;

static const char *STATES[] = {"initialising", "tracking", "degraded", "lost"};

static void add_row(int64_t stamp_ns, const char *state, const usage *call)
{
    row *made = &rows[row_count++];
    memset(made, 0, sizeof *made);
    made->stamp_ns = stamp_ns, made->state = state, made->seconds = call->seconds;
    made->resident = call->resident, made->idle = call->idle, made->heap = call->heap, made->stack = call->stack;
}

static void put_bytes(FILE *file, long bytes)
{
    if (bytes < 0)
        fputc(',', file);
    else
        fprintf(file, ",%ld", bytes);
}

static void write_stats(size_t localised)
{
    FILE *file = result("stats.csv");
    fprintf(file, "stamp_ns,processing_time_s,state,peak_rss_bytes,above_idle_bytes,heap_peak_bytes,stack_peak_bytes\n");
    for (size_t i = 0; i < row_count; i++) {
        const row *call = &rows[i];
        long above = UNKNOWN;
        if (call->resident >= 0 && call->idle >= 0)
            above = call->resident > call->idle ? call->resident - call->idle : 0;
        fprintf(file, "%" PRId64 ",%.9f,%s", call->stamp_ns, call->seconds, call->state);
        put_bytes(file, call->resident);
        put_bytes(file, above);
        put_bytes(file, call->heap);
        put_bytes(file, call->stack);
        fputc('\n', file);
    }
    finish(file);
    if (!localised)
        return;
    file = result("estimate.csv");
    fprintf(file, "stamp_ns,rbOriginPos_m_Ds_x,rbOriginPos_m_Ds_y,rbOriginPos_m_Ds_z,"
                  "att_q_DsToRb_1,att_q_DsToRb_2,att_q_DsToRb_3,att_q_DsToRb_4\n");
    for (size_t i = 0; i < localised; i++) {
        const row *call = &rows[i];
        fprintf(file, "%" PRId64, call->stamp_ns);
        for (int k = 0; k < 7; k++) /* DsToRb is the conjugate of the attitude of RB in DS */
            fprintf(file, ",%.17g", k < 3 || k == 6 ? call->pose[k] : -call->pose[k]);
        fputc('\n', file);
    }
    finish(file);
}

static void put_text(FILE *file, const char *name, const char *text)
{
    fprintf(file, ",\n  \"%s\": ", name);
    if (text == NULL) {
        fputs("null", file);
        return;
    }
    fputc('"', file);
    for (; *text; text++) {
        if (*text == '"' || *text == '\\')
            fputc('\\', file);
        fputc((unsigned char)*text < 32 ? ' ' : *text, file);
    }
    fputc('"', file);
}

static void write_target(void)
{
    const uint16_t one = 1;
    double resolution = clock_resolution_s();
    FILE *file = result("target.json");
    fprintf(file, "{\n  \"schema\": \"sfr-target/1\"");
    put_text(file, "candidate", sfr_candidate_version());
    put_text(file, "board", SFR_BOARD);
    put_text(file, "os", SFR_OS);
    put_text(file, "clock", SFR_CLOCK);
    fprintf(file, ",\n  \"clock_resolution_s\": ");
    if (resolution < 0.0)
        fputs("null", file);
    else
        fprintf(file, "%.9g", resolution);
#ifdef __VERSION__
    put_text(file, "compiler", __VERSION__);
#else
    put_text(file, "compiler", NULL);
#endif
    put_text(file, "flags", SFR_FLAGS);
    put_text(file, "byte_order", *(const uint8_t *)&one ? "little-endian" : "big-endian");
    fprintf(file, ",\n  \"pointer_bits\": %u", (unsigned)(8 * sizeof(void *)));
    fprintf(file, ",\n  \"stack_painted_bytes\": %ld\n}\n", (long)SFR_STACK_BYTES);
    finish(file);
}

static void write_cloud(size_t number, const sfr_pair *pairs, size_t pair_count, const sfr_map_point *points,
                        size_t count, int32_t fused)
{
    char name[32];
    snprintf(name, sizeof name, "cloud_%u.ply", (unsigned)number);
    FILE *file = result(name);
    fprintf(file, "ply\nformat ascii 1.0\ncomment sfr fused %s\ncomment sfr pair_stamps_ns", fused ? "true" : "false");
    for (size_t i = 0; i < pair_count; i++)
        fprintf(file, " %" PRId64, pairs[i].stamp_ns);
    fprintf(file, "\nelement vertex %lu\nproperty float x\nproperty float y\nproperty float z\nproperty float sigma\n"
                  "property ushort u\nproperty ushort v\nproperty uchar pair\nend_header\n", (unsigned long)count);
    for (size_t i = 0; i < count; i++)
        fprintf(file, "%.9g %.9g %.9g %.9g %u %u %u\n", points[i].x, points[i].y, points[i].z, points[i].sigma,
                points[i].u, points[i].v, points[i].pair);
    finish(file);
}

/* ---- Localisation and mapping -------------------------------------------------------------------------------------- */

/* Convert a pose of RB relative to RB at the first pair to DS; both are position and quaternion x y z w. */
static void in_ds(const double *start, const double *pose, double *out)
{
    const double *p = pose, *a = start + 3, *b = pose + 3;
    double cross[3] = {a[1] * p[2] - a[2] * p[1], a[2] * p[0] - a[0] * p[2], a[0] * p[1] - a[1] * p[0]};
    double twice[3] = {a[1] * cross[2] - a[2] * cross[1], a[2] * cross[0] - a[0] * cross[2],
                       a[0] * cross[1] - a[1] * cross[0]};
    for (int i = 0; i < 3; i++)
        out[i] = start[i] + p[i] + 2.0 * (a[3] * cross[i] + twice[i]);
    out[3] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
    out[4] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0];
    out[5] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3];
    out[6] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
}

static void localise(sfr_candidate *candidate, size_t pair_count, size_t size, uint8_t *images, const double *start,
                     long idle)
{
    static double covariance[36];
    double known[7] = {0, 0, 0, 0, 0, 0, 1}; /* a lost pair keeps the last pose */
    for (size_t i = 0; i < pair_count; i++) {
        sfr_pose pose = {0};
        usage call = {0};
        int32_t status = SFR_LOST;
        int64_t stamp_ns = (int64_t)take_uint(8);
        take(images, 2 * size);
        pose.size = sizeof pose;
        for (int k = 0; k < 36; k++)
            covariance[k] = NAN;
        call.idle = idle;
        begin_call(&call);
        int32_t failed = sfr_candidate_process(candidate, stamp_ns, images, images + size, &pose, covariance, &status);
        end_call(&call);
        if (failed || status < 0 || status > SFR_LOST)
            status = SFR_LOST;
        if (status != SFR_LOST) {
            memcpy(known, pose.position_m, sizeof pose.position_m);
            memcpy(known + 3, pose.quat_xyzw, sizeof pose.quat_xyzw);
        }
        add_row(stamp_ns, STATES[status], &call);
        in_ds(start, known, rows[row_count - 1].pose);
    }
}

#ifndef SFR_LOCALISATION_ONLY
static void map_pairs(sfr_candidate *candidate, size_t number, size_t pair_count, size_t size, uint8_t *images, long idle)
{
    static sfr_pair pairs[MAX_PAIRS];
    static double T_lm_navsb[12 * MAX_PAIRS];
    size_t capacity = pair_count * size, count = 0;
    int32_t fused = 1;
    usage call = {0};
    sfr_map_point *points = malloc(capacity * sizeof *points);
    if (points == NULL)
        fail("out of memory", "the cloud");
    heap_of_harness += capacity * sizeof *points;
    for (size_t i = 0; i < pair_count; i++) {
        pairs[i].size = sizeof pairs[i];
        pairs[i].index = (int32_t)i;
        pairs[i].stamp_ns = (int64_t)take_uint(8);
        take_doubles(T_lm_navsb + 12 * i, 12);
        pairs[i].left = images + 2 * i * size;
        pairs[i].right = pairs[i].left + size;
        take(images + 2 * i * size, 2 * size);
    }
    call.idle = idle;
    begin_call(&call);
    int32_t failed = sfr_candidate_map_pairs(candidate, pairs, pair_count, T_lm_navsb, points, capacity, &count, &fused);
    end_call(&call);
    if (failed || count > capacity) {
        fprintf(stderr, "harness: the map of set %u failed\n", (unsigned)number);
        failed_maps++;
    } else {
        add_row(pairs[pair_count - 1].stamp_ns, "mapped_set", &call);
        write_cloud(number, pairs, pair_count, points, count, fused);
    }
    free(points);
}
#endif

int main(int argc, char **argv)
{
    char message[256] = "", magic[8];
    const char *path = argc > 1 ? argv[1] : "";
#ifndef SFR_IN_MEMORY
    if (argc != 3) {
        fprintf(stderr, "usage: %s PAIRS.sfrp RESULTS, as sfr convert SRC PAIRS.sfrp writes it\n", argv[0]);
        return 2;
    }
#endif
    folder = argc > 2 ? argv[2] : ".";
#ifndef SFR_TO_STDOUT
    mkdir(folder, 0777);
#endif
    open_pairs(path);
    take(magic, sizeof magic);
    if (memcmp(magic, "SFRPAIRS", sizeof magic) != 0 || take_uint(4) != 1)
        fail("not pairs of version 1", path);
    size_t localised = 0, sections = (size_t)take_uint(4);
    for (size_t section = 0; section < sections; section++) {
        sfr_rig rig = {0};
        double start[7];
        int is_mapping = take_uint(4) == 2;
        size_t pair_count = (size_t)take_uint(4);
        rig.size = sizeof rig;
        rig.width = (int32_t)take_uint(4), rig.height = (int32_t)take_uint(4);
        rig.fx = take_double(), rig.fy = take_double(), rig.cx = take_double(), rig.cy = take_double();
        rig.baseline_m = take_double();
        take_doubles(rig.T_rb_left, 12);
        take_doubles(rig.T_navsb_left, 12);
        take_doubles(start, 7);
        size_t size = (size_t)rig.width * (size_t)rig.height;
        rows = realloc(rows, (row_count + pair_count + 1) * sizeof *rows);
        uint8_t *images = malloc(2 * size * (is_mapping ? MAX_PAIRS : 1));
        if (rows == NULL || images == NULL || (is_mapping && pair_count > MAX_PAIRS))
            fail("out of memory", "the pairs");
        long idle = resident_bytes("VmRSS"); /* before the candidate is created, so that all of its memory is above idle */
        heap_of_harness = heap_now;
        sfr_candidate *candidate = sfr_candidate_create(&rig, "", message, sizeof message);
        if (candidate == NULL)
            fail("cannot make the candidate", message);
        if (!is_mapping) {
            localise(candidate, pair_count, size, images, start, idle);
            localised += pair_count;
        }
#ifndef SFR_LOCALISATION_ONLY
        else
            map_pairs(candidate, 0, pair_count, size, images, idle);
#endif
        sfr_candidate_destroy(candidate);
        free(images);
    }
    write_stats(localised);
    write_target();
    free(rows);
    return failed_maps ? 1 : 0;
}
