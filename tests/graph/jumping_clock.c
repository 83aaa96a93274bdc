/* To be preloaded: once the file CLOCK_JUMPS exists, the wall clock of the process is off by CLOCK_JUMP seconds, and so
 * is everybody who waits for a time of it. The monotonic clock, which is nobody's to set, goes on as it is. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SLICE_NS 20000000L /* after which one who waits looks at the clock again */
#define WALL_CLOCK_S 1000000000L /* later times are of the wall clock, earlier ones of the monotonic */

typedef int (*timed_wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);

static int real_time(struct timespec *now) { return (int)syscall(SYS_clock_gettime, CLOCK_REALTIME, now); }

static long jump(void) {
    const char *file = getenv("CLOCK_JUMPS"), *by = getenv("CLOCK_JUMP");
    return file && by && !access(file, F_OK) ? atol(by) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    if (clock != CLOCK_REALTIME) return (int)syscall(SYS_clock_gettime, clock, now);
    int failed = real_time(now);
    now->tv_sec += jump();
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec exact;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (now) *now = exact.tv_sec;
    return exact.tv_sec;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until) {
    timed_wait wait = (timed_wait)dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (until->tv_sec < WALL_CLOCK_S) return wait(condition, mutex, until);
    for (;;) {
        struct timespec now, slice;
        clock_gettime(CLOCK_REALTIME, &now);
        long left = until->tv_nsec - now.tv_nsec;
        if (until->tv_sec < now.tv_sec || (until->tv_sec == now.tv_sec && left <= 0)) return ETIMEDOUT;
        real_time(&slice);
        slice.tv_nsec += until->tv_sec == now.tv_sec && left < SLICE_NS ? left : SLICE_NS;
        if (slice.tv_nsec >= 1000000000L) slice.tv_sec++, slice.tv_nsec -= 1000000000L;
        int result = wait(condition, mutex, &slice);
        if (result != ETIMEDOUT) return result;
    }
}
