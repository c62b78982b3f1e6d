// SPDX-License-Identifier: GPL-2.0-only
/*
 * Owners: sockets, their claims, watchdogs and deaths; owner.h tells the rules.
 */
#include <linux/cred.h>
#include <linux/list.h>
#include <linux/netlink.h>
#include <linux/notifier.h>
#include <linux/pid.h>
#include <linux/sched/signal.h>
#include <linux/slab.h>
#include <linux/spinlock.h>
#include <linux/user_namespace.h>
#include <net/net_namespace.h>
#include <net/sock.h>

#include "compat.h"
#include "device.h"
#include "event.h"
#include "owner.h"
#include "queue.h"

/* An owner whose process dies while a child has the socket, or a driver it, is seen so soon. */
#define XAUTO_LOOK_MS 20

/**
 * struct xauto_claim - in an owner's table of handles
 * @ref: the table's, which the last @end takes over; one while @end is queued, one of a handler
 * @owner: whose it is, with a reference
 * @queue: what it is about, with a reference
 * @stake: what it wants of it, covered by the queue's lock
 * @end: on the device's work queue: ends the vote
 * @final: and everything else; written before @end is queued
 * @done: @end has done so
 */
struct xauto_claim {
	struct kref ref;
	struct xauto_owner *owner;
	struct xauto_queue *queue;
	struct xauto_stake stake;
	struct work_struct end;
	bool final;
	bool done;
};

/* By port id; the array's own lock orders removals. */
static DEFINE_XARRAY(xauto_owners);
/* Those that are about to end as well: they count. */
static struct list_head xauto_all_owners = LIST_HEAD_INIT(xauto_all_owners);
static DEFINE_SPINLOCK(xauto_all_owners_lock);
static DEFINE_MUTEX(xauto_owners_lock); /* additions, and @xauto_closed */
static bool xauto_closed;
static struct workqueue_struct *xauto_reaper; /* no work on it calls a driver */
static struct kmem_cache *xauto_owner_cache; /* caches of their own: a leak shows at unload */
static struct kmem_cache *xauto_claim_cache;

static void xauto_look(struct work_struct *work);
static DECLARE_DELAYED_WORK(xauto_looker, xauto_look);

static void xauto_owner_free(struct rcu_head *rcu)
{
	kmem_cache_free(xauto_owner_cache, container_of(rcu, struct xauto_owner, rcu));
}

static void xauto_owner_release(struct kref *ref)
{
	struct xauto_owner *owner = container_of(ref, struct xauto_owner, ref);

	spin_lock(&xauto_all_owners_lock);
	list_del(&owner->node);
	spin_unlock(&xauto_all_owners_lock);
	xa_destroy(&owner->claims);
	put_pid(owner->pid);
	sock_put(owner->sk);
	call_rcu(&owner->rcu, xauto_owner_free);
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

static void xauto_claim_release(struct kref *ref)
{
	struct xauto_claim *claim = container_of(ref, struct xauto_claim, ref);

	xauto_queue_put(claim->queue);
	xauto_owner_put(claim->owner);
	kmem_cache_free(xauto_claim_cache, claim);
}

static void xauto_claim_put(struct xauto_claim *claim)
{
	kref_put(&claim->ref, xauto_claim_release);
}

/* Work, on the device's queue: it waits for that device and no other. */
static void xauto_claim_end(struct work_struct *work)
{
	struct xauto_claim *claim = container_of(work, struct xauto_claim, end);
	bool final = READ_ONCE(claim->final);

	xauto_queue_want(claim->queue, &claim->stake, final ? XAUTO_WANT_NOTHING : XAUTO_WANT_OLD,
			 claim->owner->portid, NULL);
	if (final && !claim->done) {
		claim->done = true;
		xauto_claim_put(claim); /* the table's */
	}
	xauto_claim_put(claim); /* this work's */
}

/* @final: it is out of its table. */
static void xauto_claim_queue_end(struct xauto_claim *claim, bool final)
{
	kref_get(&claim->ref);
	if (final)
		WRITE_ONCE(claim->final, true);
	if (!queue_work(claim->queue->device->works, &claim->end))
		xauto_claim_put(claim); /* it is queued already, and will see @final */
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
	xa_for_each(&owner->claims, handle, claim) {
		xa_erase(&owner->claims, handle);
		xauto_claim_queue_end(claim, true);
	}
	mutex_unlock(&owner->lock);
	xauto_owner_put(owner);
}

static void xauto_owner_watchdog(struct work_struct *work)
{
	struct xauto_owner *owner = container_of(work, struct xauto_owner, watchdog.work);
	struct xauto_claim *claim;
	unsigned long handle, due;

	mutex_lock(&owner->lock);
	due = READ_ONCE(owner->fed) + msecs_to_jiffies(owner->watchdog_ms);
	if (!atomic_read(&owner->n_votes) || !owner->watchdog_ms)
		goto out;
	if (time_before(jiffies, due)) {
		queue_delayed_work(xauto_reaper, &owner->watchdog, due - jiffies);
		goto out;
	}
	owner->expired = true;
	xauto_event_of_owner(XAUTO_KEV_WATCHDOG, owner->portid, owner->pid);
	xa_for_each(&owner->claims, handle, claim) {
		WRITE_ONCE(claim->stake.bitten, true);
		xauto_claim_queue_end(claim, false);
	}
out:
	mutex_unlock(&owner->lock);
}

static void xauto_owner_start_watchdog(struct xauto_owner *owner)
{
	lockdep_assert_held(&owner->lock);
	if (owner->watchdog_ms && atomic_read(&owner->n_votes) && !owner->dead)
		mod_delayed_work(xauto_reaper, &owner->watchdog,
				 msecs_to_jiffies(owner->watchdog_ms));
}

/*
 * Whose share of the table the caller takes: in a user namespace its creator's, who may have
 * thousands of user ids there.
 */
static kuid_t xauto_owner_payer(void)
{
	struct user_namespace *ns;
	kuid_t uid = current_euid();

	for (ns = current_user_ns(); ns != &init_user_ns; ns = ns->parent)
		uid = ns->owner;
	return uid;
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
	owner->uid = xauto_owner_payer();
	owner->pid = get_pid(task_tgid(current));
	owner->watchdog_ms = XAUTO_WATCHDOG_DEFAULT_MS;
	owner->fed = jiffies;
	spin_lock(&xauto_all_owners_lock);
	list_add(&owner->node, &xauto_all_owners);
	spin_unlock(&xauto_all_owners_lock);
	return owner;
}

/* Is there room for one more of this user's? 0, or a negative errno with its text. */
static int xauto_owner_admit(struct sk_buff *skb, struct netlink_ext_ack *extack)
{
	bool may_reserve = netlink_ns_capable(skb, &init_user_ns, CAP_SYS_NICE);
	kuid_t payer = xauto_owner_payer();
	struct xauto_owner *owner;
	u32 all = 0, mine = 0;

	lockdep_assert_held(&xauto_owners_lock);
	if (xauto_closed) {
		NL_SET_ERR_MSG(extack, "the module is being unloaded");
		return -ESHUTDOWN;
	}
	spin_lock(&xauto_all_owners_lock);
	list_for_each_entry(owner, &xauto_all_owners, node) {
		all++;
		mine += uid_eq(owner->uid, payer);
	}
	spin_unlock(&xauto_all_owners_lock);
	if (all >= XAUTO_MAX_OWNERS - (may_reserve ? 0 : XAUTO_RESERVED_OWNERS)) {
		NL_SET_ERR_MSG(extack, "too many owners on this machine");
		return -ENOSPC;
	}
	if (!may_reserve && mine >= XAUTO_MAX_USER_OWNERS) {
		NL_SET_ERR_MSG(extack, "too many owners of this user");
		return -ENOSPC;
	}
	return 0;
}

/* A new one in the table, or the one that another thread has made for this socket just now. */
static struct xauto_owner *xauto_owner_add(struct sk_buff *skb, struct netlink_ext_ack *extack)
{
	struct xauto_owner *owner = xauto_owner_find(skb);
	int err;

	if (owner)
		return owner;
	err = xauto_owner_admit(skb, extack);
	if (err)
		return ERR_PTR(err);
	owner = xauto_owner_new(skb);
	if (!owner)
		return ERR_PTR(-ENOMEM);
	kref_get(&owner->ref); /* the caller's, beside the table's */
	/* Before others see the owner: its process is looked at even if we get no CPU. */
	queue_delayed_work(xauto_reaper, &xauto_looker, msecs_to_jiffies(XAUTO_LOOK_MS));
	err = xa_insert(&xauto_owners, owner->portid, owner, GFP_KERNEL);
	if (err) {
		xauto_owner_put(owner);
		xauto_owner_put(owner);
		return ERR_PTR(err);
	}
	return owner;
}

struct xauto_owner *xauto_owner_get(struct sk_buff *skb, struct netlink_ext_ack *extack)
{
	struct xauto_owner *owner = xauto_owner_find(skb);

	if (owner)
		return owner;
	mutex_lock(&xauto_owners_lock);
	owner = xauto_owner_add(skb, extack);
	mutex_unlock(&xauto_owners_lock);
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
	kref_init(&claim->ref);
	INIT_WORK(&claim->end, xauto_claim_end);
	claim->stake.votes = &owner->n_votes;
	claim->owner = owner;
	claim->queue = queue;
	err = xa_alloc_cyclic(&owner->claims, handle, claim, XA_LIMIT(1, INT_MAX),
			      &owner->next_handle, GFP_KERNEL);
	if (err < 0) {
		kmem_cache_free(xauto_claim_cache, claim);
		goto put;
	}
	kref_get(&owner->ref);
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
	if (claim)
		owner->n_claims--;
	mutex_unlock(&owner->lock);
	if (!claim)
		return -ENOENT;
	err = xauto_queue_want(claim->queue, &claim->stake, XAUTO_WANT_NOTHING, owner->portid,
			       NULL);
	if (err == -EINTR) { /* the caller dies; we do not */
		xauto_claim_queue_end(claim, true);
		return err;
	}
	xauto_event_of_queue(XAUTO_KEV_UNREGISTER, claim->queue, owner->portid, 0, 0);
	xauto_claim_put(claim);
	return err == -ENODEV ? 0 : err;
}

/* With a reference, or NULL. */
static struct xauto_claim *xauto_owner_claim_of(struct xauto_owner *owner, u32 handle)
{
	struct xauto_claim *claim;

	mutex_lock(&owner->lock);
	claim = owner->dead ? NULL : xa_load(&owner->claims, handle);
	if (claim)
		kref_get(&claim->ref);
	mutex_unlock(&owner->lock);
	return claim;
}

/* It is suspended, and stays so for the watchdog's time from here on, unless that bit meanwhile. */
static int xauto_owner_answer_for(struct xauto_owner *owner, struct xauto_stake *stake)
{
	int err = 0;

	mutex_lock(&owner->lock);
	if (READ_ONCE(stake->bitten)) {
		err = -ETIMEDOUT;
	} else {
		WRITE_ONCE(owner->fed, jiffies);
		if (!delayed_work_pending(&owner->watchdog))
			xauto_owner_start_watchdog(owner);
	}
	mutex_unlock(&owner->lock);
	return err;
}

int xauto_owner_act(struct xauto_owner *owner, u32 action, u32 handle, u32 value, u64 *cost_ns)
{
	struct xauto_claim *claim = xauto_owner_claim_of(owner, handle);
	int err;

	*cost_ns = 0;
	if (!claim)
		return -ENOENT;
	if (action == XAUTO_ACTION_SUSPEND) {
		err = xauto_queue_want(claim->queue, &claim->stake, XAUTO_WANT_SUSPENDED,
				       owner->portid, cost_ns);
		if (!err)
			err = xauto_owner_answer_for(owner, &claim->stake);
	} else if (action == XAUTO_ACTION_RESUME) {
		err = xauto_queue_want(claim->queue, &claim->stake, XAUTO_WANT_RUN, owner->portid,
				       cost_ns);
	} else {
		err = xauto_queue_set(claim->queue, &claim->stake, action, value, owner->portid,
				      cost_ns);
	}
	xauto_claim_put(claim);
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
 * Every thread has begun to exit, or has to: one may be in a driver for a second, and the socket
 * stays open as long. Descriptors close then, but the socket may live on in a child.
 */
static bool xauto_process_is_dead(struct pid *pid)
{
	struct task_struct *task;
	bool dead;

	rcu_read_lock();
	task = pid_task(pid, PIDTYPE_TGID);
	dead = !task || !atomic_read(&task->signal->live) ||
	       (READ_ONCE(task->signal->flags) & SIGNAL_GROUP_EXIT);
	rcu_read_unlock();
	return dead;
}

static void xauto_look(struct work_struct *work)
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
	mutex_lock(&xauto_owners_lock);
	if (!xa_empty(&xauto_owners) && !xauto_closed)
		queue_delayed_work(xauto_reaper, &xauto_looker, msecs_to_jiffies(XAUTO_LOOK_MS));
	mutex_unlock(&xauto_owners_lock);
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
	return 0;

err_reaper:
	destroy_workqueue(xauto_reaper);
err_caches:
	xauto_owner_free_caches();
	return err;
}

void xauto_owner_stop(void)
{
	struct xauto_owner *owner;
	unsigned long portid;

	mutex_lock(&xauto_owners_lock);
	xauto_closed = true;
	mutex_unlock(&xauto_owners_lock);
	cancel_delayed_work_sync(&xauto_looker);
	xa_for_each(&xauto_owners, portid, owner)
		xauto_owner_bury(owner);
	flush_workqueue(xauto_reaper);
	xauto_device_flush();
}

void xauto_owner_exit(void)
{
	netlink_unregister_notifier(&xauto_netlink_block);
	destroy_workqueue(xauto_reaper);
	xauto_device_flush(); /* claims of handlers that were at work */
	xa_destroy(&xauto_owners);
	rcu_barrier(); /* the last owners are on their way to xauto_owner_free() */
	xauto_owner_free_caches();
}
