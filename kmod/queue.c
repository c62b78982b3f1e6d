// SPDX-License-Identifier: GPL-2.0-only
/*
 * Hardware queues: registry, votes, driver calls. queue.h tells the states.
 */
#include <linux/cred.h>
#include <linux/file.h>
#include <linux/fs.h>
#include <linux/module.h>
#include <linux/netlink.h>
#include <linux/pid.h>
#include <linux/slab.h>
#include <linux/xarray.h>

#include "compat.h"
#include "event.h"
#include "power.h"
#include "queue.h"

static DEFINE_XARRAY_ALLOC1(xauto_queues);
static DEFINE_MUTEX(xauto_queues_lock); /* finding or adding by file, and removing */
static u32 xauto_next_queue_id;
static u32 xauto_queues_generation = 1; /* of the list, under its lock; never 0, see netlink.c */
static struct kmem_cache *xauto_queue_cache; /* of its own: a leak shows at unload */

static const struct xauto_queue_ops *xauto_queue_ops_of(u32 type)
{
	return type == XAUTO_QUEUE_GPU_TSG ? &xauto_tsg_ops : &xauto_dla_ops;
}

/* The list that a dump shows has changed. */
static void xauto_queues_changed(void)
{
	lockdep_assert_held(&xauto_queues_lock);
	if (!++xauto_queues_generation)
		xauto_queues_generation = 1;
}

u32 xauto_queue_generation(void)
{
	u32 generation;

	mutex_lock(&xauto_queues_lock);
	generation = xauto_queues_generation;
	mutex_unlock(&xauto_queues_lock);
	return generation;
}

static struct xauto_queue *xauto_queue_find(struct file *file)
{
	struct xauto_queue *queue;
	unsigned long id;

	lockdep_assert_held(&xauto_queues_lock);
	xa_for_each(&xauto_queues, id, queue)
		if (READ_ONCE(queue->file) == file && kref_get_unless_zero(&queue->ref))
			return queue;
	return NULL;
}

static struct xauto_queue *xauto_queue_add(u32 type, struct file *file, struct pid *pid)
{
	struct xauto_queue *queue;
	int err;

	queue = kmem_cache_zalloc(xauto_queue_cache, GFP_KERNEL);
	if (!queue)
		return ERR_PTR(-ENOMEM);
	kref_init(&queue->ref);
	mutex_init(&queue->lock);
	queue->type = type;
	queue->ops = xauto_queue_ops_of(type);
	err = xa_alloc_cyclic(&xauto_queues, &queue->id, queue, XA_LIMIT(1, INT_MAX),
			      &xauto_next_queue_id, GFP_KERNEL);
	if (err < 0) {
		kmem_cache_free(xauto_queue_cache, queue);
		return ERR_PTR(err);
	}
	queue->pid = get_pid(pid);
	xauto_power_find(file->f_op->owner, queue->power);
	WRITE_ONCE(queue->file, get_file(file)); /* from here on the sweeper sees it */
	xauto_queues_changed();
	return queue;
}

struct xauto_queue *xauto_queue_get(u32 type, struct file *file, struct pid *pid,
				    struct netlink_ext_ack *extack)
{
	struct xauto_queue *queue;
	int err;

	err = xauto_queue_ops_of(type)->verify(file, extack);
	if (err)
		return ERR_PTR(err);
	mutex_lock(&xauto_queues_lock);
	queue = xauto_queue_find(file);
	if (!queue)
		queue = xauto_queue_add(type, file, pid);
	mutex_unlock(&xauto_queues_lock);
	if (IS_ERR(queue))
		NL_SET_ERR_MSG(extack, "no memory for one more queue");
	return queue;
}

static void xauto_queue_free(struct rcu_head *rcu)
{
	kmem_cache_free(xauto_queue_cache, container_of(rcu, struct xauto_queue, rcu));
}

/* The last claim is gone and it is no orphan: nothing is suspended. */
static void xauto_queue_release(struct kref *ref)
{
	struct xauto_queue *queue = container_of(ref, struct xauto_queue, ref);

	WARN_ON(queue->suspended || queue->votes);
	xa_erase(&xauto_queues, queue->id);
	xauto_queues_changed();
	mutex_unlock(&xauto_queues_lock);
	if (queue->file)
		fput(queue->file);
	xauto_power_forget(queue->power);
	put_pid(queue->pid);
	call_rcu(&queue->rcu, xauto_queue_free);
}

void xauto_queue_put(struct xauto_queue *queue)
{
	kref_put_mutex(&queue->ref, xauto_queue_release, &xauto_queues_lock);
}

static u64 xauto_queue_account(struct xauto_queue *queue, u64 begin, int err)
{
	u64 cost = ktime_get_ns() - begin;

	queue->stats.cost_ns += cost;
	queue->stats.cost_max_ns = max(queue->stats.cost_max_ns, cost);
	queue->stats.errors += !!err;
	return cost;
}

static int xauto_queue_resume(struct xauto_queue *queue, u32 portid, u64 *cost)
{
	u64 begin = ktime_get_ns();
	int err = queue->ops->resume(queue->file);

	lockdep_assert_held(&queue->lock);
	*cost = xauto_queue_account(queue, begin, err);
	if (!err) {
		queue->stats.resumes++;
		queue->stats.suspended_ns += begin + *cost - queue->suspended_at;
		queue->suspended = false;
		xauto_power_put(queue->power);
	}
	xauto_event_of_queue(XAUTO_KEV_RESUME, queue, portid, *cost, err);
	if (err && !queue->orphan) {
		queue->orphan = true;
		kref_get(&queue->ref);
	}
	return err;
}

static int xauto_queue_suspend(struct xauto_queue *queue, u32 portid, u64 *cost)
{
	u64 begin = ktime_get_ns(), undo;
	int err = 0;

	lockdep_assert_held(&queue->lock);
	if (!queue->suspended) {
		err = xauto_power_get(queue->power);
		if (err)
			goto out;
		queue->suspended = true;
		queue->suspended_at = begin;
	}
	/* Also where it is suspended: its process may have enabled it behind our back. */
	err = queue->ops->suspend(queue->file);
	if (!err)
		queue->stats.suspends++;
out:
	*cost = xauto_queue_account(queue, begin, err);
	xauto_event_of_queue(XAUTO_KEV_SUSPEND, queue, portid, *cost, err);
	/* Half a suspension is none, unless another owner wants it suspended. */
	if (err && queue->suspended && !queue->votes)
		xauto_queue_resume(queue, portid, &undo);
	return err;
}

int xauto_queue_vote(struct xauto_queue *queue, bool *vote, bool want, u32 portid, u64 *cost_ns)
{
	u64 cost = 0;
	int err = 0;

	mutex_lock(&queue->lock);
	if (*vote == want) {
		if (want && !queue->file)
			err = -ENODEV;
		goto out;
	}
	if (want) {
		err = queue->file ? xauto_queue_suspend(queue, portid, &cost) : -ENODEV;
		if (!err) {
			*vote = true;
			queue->votes++;
		}
		goto out;
	}
	*vote = false;
	queue->votes--;
	if (!queue->file)
		err = -ENODEV;
	else if (!queue->votes && queue->suspended)
		err = xauto_queue_resume(queue, portid, &cost);
out:
	mutex_unlock(&queue->lock);
	if (cost_ns)
		*cost_ns = cost;
	return err;
}

int xauto_queue_set(struct xauto_queue *queue, u32 action, u32 value, u32 portid, u64 *cost_ns)
{
	bool slice = action == XAUTO_ACTION_SET_TIMESLICE;
	int (*set)(struct file *file, u32 value);
	int err = -ENODEV;
	u64 begin;

	set = slice ? queue->ops->set_timeslice : queue->ops->set_interleave;
	if (!set)
		return -EOPNOTSUPP;
	mutex_lock(&queue->lock);
	*cost_ns = 0;
	if (queue->file) {
		begin = ktime_get_ns();
		err = set(queue->file, value);
		*cost_ns = xauto_queue_account(queue, begin, err);
		xauto_event_of_queue(slice ? XAUTO_KEV_SET_TIMESLICE : XAUTO_KEV_SET_INTERLEAVE,
				     queue, portid, *cost_ns, err);
	}
	mutex_unlock(&queue->lock);
	return err;
}

void xauto_queue_describe(struct xauto_queue *queue, bool ask_driver, struct xauto_queue_info *info)
{
	mutex_lock(&queue->lock);
	info->id = queue->id;
	info->type = queue->type;
	info->votes = queue->votes;
	info->suspended = queue->suspended;
	info->stats = queue->stats;
	if (queue->suspended)
		info->stats.suspended_ns += ktime_get_ns() - queue->suspended_at;
	info->timeslice_us = 0;
	if (ask_driver && queue->file && queue->ops->get_timeslice &&
	    queue->ops->get_timeslice(queue->file, &info->timeslice_us))
		info->timeslice_us = 0;
	mutex_unlock(&queue->lock);
}

const struct cred *xauto_queue_cred(struct xauto_queue *queue)
{
	const struct cred *cred = NULL;

	mutex_lock(&queue->lock);
	if (queue->file)
		cred = get_cred(queue->file->f_cred);
	mutex_unlock(&queue->lock);
	return cred;
}

struct xauto_queue *xauto_queue_next(unsigned long *id)
{
	struct xauto_queue *queue;

	rcu_read_lock();
	for (queue = xa_find(&xauto_queues, id, ULONG_MAX, XA_PRESENT);
	     queue && !kref_get_unless_zero(&queue->ref);
	     queue = xa_find_after(&xauto_queues, id, ULONG_MAX, XA_PRESENT))
		;
	rcu_read_unlock();
	return queue;
}

/* Nobody else can reach the queue any more: let the driver release one that runs. */
static struct file *xauto_queue_take_gone(struct xauto_queue *queue)
{
	struct file *file = queue->file;
	u64 cost;

	lockdep_assert_held(&queue->lock);
	if (queue->suspended && xauto_queue_resume(queue, 0, &cost)) {
		/* Closing it is all that is left; the driver tears it down as it is. */
		queue->suspended = false;
		xauto_power_put(queue->power);
	}
	WRITE_ONCE(queue->file, NULL);
	xauto_event_of_queue(XAUTO_KEV_TARGET_GONE, queue, 0, 0, 0);
	return file;
}

static void xauto_queue_sweep_one(struct xauto_queue *queue)
{
	struct file *gone = NULL;
	bool adopted = false;
	u64 cost;

	mutex_lock(&queue->lock);
	if (queue->file && file_count(queue->file) == 1)
		gone = xauto_queue_take_gone(queue);
	else if (queue->file && queue->suspended && !queue->votes)
		xauto_queue_resume(queue, 0, &cost);
	if (queue->orphan && !queue->suspended) {
		queue->orphan = false;
		adopted = true;
	}
	mutex_unlock(&queue->lock);
	if (gone) {
		mutex_lock(&xauto_queues_lock);
		xauto_queues_changed();
		mutex_unlock(&xauto_queues_lock);
		fput(gone);
	}
	if (adopted)
		xauto_queue_put(queue);
}

bool xauto_queue_sweep(void)
{
	struct xauto_queue *queue;
	unsigned long id;

	for (id = 0; (queue = xauto_queue_next(&id)); id++) {
		xauto_queue_sweep_one(queue);
		xauto_queue_put(queue);
	}
	return !xa_empty(&xauto_queues);
}

int xauto_queue_init(void)
{
	xauto_queue_cache = KMEM_CACHE(xauto_queue, SLAB_ACCOUNT);
	return xauto_queue_cache ? 0 : -ENOMEM;
}

void xauto_queue_exit(void)
{
	struct xauto_queue *queue;
	unsigned long id;

	xauto_queue_sweep();
	for (id = 0; (queue = xauto_queue_next(&id)); id++) {
		if (queue->orphan) {
			pr_err("xauto: queue %u stays suspended: its driver refuses to resume it\n",
			       queue->id);
			queue->orphan = false;
			queue->suspended = false;
			xauto_power_put(queue->power);
			xauto_queue_put(queue);
		}
		xauto_queue_put(queue);
	}
	xa_destroy(&xauto_queues);
	rcu_barrier();
	kmem_cache_destroy(xauto_queue_cache);
}
