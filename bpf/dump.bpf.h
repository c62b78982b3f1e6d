/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What the kernel's own dump of an error does not know. Included once, by xauto_scx.bpf.c.
 */
#ifndef _XAUTO_DUMP_BPF_H
#define _XAUTO_DUMP_BPF_H

SEC("struct_ops/xauto_dump")
void BPF_PROG(xauto_dump, struct scx_dump_ctx *dump)
{
	scx_bpf_dump("xauto: mode %llu, %llu ordinary, %llu parked, %llu lend\n", mode,
		     (u64)scx_bpf_dsq_nr_queued(FAIR_DSQ), (u64)scx_bpf_dsq_nr_queued(PARKED_DSQ), lending);
}

SEC("struct_ops/xauto_dump_cpu")
void BPF_PROG(xauto_dump_cpu, struct scx_dump_ctx *dump, s32 cpu, bool idle)
{
	struct cpu_state *c = bpf_map_lookup_elem(&cpu_states, &cpu);

	if (c && !idle)
		scx_bpf_dump("xauto: current %lld, %llu wait by key, credit %lld ns, offline %llu\n", c->current,
			     (u64)scx_bpf_dsq_nr_queued(XNODE_DSQ(cpu)), c->credit_ns, c->offline);
}

SEC("struct_ops/xauto_dump_task")
void BPF_PROG(xauto_dump_task, struct scx_dump_ctx *dump, struct task_struct *p)
{
	struct claim c = { .key = NO_KEY };
	struct xnode_thread t = {};

	if (thread_of(p, &t))
		scx_bpf_dump("xauto: slot %llu, XNode %lld, key %lld, ran %llu ns\n", t.at,
			     (s64)(t.job->job >> XAUTO_BPF_JOB_SHIFT) - 1, t.job->key, t.job->used_ns);
	borrow((u32)p->pid, &c);
	if (c.key != NO_KEY)
		scx_bpf_dump("xauto: runs by key %lld of slot %lld, lent\n", c.key, c.slot);
}

#endif /* _XAUTO_DUMP_BPF_H */
