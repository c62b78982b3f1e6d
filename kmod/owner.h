/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * DOC: owners
 *
 * An owner is a netlink socket on which something was registered. Its claims, one per queue, carry
 * its votes. All votes of an owner end together when
 *   - its socket closes (netlink's release notifier),
 *   - the process that first registered on it dies while another holds the socket (the sweeper
 *     sees it),
 *   - its watchdog was not fed (it stays, without the votes that it had then),
 *   - the module unloads.
 * A port id does not name a socket for ever: it is free before the notifier is called, so that
 * another process may have a socket on it by then. Hence an owner holds its socket, a message finds
 * only the owner of the socket it came from, and the notifier takes none whose socket lives.
 *
 * The notifier only takes the owner out of the table; the driver calls happen on the work queues of
 * the devices, a work item for each claim. So no exiting process waits for a driver, and no queue
 * for another queue's driver call.
 *
 * Locks: owner->lock covers claims and the watchdog's settings. No driver is called with it held,
 * and no queue's lock is taken inside it.
 */
#ifndef XAUTO_OWNER_H
#define XAUTO_OWNER_H

#include <linux/atomic.h>
#include <linux/kref.h>
#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/rcupdate.h>
#include <linux/types.h>
#include <linux/uidgid.h>
#include <linux/workqueue.h>
#include <linux/xarray.h>

struct netlink_ext_ack;
struct pid;
struct sk_buff;
struct sock;
struct xauto_queue;

#define XAUTO_MAX_CLAIMS 256 /* of one owner */

/**
 * struct xauto_owner - a netlink socket
 * @ref: one of the table's, one of a handler at work, one while a work item is queued
 * @rcu: the table is read without a lock
 * @node: in the list of all
 * @sk: the socket, held so that no other has its address
 * @portid: its name in events, and the table's key
 * @uid: whose share of the table it takes; of user namespaces the outermost one's creator
 * @pid: the process that registered first
 * @lock: covers everything below except @n_votes and @fed
 * @claims: handle to struct xauto_claim
 * @next_handle: for xa_alloc_cyclic(): a handle is not soon used again
 * @n_claims: in @claims
 * @n_votes: claims with a vote
 * @dead: takes no more claims and votes
 * @expired: the watchdog bit since the owner last asked
 * @watchdog_ms: 0: none
 * @fed: jiffies of the last message
 * @watchdog: due while @n_votes > 0
 * @reap: hands all claims to their devices' work queues, to end
 */
struct xauto_owner {
	struct kref ref;
	struct rcu_head rcu;
	struct list_head node;
	struct sock *sk;
	u32 portid;
	kuid_t uid;
	struct pid *pid;
	struct mutex lock; /* everything below except @n_votes and @fed */
	struct xarray claims;
	u32 next_handle;
	u32 n_claims;
	atomic_t n_votes;
	bool dead;
	bool expired;
	u32 watchdog_ms;
	unsigned long fed;
	struct delayed_work watchdog;
	struct work_struct reap;
};

/* The owner that this message's socket is, fed, with a reference; NULL if it is none. */
struct xauto_owner *xauto_owner_find(struct sk_buff *skb);
/* ... made if it is none; an ERR_PTR with the extack set on failure. */
struct xauto_owner *xauto_owner_get(struct sk_buff *skb, struct netlink_ext_ack *extack);
void xauto_owner_put(struct xauto_owner *owner);

/* Takes over the caller's reference to the queue, also on failure. */
int xauto_owner_claim(struct xauto_owner *owner, struct xauto_queue *queue, u32 *handle,
		      struct netlink_ext_ack *extack);
int xauto_owner_unclaim(struct xauto_owner *owner, u32 handle);

/* An action of XAUTO_CMD_CONTROL. -ENOENT: no such handle. */
int xauto_owner_act(struct xauto_owner *owner, u32 action, u32 handle, u32 value, u64 *cost_ns);

/* The claim's queue with a reference, or NULL. */
struct xauto_queue *xauto_owner_queue(struct xauto_owner *owner, u32 handle);
/* This owner's handle of a queue; 0: none. */
u32 xauto_owner_handle(struct xauto_owner *owner, struct xauto_queue *queue);

void xauto_owner_set_watchdog(struct xauto_owner *owner, u32 timeout_ms);
/* Did the watchdog bite since this was last asked? */
bool xauto_owner_expired(struct xauto_owner *owner);

int xauto_owner_init(void);
/* Messages may still come, but make no owner any more: ends all, and waits until all is resumed. */
void xauto_owner_stop(void);
/* No message can come any more. */
void xauto_owner_exit(void);

#endif /* XAUTO_OWNER_H */
