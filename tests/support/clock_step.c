/* Wall clock with an offset that a test changes while a process runs (LD_PRELOAD; the steady clock is left alone).
   Waits until a time of day are moved by the same offset, because the kernel's own clock is not stepped. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long long *offset;
static int (*read_clock)(clockid_t, struct timespec *);
static int (*wait_condition)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
static int (*wait_condition_clock)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
static int (*lock_mutex)(pthread_mutex_t *, const struct timespec *);
static int (*wait_semaphore)(sem_t *, const struct timespec *);

__attribute__((constructor)) static void begin(void)
{
    const char *path = getenv("CLOCK_STEP_FILE");
    int file = path ? open(path, O_RDONLY) : -1;
    read_clock = dlsym(RTLD_NEXT, "clock_gettime");
    wait_condition = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (!wait_condition)
        wait_condition = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    wait_condition_clock = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
    lock_mutex = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    wait_semaphore = dlsym(RTLD_NEXT, "sem_timedwait");
    if (file >= 0) {
        void *page = mmap(NULL, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
        offset = page == MAP_FAILED ? NULL : page;
        close(file);
    }
}

static struct timespec kernel_time(const struct timespec *stepped)
{
    struct timespec time = *stepped;
    if (offset && time.tv_sec > 1000000000) /* else the condition is on the steady clock, which counts from boot */
        time.tv_sec -= *offset;
    return time;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int code;
    if (!read_clock) /* asked before the constructor ran */
        begin();
    code = read_clock(clock, now);
    if (code == 0 && clock == CLOCK_REALTIME && offset)
        now->tv_sec += *offset;
    return code;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec time = kernel_time(until);
    return wait_condition(condition, mutex, &time);
}

int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock,
                           const struct timespec *until)
{
    struct timespec time = clock == CLOCK_REALTIME ? kernel_time(until) : *until;
    return wait_condition_clock(condition, mutex, clock, &time);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec time = kernel_time(until);
    return lock_mutex(mutex, &time);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until)
{
    struct timespec time = kernel_time(until);
    return wait_semaphore(semaphore, &time);
}
