/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What a CPU that has to choose may take: one that has waited, a certain one, one whose own CPU has gone.
 * ordinary.bpf.h has the same of ordinary threads. Included once, by xauto_scx.bpf.c.
 */
#ifndef _XAUTO_DISPATCH_BPF_H
#define _XAUTO_DISPATCH_BPF_H

/* An XNode thread of the queue that has waited for age_ms gets a turn: true if there is one. */
__noinline int dispatch_aged(s32 cpu)
{
	u64 now = bpf_ktime_get_ns(), age = age_ms * NS_PER_MS;
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;
	bool moved = false;

	if (!iterate(&it, XNODE_DSQ(cpu)))
		goto out;
	while ((p = bpf_iter_scx_dsq_next(&it))) {
		struct xnode_thread t = {};

		/* Who has no slot was lent a key, or has left: the floor is for such a one. */
		if (thread_of(p, &t) && (!t.job->queued_ns || (s64)(now - t.job->queued_ns) < (s64)age))
			continue;
		moved = move_task(&it, p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL));
		if (moved)
			break;
	}
out:
	bpf_iter_scx_dsq_destroy(&it);
	return moved;
}

/* Nothing is looked for: the kernel sees whether it is still in that queue. */
__noinline int dispatch_thread(s32 cpu, s32 who)
{
	struct task_struct *p = bpf_task_from_pid(who);
	struct bpf_iter_scx_dsq it;
	bool moved = false;
	u64 dsq;

	if (!p)
		return false;
	dsq = queue_of(p);
	if (dsq == XNODE_DSQ(cpu) || is_ordinary_queue(dsq)) {
		if (iterate(&it, dsq))
			moved = move_task(&it, p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL));
		bpf_iter_scx_dsq_destroy(&it);
	}
	bpf_task_release(p);
	return moved;
}

/* What was put into the queue of a CPU that had just gone: true if there is one. */
__noinline int dispatch_stranded(s32 here)
{
	struct bpf_iter_num it;
	bool moved = false;
	int *i;

	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_CPUS);
	while ((i = bpf_iter_num_next(&it))) {
		if (*i >= (int)nr_cpus)
			break;
		if (*i == here || !is_offline(*i) || scx_bpf_dsq_nr_queued(XNODE_DSQ(*i)) <= 0)
			continue;
		moved = move_to_local(XNODE_DSQ(*i));
		if (moved)
			break;
	}
	bpf_iter_num_destroy(&it);
	return moved;
}

#endif /* _XAUTO_DISPATCH_BPF_H */
