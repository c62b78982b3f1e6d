/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What the tracer keeps of the XNode threads of one run: woken, running, preempted by whom, moved. Every
 * record goes to a ring buffer (for `xauto top --record`) and to a perf event array (for `bpftool map
 * event_pipe`); sums and histograms per XNode stay in maps (for `xauto top`). What could not be told is
 * counted in "losses". Included after kernel.bpf.h and libbpf's headers by xauto_trace.bpf.c and
 * xauto_trace_tp.bpf.c, which know how a thread is told by their kernel.
 *
 * A thread tells which job it runs by a store that no tracepoint sees. So a stretch on the CPU during
 * which the job changed is divided at the time that the worker noted (slots[].since_ns). When it changed
 * more than once, the jobs in the middle are counted as lost.
 *
 * State of a thread, st->ready_ns and st->began_ns:
 *
 *                  wakeup                  switch in
 *     asleep  -------------->  ready  -------------->  running
 *       ^                        ^  switch out, still ready |
 *       |                        '--------------------------+
 *       '---------------------------------------------------' switch out, sleeps
 */
#ifndef _XAUTO_TRACE_BPF_H
#define _XAUTO_TRACE_BPF_H

#include "uapi/xauto/bpf.h"
#include "maps.bpf.h"

char _license[] SEC("license") = "GPL";

/* Set by the loader before it loads. Plain C types: the C++ skeleton has no u32. */
const volatile bool record_events = true;

XAUTO_MAP_HEAD;
XAUTO_MAP_SLOTS;
XAUTO_MAP_THREADS;

struct {
	__uint(type, BPF_MAP_TYPE_RINGBUF);
	__uint(max_entries, 1 << 20);
} events SEC(".maps");

struct {
	__uint(type, BPF_MAP_TYPE_PERF_EVENT_ARRAY);
	__uint(key_size, sizeof(u32));
	__uint(value_size, sizeof(u32));
} pipe SEC(".maps");

SHARED_ARRAY(hist, XAUTO_BPF_MAX_XNODES, struct xauto_bpf_hist);
SHARED_ARRAY(cpus, XAUTO_BPF_MAX_CPUS, struct xauto_bpf_cpu);
SHARED_ARRAY(losses, 1, struct xauto_bpf_losses);

/**
 * struct thread_state - one XNode thread; touched by the CPU that it is woken, begun or stopped on
 * @job:      the job that the sums below belong to; 0: none
 * @jobs:     slots[].jobs when last looked at
 * @ready_ns: since when it is ready and does not run; 0: it is not
 * @began_ns: since when it runs; 0: it does not
 * @run_ns:   of this job
 * @wait_ns:  of this job, ready but not running
 * @woken:    it is ready because it was woken, not because it was preempted
 */
struct thread_state {
	u64 job;
	u64 jobs;
	u64 ready_ns;
	u64 began_ns;
	u64 run_ns;
	u64 wait_ns;
	u32 woken;
	u32 pad;
};

struct {
	__uint(type, BPF_MAP_TYPE_ARRAY);
	__uint(max_entries, XAUTO_BPF_MAX_SLOTS);
	__type(key, u32);
	__type(value, struct thread_state);
} thread_states SEC(".maps");

/**
 * struct who - a thread, as a tracepoint tells of it
 * @tid:  its number
 * @comm: its name, of 16 bytes, in the kernel's memory
 * @at:   its slot, if it is an XNode thread
 * @ours: whether it is
 */
struct who {
	u32 tid;
	const void *comm;
	u32 at;
	bool ours;
};

static __always_inline void add(u64 *counter, u64 amount)
{
	__sync_fetch_and_add(counter, amount);
}

static __always_inline struct xauto_bpf_losses *lost(void)
{
	return bpf_map_lookup_elem(&losses, &(u32){ 0 });
}

static __noinline u32 bucket(u64 ns)
{
	u64 us = ns / 1000;
	u32 i = 0;

	/* Binary search for the highest bit. */
	if (us >> 16) {
		us >>= 16;
		i += 16;
	}
	if (us >> 8) {
		us >>= 8;
		i += 8;
	}
	if (us >> 4) {
		us >>= 4;
		i += 4;
	}
	if (us >> 2) {
		us >>= 2;
		i += 2;
	}
	if (us >> 1)
		i += 1;
	return i < XAUTO_BPF_BUCKETS ? i : XAUTO_BPF_BUCKETS - 1;
}

static __always_inline struct xauto_bpf_hist *hist_of(u64 job)
{
	u32 xnode = (u32)(job >> XAUTO_BPF_JOB_SHIFT) - 1;

	/* What a thread expects to run first is no job yet. Job 0 has no XNode. */
	if ((job & XAUTO_BPF_JOB_SEQ) == XAUTO_BPF_JOB_EXPECTED)
		return NULL;
	return bpf_map_lookup_elem(&hist, &xnode);
}

static __always_inline void emit(void *ctx, struct xauto_bpf_event *e)
{
	struct xauto_bpf_losses *l = lost();
	long error;

	if (!l)
		return;
	if (record_events) {
		if (bpf_ringbuf_output(&events, e, sizeof(*e), 0))
			add(&l->events, 1);
		else
			add(&l->written, 1);
	}
	/* ENOENT: nobody reads the pipe on this CPU, which is no loss. */
	error = bpf_perf_event_output(ctx, &pipe, BPF_F_CURRENT_CPU, e, sizeof(*e));
	if (error && error != -2)
		add(&l->pipe, 1);
}

/* The sums so far are those of a whole job. */
static __always_inline void close_job(struct thread_state *st)
{
	struct xauto_bpf_hist *h = hist_of(st->job);

	if (h) {
		add(&h->run[bucket(st->run_ns)], 1);
		add(&h->wait[bucket(st->wait_ns)], 1);
		add(&h->run_ns, st->run_ns);
		add(&h->wait_ns, st->wait_ns);
		add(&h->jobs, 1);
	}
	st->job = 0;
	st->run_ns = 0;
	st->wait_ns = 0;
}

/*
 * Brings st->job up to what the worker has told, at `now`. What the thread has run since began_ns is
 * divided between the old job and the new one.
 */
static __always_inline void catch_up(struct thread_state *st, const struct xauto_bpf_slot *slot, u64 now)
{
	u64 word = *(volatile u64 *)&slot->job;
	u64 job = word & ~XAUTO_BPF_JOB_ENDED;
	u64 jobs = *(volatile u64 *)&slot->jobs;

	if (job != st->job) {
		u64 since = slot->since_ns;

		if (st->job) {
			if (st->began_ns && since > st->began_ns && since <= now) {
				st->run_ns += since - st->began_ns;
				st->began_ns = since;
			}
			close_job(st);
		}
		if (jobs > st->jobs + 1 && st->jobs) {
			struct xauto_bpf_losses *l = lost();

			if (l)
				add(&l->jobs, jobs - st->jobs - 1);
		}
		/* An ended job that is not ours any more was closed when it ended. */
		if (!(word & XAUTO_BPF_JOB_ENDED) || jobs != st->jobs)
			st->job = job;
	}
	st->jobs = jobs;
}

static __always_inline void fill(struct xauto_bpf_event *e, u32 kind, u32 tid, u32 at,
				 const struct xauto_bpf_slot *slot, u64 now)
{
	e->ts_ns = now;
	e->job = slot->job;
	e->tid = tid;
	e->slot = at;
	e->cpu = (__u16)bpf_get_smp_processor_id();
	e->kind = (__u16)kind;
}

/* @next: who has the CPU then; read if the thread is @ready, so preempted. */
static __always_inline void switched_out(void *ctx, u32 tid, u32 at, bool ready, const struct who *next,
					 u64 now)
{
	struct thread_state *st = bpf_map_lookup_elem(&thread_states, &at);
	struct xauto_bpf_slot *slot = bpf_map_lookup_elem(&slots, &at);
	struct xauto_bpf_event e = {};
	struct xauto_bpf_hist *h;

	if (!st || !slot)
		return;
	fill(&e, ready ? XAUTO_BPF_EV_PREEMPT : XAUTO_BPF_EV_SLEEP, tid, at, slot, now);
	if (st->began_ns)
		e.delta_ns = now - st->began_ns;
	catch_up(st, slot, now);
	if (st->began_ns)
		st->run_ns += now - st->began_ns;
	st->began_ns = 0;
	st->ready_ns = ready ? now : 0;
	st->woken = 0;
	if (slot->job & XAUTO_BPF_JOB_ENDED) {
		if (st->job)
			close_job(st);
	} else if (ready) {
		h = hist_of(st->job);
		if (h)
			add(&h->preemptions, 1);
	}
	if (ready) {
		e.arg = next->tid;
		bpf_probe_read_kernel_str(e.other, sizeof(e.other), next->comm);
	}
	emit(ctx, &e);
}

static __always_inline void switched_in(void *ctx, u32 tid, u32 at, u64 now)
{
	struct thread_state *st = bpf_map_lookup_elem(&thread_states, &at);
	struct xauto_bpf_slot *slot = bpf_map_lookup_elem(&slots, &at);
	struct xauto_bpf_event e = {};

	if (!st || !slot)
		return;
	catch_up(st, slot, now);
	fill(&e, XAUTO_BPF_EV_RUN, tid, at, slot, now);
	if (st->ready_ns && now > st->ready_ns) {
		struct xauto_bpf_hist *h = hist_of(st->job);
		u64 waited = now - st->ready_ns;

		e.delta_ns = waited;
		st->wait_ns += waited;
		if (h && st->woken) {
			add(&h->latency[bucket(waited)], 1);
			add(&h->wakeups, 1);
			if (waited > h->latency_max_ns)
				h->latency_max_ns = waited; /* a race loses one of two maxima: live with it */
		}
	}
	st->ready_ns = 0;
	st->woken = 0;
	st->began_ns = now;
	emit(ctx, &e);
}

/* @prev is @ready all the same: it lost the CPU. */
static __always_inline void on_switch(void *ctx, const struct who *prev, bool ready, const struct who *next)
{
	u64 now = bpf_ktime_get_ns();
	u32 cpu = bpf_get_smp_processor_id();
	struct xauto_bpf_cpu *c = bpf_map_lookup_elem(&cpus, &cpu);

	if (c) {
		u64 stretch = c->since_ns && now > c->since_ns ? now - c->since_ns : 0;

		if (prev->ours)
			c->xnode_ns += stretch;
		else if (prev->tid)
			c->other_ns += stretch;
		c->since_ns = now;
	}
	if (prev->ours)
		switched_out(ctx, prev->tid, prev->at, ready, next, now);
	if (next->ours)
		switched_in(ctx, next->tid, next->at, now);
}

static __always_inline void on_wakeup(void *ctx, u32 tid, u32 at)
{
	struct thread_state *st = bpf_map_lookup_elem(&thread_states, &at);
	struct xauto_bpf_slot *slot = bpf_map_lookup_elem(&slots, &at);
	struct xauto_bpf_event e = {};
	u64 now;

	if (!st || !slot || st->began_ns) /* it runs: it was woken before it had gone to sleep */
		return;
	now = bpf_ktime_get_ns();
	st->ready_ns = now;
	st->woken = 1;
	fill(&e, XAUTO_BPF_EV_WAKEUP, tid, at, slot, now);
	e.arg = (u32)bpf_get_current_pid_tgid();
	bpf_get_current_comm(e.other, sizeof(e.other));
	emit(ctx, &e);
}

static __always_inline void on_migrate(void *ctx, u32 tid, u32 at, u32 to)
{
	struct xauto_bpf_slot *slot = bpf_map_lookup_elem(&slots, &at);
	struct xauto_bpf_event e = {};
	struct xauto_bpf_hist *h;

	if (!slot)
		return;
	h = hist_of(slot->job);
	if (h)
		add(&h->migrations, 1);
	fill(&e, XAUTO_BPF_EV_MIGRATE, tid, at, slot, bpf_ktime_get_ns());
	e.cpu = (__u16)to;
	emit(ctx, &e);
}

#endif /* _XAUTO_TRACE_BPF_H */
