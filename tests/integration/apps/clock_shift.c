// SPDX-License-Identifier: Apache-2.0
// Preloaded: a CLOCK_TAI that is off by XAUTO_TEST_TAI_MS, as of a host that nobody disciplines; with XAUTO_TEST_ORDINARY the
// lowest SCHED_FIFO priority is refused.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now)
{
	const char *ms = getenv("XAUTO_TEST_TAI_MS");
	const long failed = syscall(SYS_clock_gettime, clock, now);

	if (failed == 0 && clock == CLOCK_TAI && ms) {
		const long long ns = now->tv_sec * 1000000000LL + now->tv_nsec + atoll(ms) * 1000000LL;

		now->tv_sec = ns / 1000000000LL;
		now->tv_nsec = ns % 1000000000LL;
	}
	return (int)failed;
}

int pthread_setschedparam(pthread_t thread, int policy, const struct sched_param *wanted)
{
	static int (*real)(pthread_t, int, const struct sched_param *);

	if (policy == SCHED_FIFO && wanted->sched_priority == 1 && getenv("XAUTO_TEST_ORDINARY"))
		return EPERM;
	if (!real)
		real = (int (*)(pthread_t, int, const struct sched_param *))dlsym(RTLD_NEXT, "pthread_setschedparam");
	return real(thread, policy, wanted);
}
