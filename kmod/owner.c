// SPDX-License-Identifier: GPL-2.0-only
/*
 * Owners: sockets, their claims, watchdogs and deaths; and the sweeper. owner.h tells the rules.
 */
#include <linux/moduleparam.h>
#include <linux/netlink.h>
#include <linux/notifier.h>
#include <linux/pid.h>
#include <linux/sched/signal.h>
#include <linux/slab.h>
#include <net/net_namespace.h>
#include <net/sock.h>

#include "compat.h"
#include "event.h"
#include "owner.h"
#include "queue.h"

static unsigned int xauto_sweep_ms = 50;
module_param_named(sweep_ms, xauto_sweep_ms, uint, 0444);
MODULE_PARM_DESC(sweep_ms,
		 "how often dead processes and orphaned queues are looked for (default: 50 ms)");

/* In an owner's table of handles. @vote is covered by the queue's lock. */
struct xauto_claim {
	struct xauto_queue *queue;
	bool vote;
};

/* By port id; the array's own lock orders additions and removals. */
static DEFINE_XARRAY(xauto_owners);
static atomic_t xauto_n_owners = ATOMIC_INIT(0);
static struct workqueue_struct *xauto_reaper;
static struct kmem_cache *xauto_owner_cache; /* caches of their own: a leak shows at unload */
static struct kmem_cache *xauto_claim_cache;

static void xauto_sweep(struct work_struct *work);
static DECLARE_DELAYED_WORK(xauto_sweeper, xauto_sweep);

static void xauto_owner_free(struct rcu_head *rcu)
{
	kmem_cache_free(xauto_owner_cache, container_of(rcu, struct xauto_owner, rcu));
}

static void xauto_owner_release(struct kref *ref)
{
	struct xauto_owner *owner = container_of(ref, struct xauto_owner, ref);

	xa_destroy(&owner->claims);
	put_pid(owner->pid);
	sock_put(owner->sk);
	call_rcu(&owner->rcu, xauto_owner_free);
	atomic_dec(&xauto_n_owners);
}

void xauto_owner_put(struct xauto_owner *owner)
{
	kref_put(&owner->ref, xauto_owner_release);
}

/* The table's, whoever's socket it is. */
static struct xauto_owner *xauto_owner_look_up(unsigned long portid)
{
	struct xauto_owner *owner;

	rcu_read_lock();
	owner = xa_load(&xauto_owners, portid);
	if (owner && !kref_get_unless_zero(&owner->ref))
		owner = NULL;
	rcu_read_unlock();
	return owner;
}

/* The table's reference becomes the work's. Any context that may take the array's lock. */
static void xauto_owner_bury(struct xauto_owner *owner)
{
	if (xa_cmpxchg(&xauto_owners, owner->portid, owner, NULL, 0) == owner)
		queue_work(xauto_reaper, &owner->reap);
}

struct xauto_owner *xauto_owner_find(struct sk_buff *skb)
{
	struct xauto_owner *owner = xauto_owner_look_up(NETLINK_CB(skb).portid);

	if (owner && owner->sk != NETLINK_CB(skb).sk) {
		/* Its socket has closed, else this one could not have its port. */
		xauto_owner_bury(owner);
		xauto_owner_put(owner);
		owner = NULL;
	}
	if (owner)
		WRITE_ONCE(owner->fed, jiffies);
	return owner;
}

/* Ends the claim's vote; the owner's lock is held. */
static int xauto_owner_end_vote(struct xauto_owner *owner, struct xauto_claim *claim, u64 *cost_ns)
{
	bool voted = claim->vote;
	int err = xauto_queue_vote(claim->queue, &claim->vote, false, owner->portid, cost_ns);

	owner->n_votes -= voted;
	return err;
}

static void xauto_owner_end_votes(struct xauto_owner *owner)
{
	struct xauto_claim *claim;
	unsigned long handle;

	lockdep_assert_held(&owner->lock);
	xa_for_each(&owner->claims, handle, claim)
		xauto_owner_end_vote(owner, claim, NULL);
}

/* Work: the owner is out of the table, nobody finds it any more. */
static void xauto_owner_reap(struct work_struct *work)
{
	struct xauto_owner *owner = container_of(work, struct xauto_owner, reap);
	struct xauto_claim *claim;
	unsigned long handle;

	mutex_lock(&owner->lock);
	owner->dead = true; /* nobody starts the watchdog from here on */
	mutex_unlock(&owner->lock);
	cancel_delayed_work_sync(&owner->watchdog);

	mutex_lock(&owner->lock);
	xauto_event_of_owner(XAUTO_KEV_OWNER_GONE, owner->portid, owner->pid);
	/* All votes before any claim: what is suspended comes first. */
	xauto_owner_end_votes(owner);
	xa_for_each(&owner->claims, handle, claim) {
		xa_erase(&owner->claims, handle);
		xauto_queue_put(claim->queue);
		kmem_cache_free(xauto_claim_cache, claim);
	}
	mutex_unlock(&owner->lock);
	xauto_owner_put(owner);
}

static void xauto_owner_watchdog(struct work_struct *work)
{
	struct xauto_owner *owner = container_of(work, struct xauto_owner, watchdog.work);
	unsigned long due;

	mutex_lock(&owner->lock);
	due = READ_ONCE(owner->fed) + msecs_to_jiffies(owner->watchdog_ms);
	if (!owner->n_votes || !owner->watchdog_ms)
		goto out;
	if (time_before(jiffies, due)) {
		queue_delayed_work(xauto_reaper, &owner->watchdog, due - jiffies);
		goto out;
	}
	owner->expired = true;
	xauto_event_of_owner(XAUTO_KEV_WATCHDOG, owner->portid, owner->pid);
	xauto_owner_end_votes(owner);
out:
	mutex_unlock(&owner->lock);
}

static void xauto_owner_start_watchdog(struct xauto_owner *owner)
{
	lockdep_assert_held(&owner->lock);
	if (owner->watchdog_ms && owner->n_votes && !owner->dead)
		mod_delayed_work(xauto_reaper, &owner->watchdog,
				 msecs_to_jiffies(owner->watchdog_ms));
}

static struct xauto_owner *xauto_owner_new(struct sk_buff *skb)
{
	struct xauto_owner *owner = kmem_cache_zalloc(xauto_owner_cache, GFP_KERNEL);

	if (!owner)
		return NULL;
	kref_init(&owner->ref);
	mutex_init(&owner->lock);
	xa_init_flags(&owner->claims, XA_FLAGS_ALLOC1);
	INIT_DELAYED_WORK(&owner->watchdog, xauto_owner_watchdog);
	INIT_WORK(&owner->reap, xauto_owner_reap);
	owner->sk = NETLINK_CB(skb).sk;
	sock_hold(owner->sk);
	owner->portid = NETLINK_CB(skb).portid;
	owner->pid = get_pid(task_tgid(current));
	owner->watchdog_ms = XAUTO_WATCHDOG_DEFAULT_MS;
	owner->fed = jiffies;
	return owner;
}

struct xauto_owner *xauto_owner_get(struct sk_buff *skb, struct netlink_ext_ack *extack)
{
	struct xauto_owner *owner = xauto_owner_find(skb);
	int err;

	if (owner)
		return owner;
	if (atomic_inc_return(&xauto_n_owners) > XAUTO_MAX_OWNERS) {
		atomic_dec(&xauto_n_owners);
		NL_SET_ERR_MSG(extack, "too many owners on this machine");
		return ERR_PTR(-ENOSPC);
	}
	owner = xauto_owner_new(skb);
	if (!owner) {
		atomic_dec(&xauto_n_owners);
		return ERR_PTR(-ENOMEM);
	}
	kref_get(&owner->ref); /* the caller's, beside the table's */
	/* Before others see the owner: what they do with it is swept even if we get no CPU. */
	queue_delayed_work(xauto_reaper, &xauto_sweeper, msecs_to_jiffies(xauto_sweep_ms));
	err = xa_insert(&xauto_owners, owner->portid, owner, GFP_KERNEL);
	if (err) {
		/* Two threads sent on one socket; the other was first. */
		xauto_owner_put(owner);
		xauto_owner_put(owner);
		owner = err == -EBUSY ? xauto_owner_find(skb) : NULL;
		if (!owner && err == -EBUSY)
			NL_SET_ERR_MSG(extack, "the socket's owner just ended; register again");
		return owner ?: ERR_PTR(err == -EBUSY ? -EAGAIN : err);
	}
	return owner;
}

/* 0: none. */
static u32 xauto_owner_find_handle(struct xauto_owner *owner, struct xauto_queue *queue)
{
	struct xauto_claim *claim;
	unsigned long handle;

	lockdep_assert_held(&owner->lock);
	xa_for_each(&owner->claims, handle, claim)
		if (claim->queue == queue)
			return handle;
	return 0;
}

u32 xauto_owner_handle(struct xauto_owner *owner, struct xauto_queue *queue)
{
	u32 handle;

	mutex_lock(&owner->lock);
	handle = xauto_owner_find_handle(owner, queue);
	mutex_unlock(&owner->lock);
	return handle;
}

int xauto_owner_claim(struct xauto_owner *owner, struct xauto_queue *queue, u32 *handle,
		      struct netlink_ext_ack *extack)
{
	struct xauto_claim *claim;
	int err = 0;

	mutex_lock(&owner->lock);
	*handle = xauto_owner_find_handle(owner, queue);
	if (*handle)
		goto put;
	if (owner->dead || owner->n_claims >= XAUTO_MAX_CLAIMS) {
		NL_SET_ERR_MSG(extack, "too many queues on this socket");
		err = -ENOSPC;
		goto put;
	}
	claim = kmem_cache_zalloc(xauto_claim_cache, GFP_KERNEL);
	if (!claim) {
		err = -ENOMEM;
		goto put;
	}
	claim->queue = queue;
	err = xa_alloc_cyclic(&owner->claims, handle, claim, XA_LIMIT(1, INT_MAX),
			      &owner->next_handle, GFP_KERNEL);
	if (err < 0) {
		kmem_cache_free(xauto_claim_cache, claim);
		goto put;
	}
	owner->n_claims++;
	xauto_event_of_queue(XAUTO_KEV_REGISTER, queue, owner->portid, 0, 0);
	mutex_unlock(&owner->lock);
	return 0;
put:
	mutex_unlock(&owner->lock);
	xauto_queue_put(queue);
	return err;
}

int xauto_owner_unclaim(struct xauto_owner *owner, u32 handle)
{
	struct xauto_claim *claim;
	int err;

	mutex_lock(&owner->lock);
	claim = xa_erase(&owner->claims, handle);
	if (!claim) {
		mutex_unlock(&owner->lock);
		return -ENOENT;
	}
	err = xauto_owner_end_vote(owner, claim, NULL);
	owner->n_claims--;
	xauto_event_of_queue(XAUTO_KEV_UNREGISTER, claim->queue, owner->portid, 0, 0);
	mutex_unlock(&owner->lock);
	xauto_queue_put(claim->queue);
	kmem_cache_free(xauto_claim_cache, claim);
	return err == -ENODEV ? 0 : err;
}

int xauto_owner_act(struct xauto_owner *owner, u32 action, u32 handle, u32 value, u64 *cost_ns)
{
	struct xauto_claim *claim;
	int err;

	*cost_ns = 0;
	mutex_lock(&owner->lock);
	claim = owner->dead ? NULL : xa_load(&owner->claims, handle);
	if (!claim) {
		err = -ENOENT;
	} else if (action == XAUTO_ACTION_SUSPEND) {
		bool voted = claim->vote;

		err = xauto_queue_vote(claim->queue, &claim->vote, true, owner->portid, cost_ns);
		if (claim->vote && !voted && !owner->n_votes++)
			xauto_owner_start_watchdog(owner);
	} else if (action == XAUTO_ACTION_RESUME) {
		err = xauto_owner_end_vote(owner, claim, cost_ns);
	} else {
		err = xauto_queue_set(claim->queue, action, value, owner->portid, cost_ns);
	}
	mutex_unlock(&owner->lock);
	return err;
}

struct xauto_queue *xauto_owner_queue(struct xauto_owner *owner, u32 handle)
{
	struct xauto_queue *queue = NULL;
	struct xauto_claim *claim;

	mutex_lock(&owner->lock);
	claim = xa_load(&owner->claims, handle);
	if (claim) {
		queue = claim->queue;
		kref_get(&queue->ref);
	}
	mutex_unlock(&owner->lock);
	return queue;
}

void xauto_owner_set_watchdog(struct xauto_owner *owner, u32 timeout_ms)
{
	mutex_lock(&owner->lock);
	owner->watchdog_ms = timeout_ms;
	xauto_owner_start_watchdog(owner);
	mutex_unlock(&owner->lock);
}

bool xauto_owner_expired(struct xauto_owner *owner)
{
	bool expired;

	mutex_lock(&owner->lock);
	expired = owner->expired;
	owner->expired = false;
	mutex_unlock(&owner->lock);
	return expired;
}

/*
 * Every thread has begun to exit. Its descriptors close then, but the socket may live on in a
 * child.
 */
static bool xauto_process_is_dead(struct pid *pid)
{
	struct task_struct *task;
	bool dead;

	rcu_read_lock();
	task = pid_task(pid, PIDTYPE_TGID);
	dead = !task || !atomic_read(&task->signal->live);
	rcu_read_unlock();
	return dead;
}

static void xauto_sweep(struct work_struct *work)
{
	struct xauto_owner *owner;
	unsigned long portid;

	xa_for_each(&xauto_owners, portid, owner) {
		owner = xauto_owner_look_up(portid);
		if (!owner)
			continue;
		if (xauto_process_is_dead(owner->pid))
			xauto_owner_bury(owner);
		xauto_owner_put(owner);
	}
	if (xauto_queue_sweep() || atomic_read(&xauto_n_owners))
		queue_delayed_work(xauto_reaper, &xauto_sweeper, msecs_to_jiffies(xauto_sweep_ms));
}

static int xauto_on_netlink(struct notifier_block *block, unsigned long state, void *data)
{
	struct netlink_notify *notify = data;
	struct xauto_owner *owner;

	if (state != NETLINK_URELEASE || notify->protocol != NETLINK_GENERIC ||
	    !net_eq(notify->net, &init_net) || !notify->portid)
		return NOTIFY_DONE;
	owner = xauto_owner_look_up(notify->portid);
	if (owner) {
		/* Not one of a socket that was quick to take the port. */
		if (sock_flag(owner->sk, SOCK_DEAD))
			xauto_owner_bury(owner);
		xauto_owner_put(owner);
	}
	return NOTIFY_DONE;
}

static struct notifier_block xauto_netlink_block = { .notifier_call = xauto_on_netlink };

static void xauto_owner_free_caches(void)
{
	/* NULL is none. */
	kmem_cache_destroy(xauto_owner_cache);
	kmem_cache_destroy(xauto_claim_cache);
}

int xauto_owner_init(void)
{
	int err = -ENOMEM;

	xauto_owner_cache = KMEM_CACHE(xauto_owner, SLAB_ACCOUNT);
	xauto_claim_cache = KMEM_CACHE(xauto_claim, SLAB_ACCOUNT);
	if (!xauto_owner_cache || !xauto_claim_cache)
		goto err_caches;
	/* Of its own, and urgent: what is suspended waits for it. */
	xauto_reaper = alloc_workqueue("xauto", WQ_UNBOUND | WQ_HIGHPRI | WQ_MEM_RECLAIM, 0);
	if (!xauto_reaper)
		goto err_caches;
	err = netlink_register_notifier(&xauto_netlink_block);
	if (err)
		goto err_reaper;
	xauto_sweep_ms = clamp(xauto_sweep_ms, 1u, 1000u);
	return 0;

err_reaper:
	destroy_workqueue(xauto_reaper);
err_caches:
	xauto_owner_free_caches();
	return err;
}

void xauto_owner_exit(void)
{
	struct xauto_owner *owner;
	unsigned long portid;

	netlink_unregister_notifier(&xauto_netlink_block);
	cancel_delayed_work_sync(&xauto_sweeper);
	xa_for_each(&xauto_owners, portid, owner)
		xauto_owner_bury(owner);
	destroy_workqueue(xauto_reaper); /* waits for them */
	xa_destroy(&xauto_owners);
	rcu_barrier(); /* the last owners are on their way to xauto_owner_free() */
	xauto_owner_free_caches();
}
