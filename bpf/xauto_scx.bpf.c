// SPDX-License-Identifier: GPL-2.0-only
/*
 * XNode threads by the keys of their jobs, everything else behind them: a sched_ext scheduler.
 *
 * A job has a key; the smaller is the more urgent (include/uapi/xauto/rule.h, bpf.h). A priority is a
 * key that no release moves. Each CPU has a queue of the XNode threads that the policy places on it,
 * ordered by key; of equal keys the one that asked first is taken. A waking job whose key is smaller
 * than that of what runs preempts it at once; it runs on the CPU of its table entry and nowhere else.
 * Ordinary threads share one fair queue (virtual time, weighted by nice). All these queues are the
 * kernel's ordered kind, which takes no thread that is inserted without a place in the order. Who gets
 * CPU c when it has to choose:
 *
 *   1. kernel threads that were woken: short, and everything stalls without them. Not without end: they
 *      have a credit of their own, of kernel_permille of time up to kernel_burst_us. Where XNode
 *      threads want the CPU and it is used up, they are ordinary threads. So are those that are nice
 *      (khugepaged, ksmd): nobody waits for their work, and it may take tens of milliseconds;
 *   2. the floor: an ordinary thread, or an XNode thread that has waited for age_ms, as long as the
 *      CPU has credit. Credit grows by floor_permille of time up to floor_burst_us. Without it a
 *      busy XNode would lock its CPU, and the kernel's watchdog would throw us out;
 *      An ordinary thread that has waited for half of the watchdog's limit needs no credit: the floor
 *      is a share, and of a crowd each would get its part of that too late. All such turns together are
 *      a quarter of time at most, so that no crowd has the CPU: of one that is too large for that, the
 *      kernel's watchdog ends us;
 *   3. the first by the rule of c's XNode queue, or the XNode thread that runs if that takes nothing
 *      from it;
 *   4. the fair queue.
 *
 * Example: keys 3 and 7 spin on one CPU, a shell wants 2 ms. 3 runs; at the end of its slice there are
 * 5 ms of credit, the shell gets its 2 ms at once; then 3 until it ends, then 7. A second shell that
 * spins gets 5 ms, and from then on 5 % of the CPU.
 *
 * Weak points, known: the tick is the clock of slices, so a grant or a budget may be overrun by one
 * tick; and a wake-up that races with the start of a thread on its CPU is noticed at the next tick
 * (see xauto_tick), since the kernel inserts into the queue only after enqueue() has returned.
 *
 * How a thread says what it runs: one store into slots[].job (include/uapi/xauto/bpf.h). The entry is
 * copied ("latched") once per job, so that replacing the table never changes a job half way.
 *
 * What cannot be ends the scheduler with a reason (scx_bpf_error), and the kernel goes back to its own.
 * What user space may get wrong (a job word, a slot number, a table) never does: that thread is an
 * ordinary one then, and a count tells.
 *
 * Any user can make ordinary threads, as many as the machine has. So nothing that is done with a run queue
 * locked grows with their number: of their queues we look at the first few, and why nobody starves of that
 * is said in ordinary.bpf.h. Only the kernel's own search for the first that may run on a CPU passes over
 * those that are pinned to others.
 *
 * Ordinary threads of a cgroup that has had its cpu.max are parked until its period ends (groups.bpf.h).
 *
 * CPUs may go and come. What waits for one that goes is handed to the kernel, which moves it; from then
 * on its XNode threads run, by their keys, on the first other CPU that they may use.
 *
 * Who holds a lock that an XNode thread waits for runs with that one's key (lend.bpf.h).
 *
 * The headers are parts of this file, each with one matter: BPF programs of one object are compiled as one.
 *
 * Locks: all callbacks of a thread run under its run queue's lock, which therefore protects jobs[].
 * cpu_state[] is written by its own CPU and read by others without a lock, as said at each place.
 */
#include "kernel.bpf.h"
#include <bpf/bpf_helpers.h>
#include <bpf/bpf_tracing.h>
#include <bpf/bpf_core_read.h>
#include "compat.bpf.h"
#include "uapi/xauto/bpf.h"
#include "uapi/xauto/rule.h"
#include "maps.bpf.h"

char _license[] SEC("license") = "GPL";

/* Set by the loader before it loads. Plain C types: the C++ skeleton has no u32. */
const volatile unsigned int nr_cpus = 1;
const volatile unsigned int mode = XAUTO_BPF_MODE_FULL;
const volatile unsigned int xnode_slice_us = 4000;    /* after it, the floor and the budget are looked at */
const volatile unsigned int ordinary_slice_us = 5000;
const volatile unsigned int grant_us = 1000;	     /* least credit that buys a turn */
const volatile unsigned int floor_permille = 50;
const volatile unsigned int floor_burst_us = 5000;
const volatile unsigned int kernel_permille = 100;    /* of kernel threads, before XNode threads */
const volatile unsigned int kernel_burst_us = 50000;
const volatile unsigned int age_ms = 1000;
const volatile unsigned long rescue_jiffies = 1000; /* an ordinary thread that waits longer goes first */
const volatile unsigned int timeout_ms = 10000;     /* the watchdog's; of it 1 % is how often we look */

/* CPUs that share a cache, by one of them: a thread that may choose stays among those of its own. */
const volatile unsigned char cluster_of[XAUTO_BPF_MAX_CPUS];

/* The kernel's dump of the error that ended us, for the loader. */
char exit_dump[XAUTO_BPF_DUMP] SEC(".data.dump");

#define FAIR_DSQ 0x58460000ULL
#define PARKED_DSQ 0x58460001ULL
#define XNODE_DSQ(cpu) (0x58440000ULL | (u32)(cpu))
#define NS_PER_US 1000ULL
#define NS_PER_MS 1000000ULL

#include "cpus.bpf.h"

XAUTO_MAP_HEAD;
XAUTO_MAP_TABLE;
XAUTO_MAP_SLOTS;
XAUTO_MAP_JOBS;
XAUTO_MAP_SCHED;
XAUTO_MAP_COUNTS;
XAUTO_MAP_THREADS;

#include "threads.bpf.h"
#include "jobs.bpf.h"
#include "lend.bpf.h"
#include "groups.bpf.h"
#include "times.bpf.h"
#include "places.bpf.h"
#include "queues.bpf.h"
#include "ordinary.bpf.h"
#include "dispatch.bpf.h"

/* ---- callbacks, in the order in which a thread meets them --------------------------------- */

SEC("struct_ops/xauto_select_cpu")
s32 BPF_PROG(xauto_select_cpu, struct task_struct *p, s32 prev_cpu, u64 wake_flags)
{
	struct claim mine = {};
	struct xnode_thread t = {};
	bool idle = false, xnode;
	s32 cpu;

	xnode = thread_of(p, &t);
	if (xnode)
		latch(t.job, t.slot);
	/* Not straight to the local queue even if idle: XNode threads get there only by
	 * dispatch(), so that their order is the queue's. Where the thread has a choice, the kernel looks
	 * for an idle CPU at the previous one first, then in its cluster.
	 */
	if (judge(p, xnode ? &t : NULL, &mine) != NO_KEY && place(p, &mine) >= 0)
		return place(p, &mine);
	cpu = scx_bpf_select_cpu_dfl(p, prev_cpu, wake_flags, &idle);
	if (idle && mine.key == NO_KEY && !throttled_until(p, 0, bpf_ktime_get_ns()))
		insert(p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL), ordinary_slice_us * NS_PER_US, 0);
	return cpu;
}

static __always_inline void enqueue_kernel_thread(struct task_struct *p, u64 enq_flags)
{
	u64 slice = SCX_VALUE(scx_public_consts, SCX_SLICE_DFL);
	s32 cpu = scx_bpf_task_cpu(p);
	struct cpu_state *c = state_of(cpu);

	if (c && (c->current >= 0 || scx_bpf_dsq_nr_queued(XNODE_DSQ(cpu)) > 0)) {
		if (kernel_is_over(c)) {
			enqueue_ordinary(p, enq_flags);
			return;
		}
		slice = grant_us * NS_PER_US; /* then it is asked for its credit again */
	}
	/* Only a waking one jumps the queue, and not before its own kind: a kernel thread that spins
	 * alternates with everybody else at the end of its slices.
	 */
	if (c && c->current != CURRENT_KERNEL && (enq_flags & SCX_VALUE(scx_enq_flags, SCX_ENQ_WAKEUP)))
		enq_flags |= SCX_VALUE(scx_enq_flags, SCX_ENQ_HEAD) |
			     SCX_VALUE(scx_enq_flags, SCX_ENQ_PREEMPT);
	insert(p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL), slice, enq_flags);
}

SEC("struct_ops/xauto_enqueue")
void BPF_PROG(xauto_enqueue, struct task_struct *p, u64 enq_flags)
{
	struct claim mine = {};
	struct xnode_thread t = {};
	bool xnode;

	/* Nobody else is there, so the CPU chooses again only if it is told to. */
	if (enq_flags & SCX_VALUE(scx_enq_flags, SCX_ENQ_LAST))
		scx_bpf_kick_cpu(scx_bpf_task_cpu(p), 0);
	xnode = thread_of(p, &t);
	if (xnode) {
		latch(t.job, t.slot);
		end_lending(t.at);
	}
	/* The lock that it is woken for is its own now, and others may wait for that. */
	if (anybody_lends() && p->pi_blocked_on)
		lend_again();
	if (judge(p, xnode ? &t : NULL, &mine) != NO_KEY)
		enqueue_claim(p, &mine, xnode ? t.job : NULL, enq_flags);
	else if (hurries(p))
		enqueue_kernel_thread(p, enq_flags);
	else
		enqueue_ordinary(p, enq_flags);
}

/*
 * The CPU needs a thread. `prev` may be one that is ready but whose slice has ended: it is on no queue
 * yet, so taking the first without comparing would let a less urgent one overtake it. If we move
 * nothing, the kernel lets it go on.
 */
SEC("struct_ops/xauto_dispatch")
void BPF_PROG(xauto_dispatch, s32 cpu, struct task_struct *prev)
{
	struct cpu_state *c = state_of(cpu);
	struct claim first = {}, mine = { .key = NO_KEY };
	struct xnode_thread t = {};
	u64 now = bpf_ktime_get_ns(), slice = xnode_slice_us * NS_PER_US;
	bool fresh = false, goes_on = false, waits, xnode;

	if (!c)
		return;
	c->rekicked = 0;
	if (any_offline() && dispatch_stranded(cpu))
		return;
	if (prev && (prev->scx.flags & SCX_VALUE(scx_ent_flags, SCX_TASK_QUEUED))) {
		xnode = thread_of(prev, &t);
		if (!xnode || key_of(t.job) == NO_KEY)
			goes_on = !charge_ordinary(c, prev, now);
		if (xnode) {
			/* A job that it has told just now did not get the CPU yet: it asks, as
			 * the others do.
			 */
			fresh = latch(t.job, t.slot);
			charge(c, t.job, t.slot, now);
			slice = slice_of(t.job);
		}
		judge(prev, xnode ? &t : NULL, &mine);
	}
	waits = first_of(cpu, &first) != NO_KEY;
	refill(c, now);
	if (!waits && mine.key == NO_KEY) {
		c->woken = 0;
		if (!dispatch_ordinary(c, cpu, now) && goes_on)
			set_slice(prev, ordinary_slice_us * NS_PER_US);
		return;
	}
	if (now >= c->look_at) {
		/* If there is one, there may be more of them. */
		if (dispatch_rescued(cpu) || dispatch_parked(cpu, true)) {
			c->grant = GRANT_RESCUE;
			count(XAUTO_BPF_STAT_FLOOR);
			return;
		}
		c->look_at = now + timeout_ms / 100 * NS_PER_MS;
	}
	if (!c->woken && c->credit_ns >= (s64)(grant_us * NS_PER_US)) {
		if (dispatch_aged(cpu)) {
			c->grant = GRANT_FLOOR;
			count(XAUTO_BPF_STAT_AGED);
			return;
		}
		if (dispatch_ordinary(c, cpu, now)) {
			c->grant = GRANT_FLOOR;
			count(XAUTO_BPF_STAT_FLOOR);
			return;
		}
	}
	c->woken = 0;
	if (prev && mine.key != NO_KEY &&
	    !(waits && (fresh ? XAUTO_RULE_BEFORE(first, mine) : XAUTO_RULE_TAKES(first, mine)))) {
		set_slice(prev, slice);
		count(XAUTO_BPF_STAT_KEPT);
		return;
	}
	/* It may have been taken off the queue meanwhile: then whoever is first. */
	if (!dispatch_thread(cpu, first.tid))
		move_to_local(XNODE_DSQ(cpu));
}

SEC("struct_ops/xauto_running")
void BPF_PROG(xauto_running, struct task_struct *p)
{
	s32 cpu = scx_bpf_task_cpu(p);
	struct cpu_state *c = state_of(cpu);
	bool kernel = hurries(p);
	struct xauto_bpf_slot *slot = NULL;
	struct claim claim = {};
	struct xnode_thread t = {};
	s64 current = kernel ? CURRENT_KERNEL : CURRENT_ORDINARY;
	s64 mine = NO_KEY, waiting;
	bool xnode;

	if (!c)
		return;
	c->began_ns = bpf_ktime_get_ns();
	c->began_run = p->se.sum_exec_runtime;
	xnode = thread_of(p, &t);
	if (xnode) {
		slot = t.slot;
		latch(t.job, slot);
		t.job->queued_ns = 0;
		end_lending(t.at); /* not all who are woken are queued by us */
		mine = key_of(t.job);
		if (mine != NO_KEY)
			current = t.at;
	}
	if (mine == NO_KEY)
		begin_fair(p);

	/* Publish first, then look: whoever was queued while nobody could be preempted is seen here.
	 * A thread that a fair or real-time thread had interrupted comes back this way without
	 * dispatch(), so this is the only place that sees a more urgent one queued meanwhile.
	 */
	c->tid = (u32)p->pid;
	__sync_lock_test_and_set(&c->current, current);
	mine = judge(p, xnode ? &t : NULL, &claim);
	waiting = key_waiting(cpu);
	if (slot)
		slot->waiting = waiting != NO_KEY;
	if (c->grant) {
		c->granted = c->grant;
		c->grant = 0;
		set_slice(p, grant_us * NS_PER_US);
		return;
	}
	if (kernel)
		return;
	if (waiting < mine && !c->rekicked) {
		c->woken = 1;
		c->rekicked = 1;
		count(XAUTO_BPF_STAT_RECHECKED);
		scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_PREEMPT));
	}
}

/* The safety net: a job that became less urgent without yielding, a wake-up that raced, a budget. */
SEC("struct_ops/xauto_tick")
void BPF_PROG(xauto_tick, struct task_struct *p)
{
	s32 cpu = scx_bpf_task_cpu(p);
	struct cpu_state *c = state_of(cpu);
	struct claim claim = {};
	struct xnode_thread t = {};
	s64 mine;
	bool xnode;

	if (!c)
		return;
	see_tick(p);
	if (anybody_lends())
		lend_again();
	if (c->granted || hurries(p))
		return;
	xnode = thread_of(p, &t);
	if (!xnode) {
		mine = judge(p, NULL, &claim);
	} else {
		s64 before = key_of(t.job);

		latch(t.job, t.slot);
		charge(c, t.job, t.slot, bpf_ktime_get_ns());
		mine = judge(p, &t, &claim);
		/* Demoted just now: it must go through a queue to become ordinary. */
		if (before != NO_KEY && mine == NO_KEY) {
			set_slice(p, 0);
			scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_PREEMPT));
			return;
		}
	}
	if (key_waiting(cpu) < mine) {
		c->woken = 1;
		count(XAUTO_BPF_STAT_RECHECKED);
		scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_PREEMPT));
	}
}

SEC("struct_ops/xauto_stopping")
void BPF_PROG(xauto_stopping, struct task_struct *p, bool runnable)
{
	s32 cpu = scx_bpf_task_cpu(p);
	struct cpu_state *c = state_of(cpu);
	u64 now = bpf_ktime_get_ns();
	struct xnode_thread t = {};
	s64 mine = NO_KEY;
	u32 to = 0;

	if (!c)
		return;
	if (thread_of(p, &t)) {
		u64 began = c->began_ns;

		latch(t.job, t.slot);
		charge(c, t.job, t.slot, now);
		mine = key_of(t.job);
		if (mine == NO_KEY)
			c->began_ns = began;
		else if (c->granted)
			c->credit_ns -= (s64)(now - began);
	}
	if (mine == NO_KEY)
		charge_ordinary(c, p, now);
	if (!runnable && p->pi_blocked_on) {
		/* Who lends to it lends to whom it waits for. */
		if (anybody_lends())
			lend_again();
		if (mine != NO_KEY)
			to = begin_lending(t.at, p);
	}
	c->granted = 0;
	c->tid = 0;
	c->current = CURRENT_SWITCHING;
	if (to)
		hurry(to, cpu);
}

SEC("struct_ops/xauto_enable")
void BPF_PROG(xauto_enable, struct task_struct *p)
{
	set_vtime(p, vtime_now);
}

/* Before it has lost its id, which exit_task() comes after. Who was killed has not left its slot. */
SEC("tp_btf/sched_process_exit")
int BPF_PROG(xauto_exited, struct task_struct *p)
{
	struct xauto_bpf_slot *slot;
	u32 at = 0;

	if (slot_of(p, &at)) {
		slot = bpf_map_lookup_elem(&slots, &at);
		if (slot)
			slot->tid = 0;
	}
	forget(p);
	return 0;
}

#include "hotplug.bpf.h"
#include "dump.bpf.h"

SEC("struct_ops.s/xauto_init")
s32 BPF_PROG(xauto_init)
{
	struct xauto_bpf_sched *s = bpf_map_lookup_elem(&sched, &(u32){ 0 });
	const struct cpumask *online;
	struct parked_timer *timer;
	struct bpf_iter_num it;
	s32 error;
	int *i;

	if (!s)
		return -22; /* EINVAL; cannot be: the map has one element */
	error = scx_bpf_create_dsq(FAIR_DSQ, -1);
	if (!error)
		error = scx_bpf_create_dsq(PARKED_DSQ, -1);
	if (error)
		return error;
	timer = bpf_map_lookup_elem(&timers, &(u32){ 0 });
	if (timer) {
		bpf_timer_init(&timer->timer, &timers, 1 /* CLOCK_MONOTONIC */);
		bpf_timer_set_callback(&timer->timer, on_parked_timer);
		bpf_timer_start(&timer->timer, 0, 0);
	}
	online = scx_bpf_get_online_cpumask();
	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_CPUS);
	while ((i = bpf_iter_num_next(&it))) {
		u32 cpu = *i;
		struct cpu_state *c;

		if (cpu >= nr_cpus)
			break;
		c = state_of((s32)cpu);
		if (!c)
			break;
		c->current = CURRENT_SWITCHING;
		c->credit_at = bpf_ktime_get_ns();
		c->credit_ns = (s64)(floor_burst_us * NS_PER_US);
		c->kernel_at = c->credit_at;
		c->kernel_ns = (s64)(kernel_burst_us * NS_PER_US);
		if (!bpf_cpumask_test_cpu(cpu, online)) {
			c->offline = 1;
			offline_cpus++;
		}
		error = scx_bpf_create_dsq(XNODE_DSQ(cpu), -1);
		if (error)
			break;
	}
	bpf_iter_num_destroy(&it);
	scx_bpf_put_cpumask(online);
	if (!error) {
		s->exit_kind = 0; /* of one before us */
		s->mode = mode;
		s->running = 1;
	}
	return error;
}

SEC("struct_ops/xauto_exit")
void BPF_PROG(xauto_exit, struct scx_exit_info *info)
{
	struct xauto_bpf_sched *s = bpf_map_lookup_elem(&sched, &(u32){ 0 });

	if (!s)
		return;
	s->exit_code = info->exit_code;
	bpf_probe_read_kernel_str(s->exit_reason, sizeof(s->exit_reason), info->reason);
	bpf_probe_read_kernel_str(s->exit_msg, sizeof(s->exit_msg), info->msg);
	bpf_probe_read_kernel_str(exit_dump, sizeof(exit_dump), info->dump);
	s->exit_kind = (u32)info->kind;
	s->running = 0;
}

SEC(".struct_ops.link")
struct sched_ext_ops xauto_ops = {
	.select_cpu = (void *)xauto_select_cpu,
	.enqueue = (void *)xauto_enqueue,
	.dispatch = (void *)xauto_dispatch,
	.running = (void *)xauto_running,
	.tick = (void *)xauto_tick,
	.stopping = (void *)xauto_stopping,
	.enable = (void *)xauto_enable,
	.dump = (void *)xauto_dump,
	.dump_cpu = (void *)xauto_dump_cpu,
	.dump_task = (void *)xauto_dump_task,
	.cpu_online = (void *)xauto_cpu_online,
	.cpu_offline = (void *)xauto_cpu_offline,
	.init = (void *)xauto_init,
	.exit = (void *)xauto_exit,
	.flags = SCX_OPS_ENQ_EXITING | SCX_OPS_ENQ_LAST,
	.timeout_ms = 10000,
	.name = "xauto",
};
