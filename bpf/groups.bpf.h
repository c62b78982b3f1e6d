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
 *
 * The count is kept with the cgroup by the kernel, so that no number of others makes it be forgotten. We begin
 * at the root's side and end at LIMITED_LEVELS: who may make cgroups makes them below the one that limits
 * them, however deep, and each thread costs the same.
 */
#ifndef _XAUTO_GROUPS_BPF_H
#define _XAUTO_GROUPS_BPF_H

#define LIMITED_LEVELS 16
#define NO_QUOTA (~0ULL) /* the kernel's RUNTIME_INF */

/**
 * struct group_use - a cgroup with a limit
 * @since_ns: begin of its present period
 * @used_ns:  run since then, and before that over the quota
 */
struct group_use {
	u64 since_ns;
	u64 used_ns;
};

struct {
	__uint(type, BPF_MAP_TYPE_CGRP_STORAGE);
	__uint(map_flags, BPF_F_NO_PREALLOC);
	__type(key, int);
	__type(value, struct group_use);
} groups SEC(".maps");

static unsigned long long limited_ns; /* when a cgroup with a limit was last seen */

/* Without CONFIG_CFS_BANDWIDTH there is a struct cfs_bandwidth all the same, an empty one. */
static __always_inline bool has_quotas(void)
{
	return bpf_core_field_exists(((struct task_group *)0)->cfs_bandwidth.quota) &&
	       bpf_core_enum_value_exists(enum cgroup_subsys_id, cpu_cgrp_id) &&
	       bpf_ksym_exists(bpf_cgroup_ancestor);
}

/* Its scheduling group, to be read only; NULL: it has none of its own. */
static __always_inline struct task_group *task_group_of(struct cgroup *group)
{
	u64 at = (u64)group + bpf_core_field_offset(struct cgroup, subsys) +
		 bpf_core_enum_value(enum cgroup_subsys_id, cpu_cgrp_id) * sizeof(void *);
	u64 css = 0;

	bpf_probe_read_kernel(&css, sizeof(css), (void *)at);
	return css ? (struct task_group *)(css - bpf_core_field_offset(struct task_group, css)) : NULL;
}

/* Ends its period if it is over, and charges it for `ran` in the present one. Returns when it may run again; 0: now. */
static __always_inline u64 spent_until(struct group_use *use, u64 quota, u64 period, u64 ran, u64 now)
{
	u64 since, ended, paid, used;

	if (!use->since_ns)
		__sync_val_compare_and_swap(&use->since_ns, 0, now);
	since = use->since_ns;
	if (now > since && now - since >= period) {
		ended = (now - since) / period;
		/* One CPU ends the period. */
		if (__sync_val_compare_and_swap(&use->since_ns, since, since + ended * period) == since) {
			used = use->used_ns;
			paid = ended * quota;
			__sync_fetch_and_add(&use->used_ns, -(paid < used ? paid : used));
		}
	}
	used = __sync_fetch_and_add(&use->used_ns, ran) + ran;
	return used < quota ? 0 : use->since_ns + used / quota * period;
}

/* When all cgroups that the thread is in may run again; 0: now. `ran`: since it was last charged. */
__noinline u64 throttled_until(struct task_struct *p __arg_trusted, u64 ran, u64 now)
{
	struct bpf_iter_num it;
	u64 until = 0;
	int *level;

	/* Here, too: the kernel verifies this function by itself. */
	if (!has_quotas())
		return 0;
	bpf_iter_num_new(&it, 1, LIMITED_LEVELS + 1); /* the root has no limit */
	while ((level = bpf_iter_num_next(&it))) {
		struct css_set *set = p->cgroups;
		struct cgroup *group = set ? bpf_cgroup_ancestor(set->dfl_cgrp, *level) : NULL;
		struct task_group *g;
		struct group_use *use;
		u64 quota, period, then;

		if (!group)
			break;
		g = task_group_of(group);
		quota = g ? BPF_CORE_READ(g, cfs_bandwidth.quota) : NO_QUOTA;
		period = g ? (u64)BPF_CORE_READ(g, cfs_bandwidth.period) : 0;
		if (quota && quota != NO_QUOTA && period) {
			limited_ns = now;
			use = bpf_cgrp_storage_get(&groups, group, 0, BPF_LOCAL_STORAGE_GET_F_CREATE);
			then = use ? spent_until(use, quota, period, ran, now) : 0;
			if (then > until)
				until = then;
		}
		bpf_cgroup_release(group);
	}
	bpf_iter_num_destroy(&it);
	return until;
}

#endif /* _XAUTO_GROUPS_BPF_H */
