/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What a thread is charged for its time, and how long it may go on; the credits of the floor and of kernel
 * threads. Included once, by xauto_scx.bpf.c.
 */
#ifndef _XAUTO_TIMES_BPF_H
#define _XAUTO_TIMES_BPF_H

/* Charges the running thread for its time since began_ns, and demotes its job when over budget. */
static __always_inline void charge(struct cpu_state *c, struct xauto_bpf_job *job,
				   struct xauto_bpf_slot *slot, u64 now)
{
	u64 from = c->began_ns;
	u64 since = slot->since_ns;

	/* Time before the job's beginning was the previous job's. */
	if (since > from && since < now)
		from = since;
	if (now > from)
		job->used_ns += now - from;
	c->began_ns = now;
	if (job->budget_ns && job->used_ns > job->budget_ns && !(job->flags & XAUTO_BPF_JOB_DEMOTED) &&
	    !(slot->job & XAUTO_BPF_JOB_ENDED)) {
		job->flags |= XAUTO_BPF_JOB_DEMOTED;
		count(XAUTO_BPF_STAT_DEMOTED);
	}
}

/* A kernel thread that others may wait for; 100 is the weight of nice 0. */
static __always_inline bool hurries(const struct task_struct *p)
{
	return (p->flags & PF_KTHREAD) && p->scx.weight >= 100;
}

/* The same of an ordinary thread: of its fair share, its cgroups, and of the floor's credit. */
static __always_inline bool charge_ordinary(struct cpu_state *c, struct task_struct *p, u64 now)
{
	u64 ran = p->se.sum_exec_runtime - c->began_run;

	c->began_ns = now;
	c->began_run += ran;
	set_vtime(p, p->scx.dsq_vtime + ran * 100 / (p->scx.weight ?: 100));
	if (c->granted)
		c->credit_ns -= (s64)ran;
	if (c->granted == GRANT_RESCUE && c->look_at < now + RESCUE_REST * ran)
		c->look_at = now + RESCUE_REST * ran;
	if (p->flags & PF_KTHREAD) {
		if (hurries(p))
			c->kernel_ns -= (s64)ran;
		return false;
	}
	return throttled_until(p, ran, now) != 0;
}

static __always_inline u64 slice_of(const struct xauto_bpf_job *job)
{
	u64 slice = xnode_slice_us * NS_PER_US;

	if (job->budget_ns > job->used_ns && job->budget_ns - job->used_ns < slice)
		slice = job->budget_ns - job->used_ns;
	return slice;
}

/* By several CPUs at once a little of the refill is lost or given twice: let's live with it. */
static __always_inline bool kernel_is_over(struct cpu_state *c)
{
	s64 most = (s64)(kernel_burst_us * NS_PER_US);
	u64 now = bpf_ktime_get_ns();

	if (now > c->kernel_at)
		c->kernel_ns += (s64)((now - c->kernel_at) * kernel_permille / 1000);
	c->kernel_at = now;
	if (c->kernel_ns > most)
		c->kernel_ns = most;
	if (c->kernel_ns < -most) /* from when no XNode wanted the CPU */
		c->kernel_ns = -most;
	return c->kernel_ns < 0;
}

/* The floor's. */
static __always_inline void refill(struct cpu_state *c, u64 now)
{
	s64 most = (s64)(floor_burst_us * NS_PER_US);

	c->credit_ns += (s64)((now - c->credit_at) * floor_permille / 1000);
	if (c->credit_ns > most)
		c->credit_ns = most;
	c->credit_at = now;
}

#endif /* _XAUTO_TIMES_BPF_H */
