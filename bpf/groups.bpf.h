/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * cpu.max of ordinary threads' cgroups: the kernel keeps it in its fair class only, and in full mode there is
 * nobody left. Included once, by xauto_scx.bpf.c.
 *
 * Each limited cgroup has a count of what its threads have run in the present period, which starts when they
 * first run and grows by what they run too long: slices end at ticks, so a turn may go over the quota, and
 * the next periods pay. Who belongs to a cgroup over its quota waits in a queue of its own (PARKED_DSQ)
 * until that period ends. XNode threads are as the policy says, and who was lent a key is for that time.
 * cpu.max.burst is not looked at.
 */
#ifndef _XAUTO_GROUPS_BPF_H
#define _XAUTO_GROUPS_BPF_H

#define DEEPEST_GROUP 8
#define NO_QUOTA (~0ULL) /* the kernel's RUNTIME_INF */

/**
 * struct group_use - a cgroup with a limit, by its task_group's address
 * @since_ns: begin of its present period
 * @used_ns:  run since then, and before that over the quota
 */
struct group_use {
	u64 since_ns;
	u64 used_ns;
};

struct {
	__uint(type, BPF_MAP_TYPE_LRU_HASH);
	__uint(max_entries, 1024);
	__type(key, u64);
	__type(value, struct group_use);
} groups SEC(".maps");

static unsigned long long limited_ns; /* when a cgroup with a limit was last seen */

/* Without CONFIG_CFS_BANDWIDTH there is a struct cfs_bandwidth all the same, an empty one. */
static __always_inline bool has_quotas(void)
{
	return bpf_core_field_exists(((struct task_group *)0)->cfs_bandwidth.quota);
}

/* Charges the group for `ran` and ends its period if it is over: true if it is beyond its quota. */
__noinline int group_is_over(u64 group, u64 ran, u64 now)
{
	struct task_group *g = (struct task_group *)group;
	u64 quota, period, since, ended, paid, used;
	struct group_use fresh = {}, *use;

	/* Here, too: the kernel verifies this function by itself, so what its caller has asked is not known. */
	if (!has_quotas())
		return false;
	quota = BPF_CORE_READ(g, cfs_bandwidth.quota);
	if (quota == NO_QUOTA)
		return false;
	limited_ns = now;
	period = (u64)BPF_CORE_READ(g, cfs_bandwidth.period);
	use = bpf_map_lookup_elem(&groups, &group);
	if (!use) {
		fresh.since_ns = now;
		fresh.used_ns = ran;
		bpf_map_update_elem(&groups, &group, &fresh, BPF_ANY);
		return ran >= quota;
	}
	__sync_fetch_and_add(&use->used_ns, ran);
	since = use->since_ns;
	if (period && now > since && now - since >= period) {
		ended = (now - since) / period;
		/* One CPU ends the period. */
		if (__sync_val_compare_and_swap(&use->since_ns, since, since + ended * period) == since) {
			used = use->used_ns;
			paid = ended * quota;
			__sync_fetch_and_add(&use->used_ns, -(paid < used ? paid : used));
		}
	}
	return use->used_ns >= quota;
}

/* ... of this group and those that it is in. */
__noinline int groups_are_over(u64 group, u64 ran, u64 now)
{
	bool over = false;
	int i;

	if (!has_quotas())
		return false;
	for (i = 0; i < DEEPEST_GROUP && group; i++) {
		if (group_is_over(group, ran, now))
			over = true;
		group = (u64)BPF_CORE_READ((struct task_group *)group, parent);
	}
	return over;
}

/* `ran`: since it was last charged. */
static __always_inline bool is_throttled(struct task_struct *p, u64 ran, u64 now)
{
	if (!bpf_core_field_exists(p->sched_task_group) || !has_quotas())
		return false;
	return groups_are_over((u64)BPF_CORE_READ(p, sched_task_group), ran, now);
}

#endif /* _XAUTO_GROUPS_BPF_H */
