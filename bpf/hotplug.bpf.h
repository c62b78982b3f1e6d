/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * CPUs that go and come. Included once, by xauto_scx.bpf.c.
 */
#ifndef _XAUTO_HOTPLUG_BPF_H
#define _XAUTO_HOTPLUG_BPF_H

/* Hands what waits for the CPU to the kernel. `all`: not only what may run nowhere else. */
static __always_inline void hand_over(u64 dsq, s32 cpu, bool all)
{
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;

	if (!iterate(&it, dsq))
		goto out;
	while ((p = bpf_iter_scx_dsq_next(&it))) {
		if (bpf_cpumask_test_cpu((u32)cpu, p->cpus_ptr) && (all || p->nr_cpus_allowed == 1))
			move_task(&it, p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL_ON) | (u32)cpu);
	}
out:
	bpf_iter_scx_dsq_destroy(&it);
}

SEC("struct_ops/xauto_cpu_offline")
void BPF_PROG(xauto_cpu_offline, s32 cpu)
{
	struct cpu_state *c = state_of(cpu);

	if (!c || __sync_lock_test_and_set(&c->offline, 1))
		return;
	__sync_fetch_and_add(&offline_cpus, 1);
	hand_over(XNODE_DSQ(cpu), cpu, true);
	hand_over(FAIR_DSQ, cpu, false);
	hand_over(PARKED_DSQ, cpu, false);
}

SEC("struct_ops/xauto_cpu_online")
void BPF_PROG(xauto_cpu_online, s32 cpu)
{
	struct cpu_state *c = state_of(cpu);

	if (c && __sync_lock_test_and_set(&c->offline, 0))
		__sync_fetch_and_add(&offline_cpus, -1);
}

#endif /* _XAUTO_HOTPLUG_BPF_H */
