/* A library to be loaded before all others: the monotonic clock runs at a tenth of its rate. */
#define _GNU_SOURCE
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
  long result = syscall(SYS_clock_gettime, clock, now);
  if (result == 0 && clock == CLOCK_MONOTONIC) {
    long long total_ns = (now->tv_sec * 1000000000LL + now->tv_nsec) / 10;
    now->tv_sec = (time_t)(total_ns / 1000000000LL);
    now->tv_nsec = (long)(total_ns % 1000000000LL);
  }
  return (int)result;
}
