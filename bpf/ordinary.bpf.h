/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Threads that are no XNode's: the fair queue, who is parked, who has waited for too long. Included once, by
 * xauto_scx.bpf.c.
 *
 * Any user fills these queues, so a look sees LOOK threads at most. Why nobody starves of that:
 *
 * The fair queue is ordered by virtual time (vtime), weighted by nice. Who is put in is at most SLEPT_NS behind
 * vtime_now and AHEAD_NS before it, and vtime_now goes on by 1 / AGING of time whoever runs. So after (SLEPT_NS +
 * AHEAD_NS) * AGING = 2.1 s nobody new comes before a thread that waits, and those who are before it leave at
 * their first turn. The first of the queue then have waited for all but 2.1 s of what anybody has: it is enough
 * to ask them who is to be rescued. (Where there are more than AGING runnable threads for each CPU, nice means
 * less and less.)
 *
 * The queue of those who are parked is ordered by when to look at them again: their cgroup's period ends, or
 * they have waited for half of the watchdog's limit. Each look at one that is due ends with it leaving, or going
 * back to a later place. So nobody hides those behind it: a crowd makes them wait for one look, 2 ms, for each
 * LOOK of its threads.
 */
#ifndef _XAUTO_ORDINARY_BPF_H
#define _XAUTO_ORDINARY_BPF_H

#define LOOK 16
#define AGING 20
#define SLEPT_NS ((u64)ordinary_slice_us * NS_PER_US)
#define AHEAD_NS (20 * SLEPT_NS)
#define PARKED_LOOK_NS (2 * NS_PER_MS)
#define PARKED_LATE_NS ((u64)timeout_ms / 2 * NS_PER_MS)

static unsigned long long vtime_now; /* of the fair queue */
static unsigned long long aged_at; /* when vtime_now was last made to go on */

/*
 * Whether the kernel lets us move the thread: a mistake ends the scheduler. It counts sections that must
 * stay on their CPU, and where BPF programs are such sections, also us for the thread that runs here: by
 * what the least is that ticks have seen.
 */
#define ENOUGH_TICKS 64
static unsigned int ticks_seen, least_disabled = 0xffff;

static __always_inline void see_tick(const struct task_struct *p)
{
	if (!bpf_core_field_exists(p->migration_disabled) || ticks_seen >= ENOUGH_TICKS)
		return;
	if (p->migration_disabled < least_disabled)
		least_disabled = p->migration_disabled;
	__sync_fetch_and_add(&ticks_seen, 1);
}

static __always_inline bool may_move(const struct task_struct *p)
{
	u32 own = 0;

	if (!bpf_core_field_exists(p->migration_disabled))
		return false;
	if (bpf_get_current_task() == (u64)p && *(volatile u32 *)&ticks_seen >= ENOUGH_TICKS)
		own = least_disabled;
	return p->migration_disabled <= own;
}

/* An idle CPU of the cluster where the thread ran last, no longer marked idle; -1: there is none. */
static __always_inline s32 take_idle_near(struct task_struct *p)
{
	u32 last = (u32)scx_bpf_task_cpu(p);
	struct bpf_iter_num it;
	s32 cpu = -1;
	int *i;

	bpf_iter_num_new(&it, 0, XAUTO_BPF_MAX_CPUS);
	while ((i = bpf_iter_num_next(&it))) {
		if (*i >= (int)nr_cpus)
			break;
		if (!is_near((u32)*i, last) || !bpf_cpumask_test_cpu((u32)*i, p->cpus_ptr) ||
		    !scx_bpf_test_and_clear_cpu_idle(*i))
			continue;
		cpu = *i;
		break;
	}
	bpf_iter_num_destroy(&it);
	return cpu;
}

static __always_inline bool wake_idle_for(struct task_struct *p)
{
	s32 cpu = scx_bpf_pick_idle_cpu(p->cpus_ptr, 0);

	if (cpu >= 0)
		scx_bpf_kick_cpu(cpu, SCX_VALUE(scx_kick_flags, SCX_KICK_IDLE));
	return cpu >= 0;
}

/* Races only make vtime_now a little smaller. */
static __always_inline void age_fair(u64 now)
{
	u64 at = aged_at;

	if (now > at + NS_PER_MS && __sync_val_compare_and_swap(&aged_at, at, now) == at && at)
		vtime_now += (now - at) / AGING;
}

/* It begins to run. Who was parked comes with an instant in place of its vtime. */
static __always_inline void begin_fair(struct task_struct *p)
{
	s64 ahead = (s64)(p->scx.dsq_vtime - vtime_now);

	if (ahead > (s64)AHEAD_NS)
		set_vtime(p, vtime_now);
	else if (ahead > 0)
		vtime_now = p->scx.dsq_vtime;
}

/* runnable_at: what the kernel's watchdog goes by. */
static __always_inline bool has_waited(const struct task_struct *p, u64 jiffies)
{
	return (s64)(bpf_jiffies64() - p->scx.runnable_at) > (s64)jiffies;
}

static __always_inline u64 look_again_at(u64 until, u64 now)
{
	return until < now + PARKED_LATE_NS ? until : now + PARKED_LATE_NS;
}

static __always_inline void enqueue_ordinary(struct task_struct *p, u64 enq_flags)
{
	u64 slice = ordinary_slice_us * NS_PER_US;
	u64 vtime = p->scx.dsq_vtime;
	u64 now = bpf_ktime_get_ns(), until;
	s32 near;

	/* A CPU that is going takes no more from our queues. The kernel moves what is in its own. */
	if (any_offline() && is_offline(scx_bpf_task_cpu(p))) {
		insert(p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL), slice, enq_flags);
		return;
	}
	age_fair(now);
	/* Sleeping earns at most one slice, and so does having been an XNode thread (vtime_of_key). */
	if ((s64)(vtime_now - vtime) > (s64)SLEPT_NS)
		vtime = vtime_now - SLEPT_NS;
	if ((s64)(vtime - vtime_now) > (s64)AHEAD_NS)
		vtime = vtime_now + AHEAD_NS;
	until = throttled_until(p, 0, now);
	if (until) {
		insert_vtime(p, PARKED_DSQ, slice, look_again_at(until, now), enq_flags);
		return;
	}
	/* Straight to it: from the fair queue, the first CPU that looks would take it. */
	near = may_move(p) ? take_idle_near(p) : -1;
	if (near >= 0) {
		insert(p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL_ON) | (u32)near, slice, enq_flags);
		return;
	}
	insert_vtime(p, FAIR_DSQ, slice, vtime, enq_flags);
	wake_idle_for(p);
}

/* An ordinary thread that has waited for long gets a turn: true if there is one. */
__noinline int dispatch_rescued(s32 cpu)
{
	bool moved = false, any = false;
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;
	int looks = 0;

	if (!iterate(&it, FAIR_DSQ))
		goto out;
	while (looks < LOOK && (p = bpf_iter_scx_dsq_next(&it))) {
		looks++;
		if (!bpf_cpumask_test_cpu((u32)cpu, p->cpus_ptr))
			continue;
		any = true;
		if (!has_waited(p, rescue_jiffies))
			continue;
		moved = move_task(&it, p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL));
		if (moved)
			break;
	}
out:
	bpf_iter_scx_dsq_destroy(&it);
	/* All of the first are other CPUs': who is behind them may have waited as long. */
	if (looks == LOOK && !any)
		moved = move_to_local(FAIR_DSQ);
	return moved;
}

/*
 * A parked thread whose cgroups may run again, or only one that has waited for long: true if there is one. Others
 * that are due go back to a later place.
 */
__noinline int dispatch_parked(s32 cpu, bool late_only)
{
	u64 now = bpf_ktime_get_ns();
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;
	bool moved = false;
	int looks = 0;

	if (!iterate(&it, PARKED_DSQ))
		goto out;
	while (looks < LOOK && (p = bpf_iter_scx_dsq_next(&it))) {
		u64 until = 0;

		looks++;
		if ((s64)(p->scx.dsq_vtime - now) > 0)
			break;
		if (!bpf_cpumask_test_cpu((u32)cpu, p->cpus_ptr)) {
			until = now + PARKED_LOOK_NS;
		} else if (!has_waited(p, rescue_jiffies)) {
			until = throttled_until(p, 0, now);
			if (!until && late_only)
				until = now + PARKED_LOOK_NS;
		}
		if (until) {
			move_task_vtime(&it, p, PARKED_DSQ, look_again_at(until, now));
			continue;
		}
		moved = move_task(&it, p, SCX_VALUE(scx_dsq_id_flags, SCX_DSQ_LOCAL));
		if (moved)
			break;
	}
out:
	bpf_iter_scx_dsq_destroy(&it);
	return moved;
}

/* An ordinary thread's turn: true if there is one. */
static __always_inline bool dispatch_ordinary(struct cpu_state *c, s32 cpu, u64 now)
{
	if (scx_bpf_dsq_nr_queued(PARKED_DSQ) > 0 && now >= c->parked_at) {
		if (dispatch_parked(cpu, false))
			return true;
		c->parked_at = now + PARKED_LOOK_NS;
	}
	return scx_bpf_dsq_nr_queued(FAIR_DSQ) > 0 && move_to_local(FAIR_DSQ);
}

/* Wakes an idle CPU for parked threads that are to be looked at: nobody else does. */
struct parked_timer {
	struct bpf_timer timer;
};

struct {
	__uint(type, BPF_MAP_TYPE_ARRAY);
	__uint(max_entries, 1);
	__type(key, u32);
	__type(value, struct parked_timer);
} timers SEC(".maps");

static int on_parked_timer(void *map, u32 *key, struct parked_timer *t)
{
	u64 now = bpf_ktime_get_ns();
	struct bpf_iter_scx_dsq it;
	struct task_struct *p;
	int looks = 0;

	if (scx_bpf_dsq_nr_queued(PARKED_DSQ) > 0) {
		/* 6.12 takes it for part of xauto_init(), which may sleep. */
		bpf_rcu_read_lock();
		if (iterate(&it, PARKED_DSQ)) {
			while (looks < LOOK && (p = bpf_iter_scx_dsq_next(&it))) {
				looks++;
				if ((s64)(p->scx.dsq_vtime - now) > 0 || !wake_idle_for(p))
					break;
			}
		}
		bpf_iter_scx_dsq_destroy(&it);
		bpf_rcu_read_unlock();
	}
	bpf_timer_start(&t->timer, now - limited_ns < 1000 * NS_PER_MS ? 2 * PARKED_LOOK_NS : 50 * PARKED_LOOK_NS,
			0);
	return 0;
}

#endif /* _XAUTO_ORDINARY_BPF_H */
