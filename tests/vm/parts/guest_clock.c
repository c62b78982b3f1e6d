// SPDX-License-Identifier: Apache-2.0
// A guest's clock: as another guest's, drifting, or stepped.
// usage: guest_clock serve PORT | join ADDRESS PORT | drift PPM | step MS | hog MS
#include <arpa/inet.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/timex.h>
#include <time.h>
#include <unistd.h>

static int64_t now(clockid_t clock)
{
	struct timespec ts;

	clock_gettime(clock, &ts);
	return ts.tv_sec * 1000000000LL + ts.tv_nsec;
}

static int set_clock(int64_t ns)
{
	const struct timespec ts = { ns / 1000000000, ns % 1000000000 };

	return clock_settime(CLOCK_REALTIME, &ts);
}

/* ADJ_TICK goes to 10 %, ADJ_FREQUENCY to 500 ppm. */
static int drift(long ppm)
{
	struct timex t = { .modes = ADJ_TICK | ADJ_FREQUENCY, .tick = 10000 + ppm / 100, .freq = 0 };

	return adjtimex(&t) < 0;
}

static struct sockaddr_in at(const char *address, const char *port)
{
	struct sockaddr_in in = { .sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(port)) };

	inet_aton(address, &in.sin_addr);
	return in;
}

static int serve(const char *port)
{
	struct sockaddr_in in = at("0.0.0.0", port), from;
	const int fd = socket(AF_INET, SOCK_DGRAM, 0);
	int64_t word;

	if (bind(fd, (struct sockaddr *)&in, sizeof(in)))
		return 1;
	for (;;) {
		socklen_t size = sizeof(from);

		if (recvfrom(fd, &word, sizeof(word), 0, (struct sockaddr *)&from, &size) != sizeof(word))
			continue;
		word = now(CLOCK_REALTIME);
		sendto(fd, &word, sizeof(word), 0, (struct sockaddr *)&from, size);
	}
}

/* By the answer that took least of fifty. */
static int join(const char *address, const char *port)
{
	struct sockaddr_in in = at(address, port);
	const struct timeval limit = { 0, 200000 };
	const int fd = socket(AF_INET, SOCK_DGRAM, 0);
	int64_t best = INT64_MAX, ahead = 0;

	setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof(limit));
	for (int i = 0; i < 50; i++) {
		const int64_t asked = now(CLOCK_REALTIME);
		int64_t word = asked;

		sendto(fd, &word, sizeof(word), 0, (struct sockaddr *)&in, sizeof(in));
		if (recv(fd, &word, sizeof(word), 0) != sizeof(word))
			continue;
		const int64_t took = now(CLOCK_REALTIME) - asked;

		if (took < best) {
			best = took;
			ahead = word - (asked + took / 2);
		}
	}
	if (best == INT64_MAX || drift(0) || set_clock(now(CLOCK_REALTIME) + ahead))
		return 1;
	printf("# clock: by %.3f ms, to within %.3f ms\n", (double)ahead * 1e-6, (double)best * 1e-6);
	return 0;
}

/* Nothing else runs on this CPU. */
static int hog(long ms)
{
	const struct sched_param most = { .sched_priority = 99 };
	const int64_t until = now(CLOCK_MONOTONIC) + ms * 1000000;

	if (sched_setscheduler(0, SCHED_FIFO, &most))
		return 1;
	while (now(CLOCK_MONOTONIC) < until)
		;
	return 0;
}

int main(int argc, char **argv)
{
	if (argc == 3 && !strcmp(argv[1], "serve"))
		return serve(argv[2]);
	if (argc == 4 && !strcmp(argv[1], "join"))
		return join(argv[2], argv[3]);
	if (argc == 3 && !strcmp(argv[1], "drift"))
		return drift(atol(argv[2]));
	if (argc == 3 && !strcmp(argv[1], "step"))
		return set_clock(now(CLOCK_REALTIME) + atol(argv[2]) * 1000000) ? 1 : 0;
	if (argc == 3 && !strcmp(argv[1], "hog"))
		return hog(atol(argv[2]));
	return 2;
}
