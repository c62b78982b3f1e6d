/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Which slot a thread has. Included by scheduler and tracer, after the maps.
 */
#ifndef _XAUTO_THREADS_BPF_H
#define _XAUTO_THREADS_BPF_H

/* PROC_PID_INIT_INO: of the namespace that every other is in. */
#define FIRST_PID_NAMESPACE 0xEFFFFFFCULL

/* The thread's key in the map; 0: it has ended, and has no id any more. */
static __always_inline u64 thread_key(struct task_struct *p)
{
	struct pid *pid = p->thread_pid;
	struct upid own = {};
	u32 level;
	u64 from;

	if (!pid)
		return 0;
	level = pid->level;
	if (!level)
		return FIRST_PID_NAMESPACE << 32 | (u32)p->pid;
	/* As a number: the verifier adds no variable to a pointer. */
	from = (u64)BPF_CORE_READ(p, thread_pid);
	bpf_probe_read_kernel(&own, sizeof(own),
			      (void *)(from + bpf_core_field_offset(struct pid, numbers) +
				       level * sizeof(own)));
	return (u64)BPF_CORE_READ(own.ns, ns.inum) << 32 | (u32)own.nr;
}

/* False: an ordinary thread. Threads enter themselves, so the number may be nonsense. */
static __always_inline bool slot_of(struct task_struct *p, u32 *at)
{
	u64 key = thread_key(p);
	struct thread_entry *entry = bpf_map_lookup_elem(&threads, &key);

	if (!entry || p->start_time > entry->entered_ns)
		return false;
	*at = (u32)entry->slot;
	return true;
}

static __always_inline void forget(struct task_struct *p)
{
	u64 key = thread_key(p);

	bpf_map_delete_elem(&threads, &key);
}

#endif /* _XAUTO_THREADS_BPF_H */
