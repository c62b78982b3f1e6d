// SPDX-License-Identifier: GPL-2.0-only
/*
 * The tracer (trace.bpf.h) on a kernel that has bpf(2) and no BTF, as L4T 36's. It reads the records of the
 * tracepoints, where the kernel's own `format` files say that things are; nothing of a task_struct, whose
 * layout nobody tells. So it knows a thread by its number in the first PID namespace alone, and those of
 * a container are not seen.
 */
#include "kernel.bpf.h"
#include <bpf/bpf_helpers.h>
#include "trace.bpf.h"

#define FIRST_PID_NAMESPACE 0xEFFFFFFCULL /* PROC_PID_INIT_INO */

/* Offsets in the records, in bytes; the loader reads and checks them. Numbers of threads and CPUs have 4. */
const volatile unsigned int prev_pid_at = 0, prev_state_at = 0, next_pid_at = 0, next_comm_at = 0;
const volatile unsigned int woken_pid_at = 0, moved_pid_at = 0, moved_cpu_at = 0, ended_pid_at = 0;
const volatile bool prev_state_is_long = true;

static __always_inline u32 number_at(void *ctx, u32 at)
{
	u32 number = 0;

	bpf_probe_read_kernel(&number, sizeof(number), ctx + at);
	return number;
}

static __always_inline u64 key_of(u32 tid)
{
	return FIRST_PID_NAMESPACE << 32 | tid;
}

/* Ids are used again: then the slot's thread is another one. */
static __always_inline bool slot_of(u32 tid, u32 *at)
{
	u64 key = key_of(tid);
	struct thread_entry *entry = bpf_map_lookup_elem(&threads, &key);
	struct xauto_bpf_slot *slot;

	if (!entry)
		return false;
	*at = (u32)entry->slot;
	slot = bpf_map_lookup_elem(&slots, at);
	return slot && slot->tid == tid;
}

static __always_inline struct who who(void *ctx, u32 pid_at)
{
	struct who who = { .tid = number_at(ctx, pid_at), .comm = ctx + next_comm_at };

	who.ours = slot_of(who.tid, &who.at);
	return who;
}

/* The states' letters end below that bit of prev_state, which says that the thread was preempted. */
#define ASLEEP 0xff

SEC("tracepoint/sched/sched_switch")
int xauto_switch(void *ctx)
{
	struct who from = who(ctx, prev_pid_at), to = who(ctx, next_pid_at);
	u64 state = 0;

	if (from.ours) {
		if (prev_state_is_long)
			bpf_probe_read_kernel(&state, 8, ctx + prev_state_at);
		else
			state = number_at(ctx, prev_state_at);
	}
	on_switch(ctx, &from, !(state & ASLEEP), &to);
	return 0;
}

SEC("tracepoint/sched/sched_wakeup")
int xauto_wakeup(void *ctx)
{
	u32 tid = number_at(ctx, woken_pid_at), at = 0;

	if (slot_of(tid, &at))
		on_wakeup(ctx, tid, at);
	return 0;
}

SEC("tracepoint/sched/sched_migrate_task")
int xauto_migrate(void *ctx)
{
	u32 tid = number_at(ctx, moved_pid_at), at = 0;

	if (slot_of(tid, &at))
		on_migrate(ctx, tid, at, number_at(ctx, moved_cpu_at));
	return 0;
}

SEC("tracepoint/sched/sched_process_exit")
int xauto_exit(void *ctx)
{
	u64 key = key_of(number_at(ctx, ended_pid_at));

	bpf_map_delete_elem(&threads, &key);
	return 0;
}
