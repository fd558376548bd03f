/* A library to be loaded before all others: the first time after a wait is too early by 85 % of the wait. */
#define _GNU_SOURCE
#include <poll.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static long long debt_ns;
static int is_early;

static long long real_ns(void) {
  struct timespec now;
  syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000000LL + now.tv_nsec;
}

int poll(struct pollfd *files, nfds_t count, int timeout_ms) {
  struct timespec timeout = {timeout_ms / 1000, timeout_ms % 1000 * 1000000L};
  long long begin_ns = real_ns();
  long found = syscall(SYS_ppoll, files, count, timeout_ms < 0 ? NULL : &timeout, NULL, 0);
  debt_ns += (real_ns() - begin_ns) * 85 / 100;
  is_early = found > 0;
  return (int)found;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  long result = syscall(SYS_clock_gettime, clock, now);
  if (result == 0 && clock == CLOCK_MONOTONIC && is_early) {
    long long early_ns = now->tv_sec * 1000000000LL + now->tv_nsec - debt_ns;
    now->tv_sec = (time_t)(early_ns / 1000000000LL);
    now->tv_nsec = (long)(early_ns % 1000000000LL);
    debt_ns = is_early = 0;
  }
  return (int)result;
}
