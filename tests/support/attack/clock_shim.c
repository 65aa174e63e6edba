/* The clock of the machine, set back by an hour as soon as the file QUADFTC_SET_BACK is there (LD_PRELOAD).
   As in a kernel, a wait until a time of that clock lasts an hour longer from then on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const time_t RECENT = 1000000000; /* s; a machine is not up for so long: it is no monotonic time */

static long set_back(void) {
  static int is_back;
  const char *path = getenv("QUADFTC_SET_BACK");
  if (!is_back && path) is_back = access(path, F_OK) == 0;
  return is_back ? 3600 : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  static int (*real)(clockid_t, struct timespec *);
  if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  int failed = real(clock, now);
  if (!failed && clock == CLOCK_REALTIME) now->tv_sec -= set_back();
  return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
  struct timespec exact;
  (void)zone;
  if (clock_gettime(CLOCK_REALTIME, &exact)) return -1;
  now->tv_sec = exact.tv_sec;
  now->tv_usec = exact.tv_nsec / 1000;
  return 0;
}

time_t time(time_t *now) {
  struct timespec exact;
  if (clock_gettime(CLOCK_REALTIME, &exact)) return -1;
  if (now) *now = exact.tv_sec;
  return exact.tv_sec;
}

/* Waits until a time by CALL, in which `end` is the time of the clock that was not set back. */
#define WAIT(CALL, IS_LATE)                                       \
  long shift;                                                     \
  int failed;                                                     \
  do {                                                            \
    struct timespec end = *until;                                 \
    shift = set_back();                                           \
    if (end.tv_sec > RECENT) end.tv_sec += shift;                 \
    failed = CALL;                                                \
  } while (failed && (IS_LATE) && until->tv_sec > RECENT && shift != set_back()); \
  return failed

int pthread_cond_timedwait(pthread_cond_t *restrict cond, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict until) {
  static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
  if (!real) *(void **)&real = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
  WAIT(real(cond, mutex, &end), failed == ETIMEDOUT);
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex, const struct timespec *restrict until) {
  static int (*real)(pthread_mutex_t *, const struct timespec *);
  if (!real) *(void **)&real = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
  WAIT(real(mutex, &end), failed == ETIMEDOUT);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
  static int (*real)(sem_t *, const struct timespec *);
  if (!real) *(void **)&real = dlsym(RTLD_NEXT, "sem_timedwait");
  WAIT(real(semaphore, &end), errno == ETIMEDOUT);
}
