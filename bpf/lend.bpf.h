/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Who holds a lock that an XNode thread waits for runs with that one's key. Included once, by
 * xauto_scx.bpf.c, after jobs.bpf.h.
 *
 * To the kernel all threads of sched_ext are equally urgent: its priority inheritance boosts none of them
 * for another. But it keeps the books that we need, for every rt_mutex and thus for every futex with
 * priority inheritance (PTHREAD_PRIO_INHERIT, lib/base/pi_mutex.h): a waiting thread names its lock, the
 * lock its owner.
 *
 *   thread --pi_blocked_on--> waiter --lock--> rt_mutex --owner--> thread --pi_blocked_on--> ...
 *
 * When an XNode thread goes to sleep for a lock, we follow that to the thread that has to run, which may
 * wait for nothing or may be an ordinary one. It then is judged by the more urgent of its own claim and
 * those of all who wait for it (borrow()). An XNode's thread stays on its own CPU; an ordinary one comes
 * to the CPU of who lends to it, if it may. What is lent ends when the lender is woken.
 *
 * A lock that its owner has given up belongs to nobody until the woken waiter runs. It is then the first
 * of the queue that has to. The kernel serves waiters of sched_ext in the order in which they came.
 *
 * The books are read without the kernel's locks, so a lender may be entered for somebody who has just
 * given the lock away. Whoever is woken for a lock, goes to sleep for one with a borrowed key, and every
 * tick while anybody waits, look again.
 */
#ifndef _XAUTO_LEND_BPF_H
#define _XAUTO_LEND_BPF_H

#define LONGEST_CHAIN 8

/**
 * struct lender - an XNode thread that sleeps for a lock, by its slot
 * @thread: its task_struct, to be read only; 0: it does not wait
 * @to:     the thread that has to run, by the kernel's own id; 0: nobody
 */
struct lender {
	u64 thread;
	u32 to;
	u32 pad;
};

struct {
	__uint(type, BPF_MAP_TYPE_ARRAY);
	__uint(max_entries, XAUTO_BPF_MAX_SLOTS);
	__type(key, u32);
	__type(value, struct lender);
} lenders SEC(".maps");

/* A thread by the kernel's own id: slot of the most urgent that lends to it. */
struct {
	__uint(type, BPF_MAP_TYPE_HASH);
	__uint(max_entries, XAUTO_BPF_MAX_SLOTS);
	__type(key, u32);
	__type(value, u32);
} lent SEC(".maps");

static unsigned int lending; /* how many lenders there are */

static __always_inline bool anybody_lends(void)
{
	return *(volatile unsigned int *)&lending;
}

/* Whom the thread at address `from` waits for, over all locks between; 0: nobody. */
__noinline u32 last_holder(u64 from)
{
	u64 at = from;
	int i;

	for (i = 0; i < LONGEST_CHAIN; i++) {
		struct rt_mutex_waiter *waiter = BPF_CORE_READ((struct task_struct *)at, pi_blocked_on);
		struct rt_mutex_base *lock;
		u64 owner;

		if (!waiter)
			break;
		lock = BPF_CORE_READ(waiter, lock);
		if (!lock)
			break;
		owner = (u64)BPF_CORE_READ(lock, owner) & ~1ULL; /* RT_MUTEX_HAS_WAITERS */
		if (!owner) {
			u64 first = (u64)BPF_CORE_READ(lock, waiters.rb_leftmost);

			if (!first)
				break;
			first -= bpf_core_field_offset(struct rt_mutex_waiter, tree.entry);
			owner = (u64)BPF_CORE_READ((struct rt_mutex_waiter *)first, task);
		}
		if (!owner || owner == at)
			break;
		at = owner;
	}
	return at == from ? 0 : (u32)BPF_CORE_READ((struct task_struct *)at, pid);
}

/* Finds whom the lender of slot `at` lends to, and enters it there if it is the most urgent. */
__noinline int lend(u32 at)
{
	struct lender *l = bpf_map_lookup_elem(&lenders, &at), *other;
	struct claim mine = {}, best = {};
	u32 to, *now;

	if (!l || !l->thread)
		return 0;
	to = last_holder(l->thread);
	l->to = to;
	if (!to)
		return 0;
	now = bpf_map_lookup_elem(&lent, &to);
	if (now && *now != at) {
		other = bpf_map_lookup_elem(&lenders, now);
		if (other && other->thread && other->to == to && claim_of(at, &mine) != NO_KEY &&
		    claim_of(*now, &best) != NO_KEY && !XAUTO_RULE_BEFORE(mine, best))
			return (int)to;
	}
	bpf_map_update_elem(&lent, &to, &at, BPF_ANY);
	return (int)to;
}

/* All of them look again. */
__noinline int lend_again(void)
{
	struct xauto_bpf_head *h = bpf_map_lookup_elem(&head, &(u32){ 0 });
	struct bpf_iter_num it;
	int *i;

	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_SLOTS);
	while ((i = bpf_iter_num_next(&it))) {
		if (!h || *i >= (int)h->slots)
			break;
		lend((u32)*i);
	}
	bpf_iter_num_destroy(&it);
	return 0;
}

/* The thread of slot `at` has gone to sleep for a lock. Returns who has to run; 0: nobody. */
static __always_inline u32 begin_lending(u32 at, struct task_struct *p)
{
	struct lender *l = bpf_map_lookup_elem(&lenders, &at);

	if (!l)
		return 0;
	if (!__sync_lock_test_and_set(&l->thread, (u64)p))
		__sync_fetch_and_add(&lending, 1);
	return (u32)lend(at);
}

/* Whom slot `at` lends to; 0: nobody. */
static __always_inline u32 borrower(u32 at)
{
	struct lender *l = bpf_map_lookup_elem(&lenders, &at);

	return l && l->thread ? l->to : 0;
}

/* It is awake. */
static __always_inline void end_lending(u32 at)
{
	struct lender *l = bpf_map_lookup_elem(&lenders, &at);
	u32 to, *now;

	if (!l || !l->thread || !__sync_lock_test_and_set(&l->thread, 0))
		return;
	to = l->to;
	l->to = 0;
	now = bpf_map_lookup_elem(&lent, &to);
	if (now && *now == at)
		bpf_map_delete_elem(&lent, &to);
	__sync_fetch_and_add(&lending, -1);
	if (anybody_lends())
		lend_again();
}

__noinline s64 borrow_from(u32 pid, struct claim *c)
{
	struct claim best = {};
	struct lender *l;
	u32 *from;

	if (!c)
		return NO_KEY;
	from = bpf_map_lookup_elem(&lent, &pid);
	if (!from)
		return c->key;
	l = bpf_map_lookup_elem(&lenders, from);
	if (!l || !l->thread || l->to != pid || claim_of(*from, &best) >= c->key)
		return c->key;
	if (c->key == NO_KEY)
		c->cpu = best.cpu;
	c->key = best.key;
	c->since_ns = best.since_ns;
	c->slot = best.slot;
	return c->key;
}

/* Lowers `c` to what is lent to the thread, if that is more urgent. */
static __always_inline void borrow(u32 pid, struct claim *c)
{
	if (anybody_lends())
		borrow_from(pid, c);
}

#endif /* _XAUTO_LEND_BPF_H */
