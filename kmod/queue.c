// SPDX-License-Identifier: GPL-2.0-only
/*
 * Hardware queues: registry, votes, driver calls. queue.h tells the states.
 */
#include <linux/cred.h>
#include <linux/file.h>
#include <linux/fs.h>
#include <linux/jiffies.h>
#include <linux/module.h>
#include <linux/netlink.h>
#include <linux/notifier.h>
#include <linux/pid.h>
#include <linux/sched.h>
#include <linux/slab.h>
#include <linux/suspend.h>
#include <linux/workqueue.h>
#include <linux/xarray.h>

#include "compat.h"
#include "device.h"
#include "event.h"
#include "power.h"
#include "queue.h"

static unsigned int xauto_sweep_ms = 50;
module_param_named(sweep_ms, xauto_sweep_ms, uint, 0444);
MODULE_PARM_DESC(
	sweep_ms,
	"how often dead processes, orphaned and escaped queues are looked for (default: 50 ms)");

/* A firmware command each, and submits wait for it; how long a refusal is respected at most. */
#define XAUTO_DLA_AGAIN_MS 250
#define XAUTO_RETRY_MAX_MS 1000
/* nvgpu's period: what takes longer counts against the context's life. */
#define XAUTO_SLOW_MS 100
#define XAUTO_STUCK_STEP_MS 500 /* the least that a failure counts */

static DEFINE_XARRAY_ALLOC1(xauto_queues);
static DEFINE_MUTEX(xauto_queues_lock); /* finding or adding by file, and removing */
static u32 xauto_next_queue_id;
static u32 xauto_queues_generation = 1; /* of the list, under its lock; never 0, see netlink.c */
static struct kmem_cache *xauto_queue_cache; /* of its own: a leak shows at unload */
static struct delayed_work xauto_sweepers[XAUTO_DEVICES];
static bool xauto_sweepers_stopped; /* under the registry's lock */
static u32 xauto_sleeps; /* of the system; what a driver was told before the last is gone */

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

/* A queue's device is swept while it has queues. */
static void xauto_sweep_soon(struct xauto_device *device, unsigned int ms)
{
	lockdep_assert_held(&xauto_queues_lock);
	if (!xauto_sweepers_stopped)
		queue_delayed_work(device->works, &xauto_sweepers[device->index],
				   msecs_to_jiffies(ms));
}

/* Shows what is so now. */
static void xauto_queue_unlock(struct xauto_queue *queue)
{
	struct xauto_queue_info *shown = &queue->shown;

	spin_lock(&queue->shown_lock);
	shown->votes = queue->votes;
	shown->stuck_ms = queue->stuck_ms;
	shown->suspended = queue->suspended;
	shown->gated = queue->gated;
	shown->suspended_at = queue->suspended_at;
	shown->stats = queue->stats;
	spin_unlock(&queue->shown_lock);
	mutex_unlock(&queue->lock);
}

/* With its lock held, so that nobody acts on it before its maker has. */
static struct xauto_queue *xauto_queue_add(u32 type, struct file *file, struct pid *pid)
{
	struct xauto_queue *queue;
	int err;

	queue = kmem_cache_zalloc(xauto_queue_cache, GFP_KERNEL);
	if (!queue)
		return ERR_PTR(-ENOMEM);
	kref_init(&queue->ref);
	mutex_init(&queue->lock);
	mutex_lock(&queue->lock);
	spin_lock_init(&queue->shown_lock);
	queue->type = type;
	queue->ops = xauto_queue_ops_of(type);
	queue->device = xauto_device_of(type, file);
	queue->preempt_at = jiffies;
	queue->retry_at = jiffies;
	err = xa_alloc_cyclic(&xauto_queues, &queue->id, queue, XA_LIMIT(1, INT_MAX),
			      &xauto_next_queue_id, GFP_KERNEL);
	if (err < 0) {
		mutex_unlock(&queue->lock);
		kmem_cache_free(xauto_queue_cache, queue);
		return ERR_PTR(err);
	}
	queue->pid = get_pid(pid);
	queue->cred = get_cred(file->f_cred);
	xauto_power_find(file, queue->power);
	WRITE_ONCE(queue->file, get_file(file)); /* from here on the sweeper sees it */
	xauto_sweep_soon(queue->device, xauto_sweep_ms);
	xauto_queues_changed();
	return queue;
}

struct xauto_queue *xauto_queue_get(u32 type, struct file *file, struct pid *pid,
				    struct netlink_ext_ack *extack)
{
	struct xauto_queue *queue;
	bool added = false;
	int err;

	err = xauto_queue_ops_of(type)->verify(file, extack);
	if (err)
		return ERR_PTR(err);
	mutex_lock(&xauto_queues_lock);
	queue = xauto_queue_find(file);
	if (!queue) {
		queue = xauto_queue_add(type, file, pid);
		added = !IS_ERR(queue);
	}
	mutex_unlock(&xauto_queues_lock);
	if (IS_ERR(queue))
		NL_SET_ERR_MSG(extack, "no memory for one more queue");
	if (added) {
		/* Its slot may have been released by another process while it was suspended. */
		if (queue->ops->slot)
			queue->ops->resume(queue);
		xauto_queue_unlock(queue);
	}
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
	put_cred(queue->cred);
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

/* A driver that refuses is asked less and less often. */
static void xauto_queue_back_off(struct xauto_queue *queue, int err)
{
	queue->retry_ms = !err ? 0 : clamp(queue->retry_ms * 2, xauto_sweep_ms, XAUTO_RETRY_MAX_MS);
	queue->retry_at = jiffies + msecs_to_jiffies(queue->retry_ms);
}

static int xauto_queue_resume(struct xauto_queue *queue, u32 portid, u64 *cost)
{
	u64 begin = ktime_get_ns();
	int err = queue->ops->resume(queue);

	lockdep_assert_held(&queue->lock);
	*cost = xauto_queue_account(queue, begin, err);
	xauto_queue_back_off(queue, err);
	if (!err) {
		queue->stats.resumes++;
		queue->stats.suspended_ns += begin + *cost - queue->suspended_at;
		queue->suspended = false;
		queue->lost = false;
		xauto_power_put(queue->power);
	}
	xauto_event_of_queue(XAUTO_KEV_RESUME, queue, portid, *cost, err);
	if (err && !queue->orphan) {
		queue->orphan = true;
		kref_get(&queue->ref);
	}
	return err;
}

static bool xauto_queue_may_preempt(struct xauto_queue *queue)
{
	return queue->ops->preempt && !queue->gated && time_after_eq(jiffies, queue->preempt_at);
}

/*
 * @waited: did the driver have to sleep? Then the context was on the engine. A driver that gives up
 * has spent some of the time after which it kills the context, so it is asked again later and in
 * the end never.
 */
static int xauto_queue_preempt(struct xauto_queue *queue, u32 portid, bool *waited)
{
	unsigned long switches = current->nvcsw;
	u64 begin = ktime_get_ns(), ms;
	int err = queue->ops->preempt(queue);

	ms = div_u64(ktime_get_ns() - begin, NSEC_PER_MSEC);
	*waited = current->nvcsw != switches;
	if (err == -ETIMEDOUT)
		ms = max_t(u64, ms, XAUTO_STUCK_STEP_MS);
	else if (!*waited || ms < XAUTO_SLOW_MS)
		return err;
	if (!queue->stuck_ms) /* the driver counts for the context's life, and so do we */
		kref_get(&queue->ref);
	queue->stuck_ms = min_t(u64, queue->stuck_ms + ms, INT_MAX);
	queue->remembered = true;
	if (err)
		queue->preempt_at = jiffies + msecs_to_jiffies(2 * queue->stuck_ms);
	if (queue->stuck_ms >= XAUTO_STUCK_MAX_MS && !queue->gated) {
		queue->gated = true;
		xauto_event_of_queue(XAUTO_KEV_GATED, queue, portid, ms * NSEC_PER_MSEC, err);
	}
	return err;
}

/* Suspended: tells the driver so. */
static int xauto_queue_tell(struct xauto_queue *queue, u32 portid, bool *waited)
{
	u32 sleeps = READ_ONCE(xauto_sleeps); /* before: one in between makes it be told again */
	int err = queue->ops->suspend(queue);

	*waited = false;
	if (!err)
		queue->sleeps = sleeps;
	if (!err && xauto_queue_may_preempt(queue))
		err = xauto_queue_preempt(queue, portid, waited);
	return err;
}

/* The first vote. */
static int xauto_queue_suspend(struct xauto_queue *queue, u32 portid, u64 *cost)
{
	u64 begin = ktime_get_ns(), undo;
	bool waited;
	int err;

	lockdep_assert_held(&queue->lock);
	if (queue->ops->preempt && !xauto_queue_may_preempt(queue))
		return -EBUSY;
	err = xauto_power_get(queue->power);
	if (!err) {
		queue->suspended = true;
		queue->suspended_at = begin;
		err = xauto_queue_tell(queue, portid, &waited);
	}
	if (!err)
		queue->stats.suspends++;
	*cost = xauto_queue_account(queue, begin, err);
	xauto_event_of_queue(XAUTO_KEV_SUSPEND, queue, portid, *cost, err);
	if (err && queue->suspended) /* half a suspension is none */
		xauto_queue_resume(queue, portid, &undo);
	return err;
}

static void xauto_queue_escaped(struct xauto_queue *queue, u32 portid, u64 cost, int err)
{
	queue->stats.escapes++;
	xauto_event_of_queue(XAUTO_KEV_ESCAPED, queue, portid, cost, err);
}

/* It is suspended, as far as the driver was told: tells it again. */
static int xauto_queue_tell_again(struct xauto_queue *queue, u32 portid, u64 *cost)
{
	u32 slot = queue->slot, sleeps = queue->sleeps;
	bool waited;
	u64 begin = ktime_get_ns();
	int err;

	lockdep_assert_held(&queue->lock);
	err = xauto_queue_tell(queue, portid, &waited);
	*cost = ktime_get_ns() - begin;
	if (err == -ENODATA) {
		if (!queue->lost)
			xauto_queue_escaped(queue, portid, *cost, err);
		queue->lost = true;
		return err;
	}
	if (err && err != -ETIMEDOUT)
		return err;
	if (queue->lost || waited || slot != queue->slot || sleeps != queue->sleeps)
		xauto_queue_escaped(queue, portid, *cost, err);
	queue->lost = false;
	return err;
}

/* The sweeper's. A DLA is asked for the slot each time, and told by a command now and then. */
static void xauto_queue_keep_suspended(struct xauto_queue *queue)
{
	bool due = time_after_eq(jiffies, queue->retry_at) ||
		   queue->sleeps != READ_ONCE(xauto_sleeps);
	u32 slot;
	u64 cost;
	int err;

	if (queue->ops->slot) {
		err = queue->ops->slot(queue, &slot);
		if (err == -EAGAIN || (err && queue->lost) || (err && err != -ENODATA && !due))
			return;
		if (!err && !due && !queue->lost && slot == queue->slot)
			return;
	} else if (!due) {
		return;
	}
	err = xauto_queue_tell_again(queue, 0, &cost);
	if (err == -ENODATA)
		return;
	if (err == -ETIMEDOUT && queue->ops->preempt)
		err = 0; /* it is disabled; preempt_at says when it is tried again */
	queue->stats.errors += !!err;
	xauto_queue_back_off(queue, err);
	if (!err && queue->ops->slot)
		queue->retry_at = jiffies + msecs_to_jiffies(XAUTO_DLA_AGAIN_MS);
}

static int xauto_queue_vote(struct xauto_queue *queue, struct xauto_stake *stake, u32 portid,
			    u64 *cost)
{
	int err;

	if (stake->ended)
		return -ENOENT;
	if (!queue->file)
		return -ENODEV;
	if (queue->suspended) {
		err = xauto_queue_tell_again(queue, portid, cost);
		queue->stats.errors += !!err;
	} else {
		err = xauto_queue_suspend(queue, portid, cost);
	}
	if (!err)
		WRITE_ONCE(stake->bitten, false); /* before this vote, if at all */
	if (!err && !stake->vote) {
		stake->vote = true;
		queue->votes++;
		atomic_inc(stake->votes);
	}
	return err;
}

static int xauto_queue_unvote(struct xauto_queue *queue, struct xauto_stake *stake, u32 portid,
			      u64 *cost)
{
	if (!stake->vote)
		return 0;
	stake->vote = false;
	atomic_dec(stake->votes);
	queue->votes--;
	if (!queue->file)
		return -ENODEV;
	return !queue->votes && queue->suspended ? xauto_queue_resume(queue, portid, cost) : 0;
}

static int xauto_queue_do_set(struct xauto_queue *queue, u32 action, u32 value, u32 portid,
			      u64 *cost)
{
	bool slice = action == XAUTO_ACTION_SET_TIMESLICE;
	u64 begin = ktime_get_ns();
	int err = slice ? queue->ops->set_timeslice(queue, value) :
			  queue->ops->set_interleave(queue, value);

	lockdep_assert_held(&queue->lock);
	*cost = xauto_queue_account(queue, begin, err);
	xauto_event_of_queue(slice ? XAUTO_KEV_SET_TIMESLICE : XAUTO_KEV_SET_INTERLEAVE, queue,
			     portid, *cost, err);
	return err;
}

/* What the last stake that set something has set is undone: it does not outlive its owner. */
static void xauto_queue_end_stake(struct xauto_queue *queue, struct xauto_stake *stake)
{
	u64 cost;

	stake->ended = true;
	if (stake->sliced && !--queue->n_sliced && queue->file)
		xauto_queue_do_set(queue, XAUTO_ACTION_SET_TIMESLICE, queue->slice_was, 0, &cost);
	/* The driver does not say what the level was; it makes all of them so. */
	if (stake->leveled && !--queue->n_leveled && queue->file)
		xauto_queue_do_set(queue, XAUTO_ACTION_SET_INTERLEAVE, 0, 0, &cost);
	stake->sliced = false;
	stake->leveled = false;
}

int xauto_queue_want(struct xauto_queue *queue, struct xauto_stake *stake, enum xauto_wish wish,
		     u32 portid, u64 *cost_ns)
{
	u64 cost = 0;
	int err = 0;

	if (mutex_lock_killable(&queue->lock))
		return -EINTR;
	if (wish == XAUTO_WANT_SUSPENDED)
		err = xauto_queue_vote(queue, stake, portid, &cost);
	else if (wish != XAUTO_WANT_OLD || READ_ONCE(stake->bitten))
		err = xauto_queue_unvote(queue, stake, portid, &cost);
	if (wish == XAUTO_WANT_NOTHING)
		xauto_queue_end_stake(queue, stake);
	xauto_queue_unlock(queue);
	if (cost_ns)
		*cost_ns = cost;
	return err;
}

int xauto_queue_set(struct xauto_queue *queue, struct xauto_stake *stake, u32 action, u32 value,
		    u32 portid, u64 *cost_ns)
{
	bool slice = action == XAUTO_ACTION_SET_TIMESLICE;
	int err = 0;

	*cost_ns = 0;
	if (!queue->ops->set_timeslice)
		return -EOPNOTSUPP;
	if (mutex_lock_killable(&queue->lock))
		return -EINTR;
	if (stake->ended)
		err = -ENOENT;
	else if (!queue->file)
		err = -ENODEV;
	else if (slice && !queue->n_sliced)
		err = queue->ops->get_timeslice(queue, &queue->slice_was);
	if (!err)
		err = xauto_queue_do_set(queue, action, value, portid, cost_ns);
	if (!err && slice && !stake->sliced) {
		stake->sliced = true;
		queue->n_sliced++;
	} else if (!err && !slice && !stake->leveled) {
		stake->leveled = true;
		queue->n_leveled++;
	}
	xauto_queue_unlock(queue);
	return err;
}

void xauto_queue_describe(struct xauto_queue *queue, bool ask_driver, struct xauto_queue_info *info)
{
	spin_lock(&queue->shown_lock);
	*info = queue->shown;
	spin_unlock(&queue->shown_lock);
	info->id = queue->id;
	info->type = queue->type;
	if (info->suspended)
		info->stats.suspended_ns += ktime_get_ns() - info->suspended_at;
	if (!ask_driver || !queue->ops->get_timeslice || mutex_lock_killable(&queue->lock))
		return;
	if (!queue->file || queue->ops->get_timeslice(queue, &info->timeslice_us))
		info->timeslice_us = 0;
	mutex_unlock(&queue->lock);
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

/* Nobody else can reach the queue any more: let the driver release one that runs. NULL: later. */
static struct file *xauto_queue_take_gone(struct xauto_queue *queue)
{
	struct file *file = queue->file;
	u64 cost;

	lockdep_assert_held(&queue->lock);
	if (queue->suspended && time_before(jiffies, queue->retry_at))
		return NULL;
	if (queue->suspended && xauto_queue_resume(queue, 0, &cost)) {
		/* Without us nobody could resume what outlives its file. */
		if (queue->ops->outlives_file)
			return NULL;
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
	bool adopted = false, forgotten = false;
	u64 cost;

	mutex_lock(&queue->lock);
	if (queue->file && file_count(queue->file) == 1)
		gone = xauto_queue_take_gone(queue);
	else if (queue->file && queue->suspended && queue->votes)
		xauto_queue_keep_suspended(queue);
	else if (queue->file && queue->suspended && time_after_eq(jiffies, queue->retry_at))
		xauto_queue_resume(queue, 0, &cost);
	if (queue->orphan && !queue->suspended) {
		queue->orphan = false;
		adopted = true;
	}
	if (queue->remembered && !queue->file) {
		queue->remembered = false;
		forgotten = true;
	}
	xauto_queue_unlock(queue);
	if (gone) {
		mutex_lock(&xauto_queues_lock);
		xauto_queues_changed();
		mutex_unlock(&xauto_queues_lock);
		fput(gone);
	}
	if (adopted)
		xauto_queue_put(queue);
	if (forgotten)
		xauto_queue_put(queue);
}

/* One look at every queue of the device. */
static void xauto_queue_sweep(struct work_struct *work)
{
	struct delayed_work *sweeper = to_delayed_work(work);
	struct xauto_device *device = xauto_device_at(sweeper - xauto_sweepers);
	struct xauto_queue *queue;
	unsigned long id;
	bool any = false;

	for (id = 0; (queue = xauto_queue_next(&id)); id++) {
		if (queue->device == device) {
			xauto_queue_sweep_one(queue);
			any = true;
		}
		xauto_queue_put(queue);
	}
	/* One that was added behind us has asked for a sweep of its own. */
	if (any) {
		mutex_lock(&xauto_queues_lock);
		xauto_sweep_soon(device, xauto_sweep_ms);
		mutex_unlock(&xauto_queues_lock);
	}
}

/* The system has slept. Refuses nothing. */
static int xauto_queue_on_sleep(struct notifier_block *block, unsigned long event, void *data)
{
	int i;

	if (event != PM_POST_SUSPEND && event != PM_POST_HIBERNATION && event != PM_POST_RESTORE)
		return NOTIFY_DONE;
	WRITE_ONCE(xauto_sleeps, xauto_sleeps + 1);
	for (i = 0; i < XAUTO_DEVICES; i++)
		mod_delayed_work(xauto_device_at(i)->works, &xauto_sweepers[i], 0);
	return NOTIFY_DONE;
}

static struct notifier_block xauto_sleep_block = { .notifier_call = xauto_queue_on_sleep };

int xauto_queue_init(void)
{
	int i, err;

	xauto_sweep_ms = clamp(xauto_sweep_ms, 1u, 1000u);
	for (i = 0; i < XAUTO_DEVICES; i++)
		INIT_DELAYED_WORK(&xauto_sweepers[i], xauto_queue_sweep);
	xauto_queue_cache = KMEM_CACHE(xauto_queue, SLAB_ACCOUNT);
	if (!xauto_queue_cache)
		return -ENOMEM;
	err = register_pm_notifier(&xauto_sleep_block);
	if (err)
		kmem_cache_destroy(xauto_queue_cache);
	return err;
}

void xauto_queue_exit(void)
{
	struct xauto_queue *queue;
	unsigned long id;
	int i;

	unregister_pm_notifier(&xauto_sleep_block);
	mutex_lock(&xauto_queues_lock);
	xauto_sweepers_stopped = true;
	mutex_unlock(&xauto_queues_lock);
	for (i = 0; i < XAUTO_DEVICES; i++)
		cancel_delayed_work_sync(&xauto_sweepers[i]);
	for (id = 0; (queue = xauto_queue_next(&id)); id++) {
		queue->retry_at = jiffies;
		xauto_queue_sweep_one(queue);
		if (queue->orphan) {
			pr_err("xauto: queue %u stays suspended: its driver refuses to resume it\n",
			       queue->id);
			queue->orphan = false;
			queue->suspended = false;
			xauto_power_put(queue->power);
			xauto_queue_put(queue);
		}
		if (queue->remembered)
			xauto_queue_put(queue);
		xauto_queue_put(queue);
	}
	xa_destroy(&xauto_queues);
	rcu_barrier();
	kmem_cache_destroy(xauto_queue_cache);
}
