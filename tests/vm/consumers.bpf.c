// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto.ko's suspends and resumes counted by type of queue, for bpftool alone to load, attach and read: tests/vm/run-consumers.
 */
#include <linux/bpf.h>

#include <bpf/bpf_helpers.h>

/* The fields of /sys/kernel/tracing/events/xauto/suspend/format */
struct event {
	unsigned long long common;
	unsigned long long cost_ns;
	unsigned int queue;
	unsigned int type;
	int pid;
	unsigned int portid;
	unsigned int votes;
	int err;
};

struct count {
	unsigned long long suspends, resumes, cost_ns;
};

struct {
	__uint(type, BPF_MAP_TYPE_ARRAY);
	__uint(max_entries, 3);
	__type(key, unsigned int);
	__type(value, struct count);
} by_type SEC(".maps");

SEC("tp/xauto/suspend")
int on_suspend(struct event *event)
{
	unsigned int type = event->type;
	struct count *count = bpf_map_lookup_elem(&by_type, &type);

	if (count && !event->err) {
		__sync_fetch_and_add(&count->suspends, 1);
		__sync_fetch_and_add(&count->cost_ns, event->cost_ns);
	}
	return 0;
}

SEC("tp/xauto/resume")
int on_resume(struct event *event)
{
	unsigned int type = event->type;
	struct count *count = bpf_map_lookup_elem(&by_type, &type);

	if (count && !event->err) {
		__sync_fetch_and_add(&count->resumes, 1);
		__sync_fetch_and_add(&count->cost_ns, event->cost_ns);
	}
	return 0;
}

char _license[] SEC("license") = "GPL";
