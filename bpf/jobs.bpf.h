/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What a thread runs, and what it is judged by. Included once, by xauto_scx.bpf.c, after the maps: BPF
 * programs of one object are compiled as one.
 */
#ifndef _XAUTO_JOBS_BPF_H
#define _XAUTO_JOBS_BPF_H

#define COPY_ATTEMPTS 8
#define KEY_LIMIT ((u64)XAUTO_BPF_KEY_LIMIT)

/* Less urgent than every key: who has none (ordinary threads), and who waits in a queue of keys without. */
#define NO_KEY 0x7fffffffffffffffLL
#define LAST_KEY (NO_KEY - 1)

/* Callbacks run with interrupts off, so nobody else adds to this CPU's counts meanwhile. */
static __always_inline void count(u32 what)
{
	struct xauto_bpf_counts *c = bpf_map_lookup_elem(&counts, &(u32){ 0 });

	if (c && what < XAUTO_BPF_STATS)
		c->stats[what]++;
}

/**
 * struct claim - what a thread is judged by (XAUTO_RULE_*)
 * @key:      NO_KEY: an ordinary thread, or nobody
 * @since_ns: when its job asked for the CPU
 * @slot:     its slot
 * @tid:      the thread
 * @cpu:      where it is to run
 */
struct claim {
	s64 key;
	u64 since_ns;
	s32 slot;
	s32 tid;
	u32 cpu;
	u32 pad;
};

/* An XNode thread: where it is told what it runs, and what we go by. */
struct xnode_thread {
	struct xauto_bpf_slot *slot;
	struct xauto_bpf_job *job;
	u32 at;
};

/* False: there is no such slot. */
static __always_inline bool thread_at(u32 at, struct xnode_thread *t)
{
	t->at = at;
	t->slot = bpf_map_lookup_elem(&slots, &at);
	t->job = bpf_map_lookup_elem(&jobs, &at);
	if (t->slot && !t->job) /* the loader makes both maps of one size */
		scx_bpf_error("slot %u has no job", at);
	return t->slot && t->job;
}

static __always_inline bool thread_of(struct task_struct *p, struct xnode_thread *t)
{
	u32 at = 0;

	if (!slot_of(p, &at))
		return false;
	if (thread_at(at, t))
		return true;
	count(XAUTO_BPF_STAT_NO_SLOT);
	return false;
}

static __always_inline u64 job_word(const struct xauto_bpf_slot *slot)
{
	return *(volatile u64 *)&slot->job & ~XAUTO_BPF_JOB_ENDED;
}

/*
 * Copies the XNode's entry of the table in force. Returns how often it had to begin again, -1: there is
 * none. Global functions are verified once, by themselves, and not again for each path to each call.
 */
__noinline int copy_entry(u64 word, struct xauto_bpf_entry *out)
{
	struct xauto_bpf_head *h = bpf_map_lookup_elem(&head, &(u32){ 0 });
	u32 xnode = (u32)(word >> XAUTO_BPF_JOB_SHIFT) - 1;
	int i;

	if (!h)
		scx_bpf_error("the map 'head' has no element %d", 0);
	if (!h || !out || !word || xnode >= h->xnodes)
		return -1;
	for (i = 0; i < COPY_ATTEMPTS; i++) {
		/* Atomic additions of nothing: BPF has no other way to order loads. */
		u64 version = __sync_fetch_and_add(&h->version, 0);
		u32 at = (u32)(version % XAUTO_BPF_BANKS) * h->xnodes + xnode;
		struct xauto_bpf_entry *e = bpf_map_lookup_elem(&table, &at);

		if (!version || !e)
			return -1;
		out->version = version;
		out->cpu = *(volatile u32 *)&e->cpu;
		out->key = *(volatile s64 *)&e->key;
		out->budget_ns = *(volatile u64 *)&e->budget_ns;
		/* A writer clears the stamp before it touches an entry and sets it afterwards. */
		if (__sync_fetch_and_add(&e->version, 0) == version)
			return i;
	}
	return -1;
}

/*
 * The key of the slot's job: the entry's and what the release adds. False: out of range, and then nobody
 * could say where in the queue it belongs.
 */
static __always_inline bool add_key(const struct xauto_bpf_slot *slot, const struct xauto_bpf_entry *entry,
				    s64 *key)
{
	u64 sum = (u64)entry->key + (u64)*(volatile s64 *)&slot->key;

	*key = (s64)sum;
	return sum + 2 * KEY_LIMIT < 4 * KEY_LIMIT;
}

/* Takes up the thread's present job, once per job: true if it is another one. */
static __always_inline bool latch(struct xauto_bpf_job *job, struct xauto_bpf_slot *slot)
{
	struct xauto_bpf_entry entry = {};
	s64 key = 0;
	u64 asked, word;
	int torn;

	if (job_word(slot) == job->job)
		return false;
	/* Of what is told the job comes last, so its key is looked at after it; as in copy_entry(). A
	 * worker that tells the next job meanwhile has ended this one, and that job's key is as good.
	 */
	word = __sync_fetch_and_add(&slot->job, 0) & ~XAUTO_BPF_JOB_ENDED;
	torn = copy_entry(word, &entry);
	if (torn < 0) {
		if (word)
			count(XAUTO_BPF_STAT_UNKNOWN);
		entry.cpu = XAUTO_BPF_NO_CPU;
	} else if (!add_key(slot, &entry, &key)) {
		count(XAUTO_BPF_STAT_BAD_KEY);
		entry.cpu = XAUTO_BPF_NO_CPU;
	}
	if (torn > 0)
		count(XAUTO_BPF_STAT_TORN);
	asked = *(volatile u64 *)&slot->asked_ns;
	job->version = entry.version;
	job->key = key;
	job->cpu = entry.cpu;
	job->budget_ns = entry.budget_ns;
	job->used_ns = 0;
	job->since_ns = asked ?: bpf_ktime_get_ns();
	job->flags = 0;
	/* Last, for readers in user space: the rest is this job's. */
	__sync_lock_test_and_set(&job->job, word);
	count(XAUTO_BPF_STAT_LATCHED);
	return true;
}

/* NO_KEY: as an ordinary thread. */
static __always_inline s64 key_of(const struct xauto_bpf_job *job)
{
	return job->flags & XAUTO_BPF_JOB_DEMOTED || job->cpu >= nr_cpus ? NO_KEY : job->key;
}

/*
 * The claim of a thread that runs elsewhere or waits, by its present word: it may not be latched yet.
 * That of the next job may be mixed into it, or the old one be overwritten meanwhile; running() and tick()
 * of that CPU look again.
 */
__noinline s64 claim_of(u32 at, struct claim *out)
{
	struct xauto_bpf_entry entry = {};
	struct xnode_thread t = {};
	s64 key = NO_KEY;
	u64 word;

	if (!out)
		return NO_KEY;
	out->key = NO_KEY;
	if (!thread_at(at, &t)) {
		scx_bpf_error("a thread runs in slot %u, which there is not", at);
		return NO_KEY;
	}
	out->slot = (s32)at;
	word = job_word(t.slot);
	if (word == t.job->job) {
		out->since_ns = t.job->since_ns;
		out->cpu = t.job->cpu;
		key = key_of(t.job);
	} else {
		word = __sync_fetch_and_add(&t.slot->job, 0) & ~XAUTO_BPF_JOB_ENDED;
		out->since_ns = *(volatile u64 *)&t.slot->asked_ns ?: bpf_ktime_get_ns();
		if (copy_entry(word, &entry) < 0 || entry.cpu >= nr_cpus ||
		    !add_key(t.slot, &entry, &key))
			key = NO_KEY;
		out->cpu = entry.cpu;
	}
	out->key = key;
	return key;
}

#endif /* _XAUTO_JOBS_BPF_H */
