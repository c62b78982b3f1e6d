// SPDX-License-Identifier: GPL-2.0-only
/*
 * The tracer (trace.bpf.h) on a kernel with BTF, whoever schedules: it finds a thread by its task_struct, in
 * containers, too.
 */
#include "kernel.bpf.h"
#include <bpf/bpf_helpers.h>
#include <bpf/bpf_tracing.h>
#include <bpf/bpf_core_read.h>
#include "trace.bpf.h"
#include "threads.bpf.h"

static __always_inline struct who who(struct task_struct *p)
{
	struct who who = { .tid = p->pid, .comm = p->comm };

	who.ours = slot_of(p, &who.at);
	return who;
}

SEC("tp_btf/sched_switch")
int BPF_PROG(xauto_switch, bool preempt, struct task_struct *prev, struct task_struct *next)
{
	struct who from = who(prev), to = who(next);
	bool ready = preempt;

	if (from.ours && !ready) {
		if (bpf_core_field_exists(prev->__state))
			ready = prev->__state == 0;
		else
			ready = BPF_CORE_READ((struct task_struct___old *)prev, state) == 0;
	}
	on_switch(ctx, &from, ready, &to);
	return 0;
}

SEC("tp_btf/sched_wakeup")
int BPF_PROG(xauto_wakeup, struct task_struct *p)
{
	u32 at = 0;

	if (slot_of(p, &at))
		on_wakeup(ctx, p->pid, at);
	return 0;
}

SEC("tp_btf/sched_migrate_task")
int BPF_PROG(xauto_migrate, struct task_struct *p, int to)
{
	u32 at = 0;

	/* The CPU that it leaves is in a place that differs between kernels; the previous RUN has it. */
	if (slot_of(p, &at))
		on_migrate(ctx, p->pid, at, to);
	return 0;
}

SEC("tp_btf/sched_process_exit")
int BPF_PROG(xauto_exit, struct task_struct *p)
{
	forget(p);
	return 0;
}
