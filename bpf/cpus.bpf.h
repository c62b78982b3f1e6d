/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What we know of each CPU: who runs there, its credits, and whether it is there at all. Included once, by
 * xauto_scx.bpf.c.
 */
#ifndef _XAUTO_CPUS_BPF_H
#define _XAUTO_CPUS_BPF_H

/* cpu_state.current, besides a slot's number */
#define CURRENT_SWITCHING (-1) /* between two threads, or idle: nobody to preempt */
#define CURRENT_KERNEL (-2)
#define CURRENT_ORDINARY (-3)

/* cpu_state.grant: 0, on the floor's credit, or since it has waited for long */
#define GRANT_FLOOR 1
#define GRANT_RESCUE 2
#define RESCUE_REST 3 /* so long, in turns, the CPU is XNode threads' after a rescue */

/**
 * struct cpu_state - one CPU, written by it alone except @woken
 * @current:   who runs: a slot, or CURRENT_*. Never "nobody, no key" between two threads: whoever
 *             wakes then would kick, and kick again, and the CPU would do nothing else
 * @tid:       the thread that runs, by the kernel's own id; written before @current
 * @offline:   it is about to go, or has gone; written by whoever takes it away
 * @look_at:   when to look for ordinary threads that have waited too long
 * @parked_at: when to look again for parked threads that may go on
 * @kernel_ns: credit of kernel threads
 * @kernel_at: when it was last refilled
 * @credit_ns: of the floor; negative after a turn that a late tick made longer
 * @credit_at: when it was last refilled
 * @began_ns:  when @current began, or was last accounted
 * @began_run: what the kernel had counted for it then. An ordinary thread is charged by that: it has in it
 *             what passes in the kernel before running(), and not what a hypervisor took
 * @grant:     the thread chosen last is to run before XNode threads, GRANT_*; stopping() of its
 *             predecessor comes between that choice and its running()
 * @granted:   the thread that runs does so
 * @woken:     an XNode thread woke up since the last choice: it goes before the floor
 * @rekicked:  running() has kicked since the last dispatch(). The kernel puts some threads (exiting,
 *             unable to migrate) straight back on the local queue without asking us; kicking such a
 *             one again would go on for ever, and it would never get to its end
 */
struct cpu_state {
	s64 current;
	s64 credit_ns;
	u64 credit_at;
	u64 began_ns;
	u64 began_run;
	u32 grant;
	u32 granted;
	u32 woken;
	u32 rekicked;
	u32 tid;
	u32 offline;
	u64 look_at;
	u64 parked_at;
	s64 kernel_ns;
	u64 kernel_at;
};

struct {
	__uint(type, BPF_MAP_TYPE_ARRAY);
	__uint(max_entries, XAUTO_BPF_MAX_CPUS);
	__type(key, u32);
	__type(value, struct cpu_state);
} cpu_states SEC(".maps");

static unsigned int offline_cpus; /* how many */

static __always_inline bool any_offline(void)
{
	return *(volatile unsigned int *)&offline_cpus;
}

static __always_inline struct cpu_state *state_of(s32 cpu)
{
	struct cpu_state *c = bpf_map_lookup_elem(&cpu_states, &cpu);

	if (!c) /* the loader refuses a machine with more CPUs */
		scx_bpf_error("CPU %d has no state", cpu);
	return c;
}

static __always_inline bool is_offline(s32 cpu)
{
	struct cpu_state *c = state_of(cpu);

	return c && *(volatile u32 *)&c->offline;
}

#endif /* _XAUTO_CPUS_BPF_H */
