/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * By what claim a thread runs, and on which CPU. Included once, by xauto_scx.bpf.c.
 */
#ifndef _XAUTO_PLACES_BPF_H
#define _XAUTO_PLACES_BPF_H

/* What is lent to it included. `t`: its slot; NULL: it is no XNode's. */
static __always_inline s64 judge(struct task_struct *p, const struct xnode_thread *t, struct claim *c)
{
	c->key = NO_KEY;
	if (t && key_of(t->job) != NO_KEY) {
		c->key = t->job->key;
		c->since_ns = t->job->since_ns;
		c->slot = (s32)t->at;
		c->cpu = t->job->cpu;
	}
	c->tid = p->pid;
	borrow((u32)p->pid, c);
	return c->key;
}

/* Where a thread with a claim runs; -1: that CPU is forbidden to it or is away, it runs elsewhere. */
static __always_inline s32 place(struct task_struct *p, const struct claim *c)
{
	s32 cpu = (s32)c->cpu;

	if (!bpf_cpumask_test_cpu(c->cpu, p->cpus_ptr) || (any_offline() && is_offline(cpu)))
		return -1;
	return cpu;
}

static __always_inline bool is_near(u32 a, u32 b)
{
	return cluster_of[a % XAUTO_BPF_MAX_CPUS] == cluster_of[b % XAUTO_BPF_MAX_CPUS];
}

/* One that shares a cache with the policy's CPU, if there is such a one. */
static __always_inline s32 home_of(struct task_struct *p, const struct claim *c)
{
	s32 cpu = place(p, c), first = -1;
	struct bpf_iter_num it;
	int *i;

	if (cpu >= 0)
		return cpu;
	if (!any_offline())
		return (s32)bpf_cpumask_first(p->cpus_ptr);
	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_CPUS);
	while ((i = bpf_iter_num_next(&it))) {
		bool near = is_near((u32)*i, c->cpu);

		if (*i >= (int)nr_cpus)
			break;
		if ((first >= 0 && !near) || !bpf_cpumask_test_cpu((u32)*i, p->cpus_ptr) || is_offline(*i))
			continue;
		first = *i;
		if (near)
			break;
	}
	bpf_iter_num_destroy(&it);
	return first >= 0 ? first : (s32)bpf_cpumask_first(p->cpus_ptr);
}

#endif /* _XAUTO_PLACES_BPF_H */
