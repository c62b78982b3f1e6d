/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * The queues of XNode threads: who is first, and what happens when somebody joins one. Included once, by
 * xauto_scx.bpf.c.
 */
#ifndef _XAUTO_QUEUES_BPF_H
#define _XAUTO_QUEUES_BPF_H

/* The queue that the thread waits in; 0: none. */
static __always_inline u64 queue_of(struct task_struct *p)
{
	return BPF_CORE_READ(p, scx.dsq, id);
}

static __always_inline bool is_ordinary_queue(u64 dsq)
{
	return dsq == FAIR_DSQ || dsq == PARKED_DSQ;
}

/* To be destroyed also when it fails. */
static __always_inline bool iterate(struct bpf_iter_scx_dsq *it, u64 dsq)
{
	if (!bpf_iter_scx_dsq_new(it, dsq, 0))
		return true;
	scx_bpf_error("there is no queue %llx", dsq); /* xauto_init() made them */
	return false;
}

/*
 * The first by the rule of the CPU's queue: its key, NO_KEY if the queue is empty. That is the head,
 * unless equal keys were queued in another order than they asked, or a thread further back was told
 * another job while it waited: it was queued by the key of the old one, so the present words are what
 * counts. Queues are as long as a CPU has XNode threads.
 */
__noinline s64 first_queued(s32 cpu, struct claim *first)
{
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;

	if (!first)
		return NO_KEY;
	first->key = NO_KEY;
	if (!iterate(&it, XNODE_DSQ(cpu)))
		goto out;
	while ((p = bpf_iter_scx_dsq_next(&it))) {
		struct claim c = { .key = NO_KEY, .slot = -1 };
		struct xnode_thread t = {};

		if (thread_of(p, &t))
			claim_of(t.at, &c);
		borrow((u32)p->pid, &c);
		if (c.key == NO_KEY)
			c.key = LAST_KEY; /* it became ordinary here, and has to leave */
		if (first->key != NO_KEY && !XAUTO_RULE_BEFORE(c, *first))
			continue;
		*first = c;
		first->tid = p->pid;
	}
out:
	bpf_iter_scx_dsq_destroy(&it);
	return first->key;
}

/*
 * Before that, ordinary threads that were queued before anything was lent to them. Found by who lends: there
 * are few of those, and any user can fill the queues of ordinary threads.
 */
__noinline s64 first_lent(s32 cpu, struct claim *first)
{
	struct xauto_bpf_head *h = bpf_map_lookup_elem(&head, &(u32){ 0 });
	struct bpf_iter_num it;
	int *i;

	if (!first)
		return NO_KEY;
	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_SLOTS);
	while ((i = bpf_iter_num_next(&it))) {
		struct claim c = { .key = NO_KEY, .slot = -1 };
		struct task_struct *p;
		u32 who;

		if (!h || *i >= (int)h->slots)
			break;
		who = borrower((u32)*i);
		if (!who)
			continue;
		borrow(who, &c);
		if (c.key == NO_KEY || !XAUTO_RULE_BEFORE(c, *first))
			continue;
		p = bpf_task_from_pid((s32)who);
		if (!p)
			continue;
		if (is_ordinary_queue(queue_of(p)) && home_of(p, &c) == cpu) {
			*first = c;
			first->tid = (s32)who;
		}
		bpf_task_release(p);
	}
	bpf_iter_num_destroy(&it);
	return first->key;
}

static __always_inline s64 first_of(s32 cpu, struct claim *first)
{
	s64 key = first_queued(cpu, first);

	return anybody_lends() ? first_lent(cpu, first) : key;
}

__noinline s64 key_waiting(s32 cpu)
{
	struct claim first = {};

	return first_of(cpu, &first);
}

/*
 * A key's place in the kernel's queue, which compares modulo 2^64: keys are less than 2^62 apart, so their
 * order is the queue's. All are moved into the past of the fair queue, whose vtime begins at 0: a thread
 * that is no XNode thread any more comes with its last one, and begins there as one that has slept long.
 */
static __always_inline u64 vtime_of_key(s64 key)
{
	return (u64)key - 4 * KEY_LIMIT;
}

/* Somebody with that claim waits for the CPU. */
static __always_inline void ask_for(s32 cpu, const struct claim *mine)
{
	struct claim running = { .key = NO_KEY };
	struct cpu_state *c = state_of(cpu);
	s64 current;

	if (!c)
		return;
	current = *(volatile s64 *)&c->current;
	if (current == CURRENT_SWITCHING) {
		/* Wakes it if it is idle. If it is not, running() or tick() will look at the queue. */
		scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_IDLE));
		return;
	}
	if (current == CURRENT_KERNEL)
		return; /* it is short, and dispatch() follows it */
	if (current >= 0) {
		struct xnode_thread t = {};

		/* Its worker looks at `waiting` after storing a new job, we at the job after storing
		 * `waiting`: one of the two sees the other. The exchange is the barrier between.
		 */
		if (thread_at((u32)current, &t))
			__sync_lock_test_and_set(&t.slot->waiting, 1);
		claim_of((u32)current, &running);
	}
	borrow(c->tid, &running);
	if (!XAUTO_RULE_TAKES(*mine, running))
		return;
	count(XAUTO_BPF_STAT_KICKED);
	scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_PREEMPT));
}

/* By its claim. `job`: NULL if it is no XNode's thread and runs by what is lent to it. */
static __always_inline void enqueue_claim(struct task_struct *p, const struct claim *mine,
					  struct xauto_bpf_job *job, u64 enq_flags)
{
	s32 cpu = place(p, mine);
	struct cpu_state *c;

	if (cpu < 0) {
		cpu = home_of(p, mine);
		count(XAUTO_BPF_STAT_MISPLACED);
	}
	if (job)
		job->queued_ns = bpf_ktime_get_ns();
	insert_vtime(p, XNODE_DSQ(cpu), job ? slice_of(job) : xnode_slice_us * NS_PER_US,
		     vtime_of_key(mine->key), enq_flags);
	count(XAUTO_BPF_STAT_QUEUED);
	c = state_of(cpu);
	if (c && (enq_flags & SCX_VALUE(scx_enq_flags, SCX_ENQ_WAKEUP)))
		c->woken = 1;
	ask_for(cpu, mine);
}

/* Of another thread, which holds what an XNode thread has just gone to sleep for. */
static __always_inline void hurry(u32 pid, s32 here)
{
	struct claim c = { .key = NO_KEY };
	struct task_struct *p;
	struct cpu_state *there;
	struct xnode_thread t = {};
	s32 cpu;

	p = bpf_task_from_pid((s32)pid);
	if (!p)
		return;
	if (thread_of(p, &t))
		claim_of(t.at, &c);
	borrow(pid, &c);
	cpu = home_of(p, &c);
	there = state_of(cpu);
	/* Here dispatch() follows. Where it runs, it goes on. */
	if (c.key != NO_KEY && cpu != here && there && there->tid != pid) {
		there->woken = 1;
		ask_for(cpu, &c);
	}
	bpf_task_release(p);
}

#endif /* _XAUTO_QUEUES_BPF_H */
