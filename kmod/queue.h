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
 *	  any state -- nobody but us holds the file --> GONE      (resumed first, file given back)
 *
 * Locks: an owner's lock is taken before a queue's, the registry's inside neither. queue->lock
 * covers the votes, the state and the driver's calls; it is a mutex, since drivers sleep.
 */
#ifndef XAUTO_QUEUE_H
#define XAUTO_QUEUE_H

#include <linux/kref.h>
#include <linux/mutex.h>
#include <linux/rcupdate.h>
#include <linux/types.h>

#include <uapi/xauto/netlink.h>

struct cred;
struct device;
struct file;
struct netlink_ext_ack;
struct pid;

#define XAUTO_MAX_POWER 4

/**
 * struct xauto_queue_ops - what a kind of queue can do; tsg.c, dla.c
 * @verify: is this file such a queue? 0, or a negative errno with its text in the extack
 * @suspend: stop its work; on failure the caller resumes
 * @resume: let it run
 *
 * All may sleep and are called with the queue's lock held, except @verify. The last three may be
 * missing.
 */
struct xauto_queue_ops {
	int (*verify)(struct file *file, struct netlink_ext_ack *extack);
	int (*suspend)(struct file *file);
	int (*resume)(struct file *file);
	int (*set_timeslice)(struct file *file, u32 us);
	int (*get_timeslice)(struct file *file, u32 *us);
	int (*set_interleave)(struct file *file, u32 level);
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
};

/**
 * struct xauto_queue - a hardware queue
 * @ref: one per claim, one of the registry while it is an orphan
 * @rcu: the registry is walked without its lock
 * @id: in the registry, and in events
 * @type: enum xauto_queue_type
 * @ops: the type's
 * @pid: the process whose queue it is, for people; whether it lives is seen from @file
 * @lock: covers everything below
 * @file: our reference; NULL once it is gone
 * @votes: claims that want it suspended
 * @suspended: the driver was told to suspend and not yet to resume
 * @orphan: suspended without a vote since the driver refused to resume; the sweeper tries again
 * @suspended_at: ktime in ns when @suspended became true
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
	struct pid *pid;
	struct mutex lock; /* everything below */
	struct file *file;
	unsigned int votes;
	bool suspended;
	bool orphan;
	u64 suspended_at;
	struct device *power[XAUTO_MAX_POWER];
	struct xauto_queue_stats stats;
};

/* Looks at the file, finds or makes the queue; an ERR_PTR with the extack set on failure. */
struct xauto_queue *xauto_queue_get(u32 type, struct file *file, struct pid *pid,
				    struct netlink_ext_ack *extack);
void xauto_queue_put(struct xauto_queue *queue);

/**
 * xauto_queue_vote() - make a claim's vote what it is wanted to be
 * @queue: the queue
 * @vote: the claim's vote; read and written under the queue's lock
 * @want: suspended?
 * @portid: whose vote, for events; 0: the module's own doing
 * @cost_ns: out, may be NULL: time in the driver
 *
 * Return: 0; -ENODEV when the process is gone; else what the driver answered. A vote to suspend
 * that failed is not kept; a vote that was taken back is gone even where the driver refused to
 * resume.
 */
int xauto_queue_vote(struct xauto_queue *queue, bool *vote, bool want, u32 portid, u64 *cost_ns);

/* XAUTO_ACTION_SET_TIMESLICE, XAUTO_ACTION_SET_INTERLEAVE. */
int xauto_queue_set(struct xauto_queue *queue, u32 action, u32 value, u32 portid, u64 *cost_ns);

/* What GET tells. @timeslice_us: may be NULL; 0 where there is none. */
struct xauto_queue_info {
	u32 id, type, votes, timeslice_us;
	bool suspended;
	struct xauto_queue_stats stats;
};

void xauto_queue_describe(struct xauto_queue *queue, bool ask_driver,
			  struct xauto_queue_info *info);

/* Who opened the file: its credentials, with a reference, or NULL once it is gone. */
const struct cred *xauto_queue_cred(struct xauto_queue *queue);

/* Another one, never 0, once a queue has come or gone: then a list read in parts is none. */
u32 xauto_queue_generation(void);
/* The next queue with an id of at least *@id, with a reference; NULL at the end. */
struct xauto_queue *xauto_queue_next(unsigned long *id);

/*
 * One look at every queue: finds those whose process is gone, and retries orphans. Return: is there
 * any queue left?
 */
bool xauto_queue_sweep(void);
int xauto_queue_init(void);
/* At module exit, all owners gone: the last attempt at orphans. */
void xauto_queue_exit(void);

#endif /* XAUTO_QUEUE_H */
