/* SPDX-License-Identifier: GPL-2.0-only */
/* Every action is told twice: as a trace event and to the multicast group. */
#ifndef XAUTO_EVENT_H
#define XAUTO_EVENT_H

#include <linux/types.h>

struct genl_family;
struct pid;
struct xauto_queue;

/*
 * @kind: enum xauto_kevent; a driver's call is told with the queue's lock held; @err: 0 or a
 * negative errno.
 */
void xauto_event_of_queue(u32 kind, struct xauto_queue *queue, u32 portid, u64 cost_ns, int err);
/* XAUTO_KEV_WATCHDOG, XAUTO_KEV_OWNER_GONE. */
void xauto_event_of_owner(u32 kind, u32 portid, struct pid *pid);

/*
 * @family: registered, or NULL. When it returns, nothing is sent to the family before any more, so
 * it may be unregistered.
 */
void xauto_event_publish_to(struct genl_family *family);

#endif /* XAUTO_EVENT_H */
