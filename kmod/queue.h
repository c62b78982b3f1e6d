/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * DOC: a hardware queue
 *
 * One struct xauto_queue stands for one GPU TSG or DLA queue, however many owners registered it.
 * Each owner's claim holds a vote; the hardware is suspended while there is a vote. What is done
 * to the hardware is derived from the votes at that moment and done to that queue alone; there is
 * no set of running or suspended queues that could be written over another.
 *
 *	             first vote: driver suspends
 *	  RUNNING ----------------------------------> SUSPENDED   (votes > 0)
 *	   ^  ^  <----- the driver refused: undone -----  |  |
 *	   |  '------- last vote gone: driver resumes ----'  | last vote gone:
 *	   |                                                 | the driver refused
 *	   |                                                 v
 *	   '-------- sweeper: the driver resumes --------- ORPHAN (votes == 0, suspended, and kept
 *	                                                           alive until it runs)
 *
 *	  any state -- nobody but us holds the file --> GONE      (resumed first, file given back;
 *	                                                           a TSG that the driver does not
 *	                                                           resume is kept until it does:
 *	                                                           its channels may live on)
 *
 * SUSPENDED is what the driver was told, not what the hardware does: the drivers enable queues by
 * themselves. So the sweeper tells it again and again, and says when it finds one that had run
 * (ESCAPED). A GPU's driver has no word for that. The sign is that PREEMPT had to sleep, since
 * nvgpu looks first and sleeps only if the context is still on its engine.
 *
 * Each device has a sweeper and a work queue of its own (device.h).
 *
 * Locks: queue->lock covers the votes, the state and the driver's calls; it is a mutex, since
 * drivers sleep, and whoever has a user behind it can be killed while waiting. The registry's is
 * never taken inside it. What a dump shows is copied when the lock is given back, so that no dump
 * waits for a driver.
 */
#ifndef XAUTO_QUEUE_H
#define XAUTO_QUEUE_H

#include <linux/atomic.h>
#include <linux/kref.h>
#include <linux/mutex.h>
#include <linux/rcupdate.h>
#include <linux/spinlock.h>
#include <linux/types.h>

#include <uapi/xauto/netlink.h>

struct cred;
struct device;
struct file;
struct netlink_ext_ack;
struct pid;
struct xauto_device;
struct xauto_queue;

#define XAUTO_MAX_POWER 4

/**
 * struct xauto_queue_ops - what a kind of queue can do; tsg.c, dla.c
 * @verify: is this file such a queue? 0, or a negative errno with its text in the extack
 * @slot: which of the device's queues the file has now; -ENODATA: none, -EAGAIN: asleep
 * @suspend: start none of its work; notes the slot that it was told of
 * @preempt: wait until none of it runs; -ETIMEDOUT: it still does
 * @resume: let it run
 *
 * @outlives_file: what was suspended stays so after the file's last close
 *
 * All may sleep and are called with the queue's lock held, except @verify. @slot, @preempt, the
 * time slice's and the interleave level's may be missing.
 */
struct xauto_queue_ops {
	int (*verify)(struct file *file, struct netlink_ext_ack *extack);
	int (*slot)(struct xauto_queue *queue, u32 *slot);
	int (*suspend)(struct xauto_queue *queue);
	int (*preempt)(struct xauto_queue *queue);
	int (*resume)(struct xauto_queue *queue);
	int (*set_timeslice)(struct xauto_queue *queue, u32 us);
	int (*get_timeslice)(struct xauto_queue *queue, u32 *us);
	int (*set_interleave)(struct xauto_queue *queue, u32 level);
	bool outlives_file;
};

extern const struct xauto_queue_ops xauto_tsg_ops;
extern const struct xauto_queue_ops xauto_dla_ops;

/* u64: nanoseconds and counts. */
struct xauto_queue_stats {
	u64 suspends;
	u64 resumes;
	u64 errors;
	u64 suspended_ns;
	u64 cost_ns;
	u64 cost_max_ns;
	u64 escapes;
};

/**
 * struct xauto_stake - what one claim wants of a queue; the queue's lock covers it
 * @vote: that it is suspended
 * @ended: it wants nothing any more
 * @bitten: its owner's watchdog bit after the last vote; set without the lock
 * @sliced: it set the time slice
 * @leveled: it set the interleave level
 * @votes: of its owner, all queues
 */
struct xauto_stake {
	bool vote;
	bool ended;
	bool bitten;
	bool sliced;
	bool leveled;
	atomic_t *votes;
};

/* What GET tells. */
struct xauto_queue_info {
	u32 id, type, votes, timeslice_us, stuck_ms;
	bool suspended, gated;
	u64 suspended_at;
	struct xauto_queue_stats stats;
};

/**
 * struct xauto_queue - a hardware queue
 * @ref: one per claim, one of the registry while it is an orphan, and one while @remembered
 * @rcu: the registry is walked without its lock
 * @id: in the registry, and in events
 * @type: enum xauto_queue_type
 * @ops: the type's
 * @device: whose work queue it is swept on
 * @cred: who opened the file
 * @shown_lock: covers @shown
 * @shown: what a dump tells
 * @pid: the process whose queue it is, for people; whether it lives is seen from @file
 * @lock: covers everything below
 * @file: our reference; NULL once it is gone
 * @votes: claims that want it suspended
 * @suspended: the driver was told to suspend and not yet to resume
 * @orphan: suspended without a vote since the driver refused to resume; the sweeper tries again
 * @sleeps: how often the system had slept when the driver was told last
 * @lost: the process has released it, as far as we have seen
 * @slot: that it had when it was suspended
 * @suspended_at: ktime in ns when @suspended became true
 * @retry_at: jiffies; the sweeper leaves it alone until then
 * @retry_ms: how long it did so last; 0: the driver did what it was told
 * @preempt_at: jiffies; not preempted until then
 * @stuck_ms: preemptions that took long, in sum
 * @remembered: it has cost the context some of its life: kept until the process closes it
 * @gated: never preempted again
 * @n_sliced: stakes that set the time slice
 * @n_leveled: stakes that set the interleave level
 * @slice_was: before the first of them did
 * @power: devices that stay powered while @suspended: taking power from a GPU whose context is off
 *   loses it
 * @stats: for GET
 */
struct xauto_queue {
	struct kref ref;
	struct rcu_head rcu;
	u32 id;
	u32 type;
	const struct xauto_queue_ops *ops;
	struct xauto_device *device;
	const struct cred *cred;
	spinlock_t shown_lock; /* @shown */
	struct xauto_queue_info shown;
	struct pid *pid;
	struct mutex lock; /* everything below */
	struct file *file;
	unsigned int votes;
	bool suspended;
	bool orphan;
	bool lost;
	u32 sleeps;
	u32 slot;
	u64 suspended_at;
	unsigned long retry_at;
	u32 retry_ms;
	unsigned long preempt_at;
	u32 stuck_ms;
	bool remembered;
	bool gated;
	u32 n_sliced;
	u32 n_leveled;
	u32 slice_was;
	struct device *power[XAUTO_MAX_POWER];
	struct xauto_queue_stats stats;
};

/* Looks at the file, finds or makes the queue; an ERR_PTR with the extack set on failure. */
struct xauto_queue *xauto_queue_get(u32 type, struct file *file, struct pid *pid,
				    struct netlink_ext_ack *extack);
void xauto_queue_put(struct xauto_queue *queue);

enum xauto_wish { XAUTO_WANT_RUN, XAUTO_WANT_OLD, XAUTO_WANT_SUSPENDED, XAUTO_WANT_NOTHING };

/**
 * xauto_queue_want() - make a claim's vote what it is wanted to be
 * @queue: the queue
 * @stake: the claim's
 * @wish: %XAUTO_WANT_NOTHING: for ever, and what else the claim has set is undone;
 *   %XAUTO_WANT_OLD: to run, unless it has voted since the watchdog bit
 * @portid: whose, for events; 0: the module's own doing
 * @cost_ns: out, may be NULL: time in the driver
 *
 * Return: 0; -ENODEV when the process is gone; -ENOENT when the stake has ended; -EINTR when the
 * caller is killed, and then nothing was done; else what the driver answered. A vote to suspend
 * that failed is not kept; one that was there stays. A vote that was taken back is gone even where
 * the driver refused to resume.
 */
int xauto_queue_want(struct xauto_queue *queue, struct xauto_stake *stake, enum xauto_wish wish,
		     u32 portid, u64 *cost_ns);

/* XAUTO_ACTION_SET_TIMESLICE, XAUTO_ACTION_SET_INTERLEAVE. */
int xauto_queue_set(struct xauto_queue *queue, struct xauto_stake *stake, u32 action, u32 value,
		    u32 portid, u64 *cost_ns);

/* @ask_driver: for the time slice, which may wait for it. */
void xauto_queue_describe(struct xauto_queue *queue, bool ask_driver,
			  struct xauto_queue_info *info);

/* Another one, never 0, once a queue has come or gone: then a list read in parts is none. */
u32 xauto_queue_generation(void);
/* The next queue with an id of at least *@id, with a reference; NULL at the end. */
struct xauto_queue *xauto_queue_next(unsigned long *id);

int xauto_queue_init(void);
/* At module exit, all owners gone: the last attempt at orphans. */
void xauto_queue_exit(void);

#endif /* XAUTO_QUEUE_H */
