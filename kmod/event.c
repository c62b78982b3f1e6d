// SPDX-License-Identifier: GPL-2.0-only
/*
 * What happens, told to whoever listens. The lowest layer beside the drivers' calls: owner.c and
 * queue.c call it, it calls none of ours. The generic-netlink family is netlink.c's, which hands
 * it over while it is registered.
 */
#include <linux/ktime.h>
#include <linux/pid.h>
#include <linux/rwsem.h>
#include <net/genetlink.h>
#include <net/net_namespace.h>

#include <uapi/xauto/netlink.h>

#include "event.h"
#include "queue.h"
#define CREATE_TRACE_POINTS
#include "trace.h"

static DECLARE_RWSEM(xauto_event_lock); /* xauto_event_family; innermost of all locks */
static struct genl_family *xauto_event_family; /* NULL: not registered, nobody can listen */

void xauto_event_publish_to(struct genl_family *family)
{
	down_write(&xauto_event_lock);
	xauto_event_family = family;
	up_write(&xauto_event_lock);
}

static struct sk_buff *xauto_event_message(u32 kind, struct xauto_queue *queue, struct pid *pid,
					   u32 portid, u64 cost_ns, int err)
{
	struct sk_buff *msg = genlmsg_new(NLMSG_DEFAULT_SIZE, GFP_KERNEL);
	void *header;

	if (!msg)
		return NULL;
	header = genlmsg_put(msg, 0, 0, xauto_event_family, 0, XAUTO_CMD_EVENT);
	if (!header || nla_put_u32(msg, XAUTO_A_EVENT, kind) ||
	    (queue && (nla_put_u32(msg, XAUTO_A_QUEUE, queue->id) ||
		       nla_put_u32(msg, XAUTO_A_TYPE, queue->type))) ||
	    nla_put_u32(msg, XAUTO_A_PID, pid_nr(pid)) ||
	    nla_put_u32(msg, XAUTO_A_PORTID, portid) ||
	    nla_put_u64_64bit(msg, XAUTO_A_TIME_NS, ktime_get_ns(), XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_COST_NS, cost_ns, XAUTO_A_PAD) ||
	    nla_put_u32(msg, XAUTO_A_ERRNO, -err) ||
	    (kind == XAUTO_KEV_ESCAPED &&
	     nla_put_u64_64bit(msg, XAUTO_A_ESCAPES, queue->stats.escapes, XAUTO_A_PAD))) {
		nlmsg_free(msg);
		return NULL;
	}
	genlmsg_end(msg, header);
	return msg;
}

static void xauto_event_multicast(u32 kind, struct xauto_queue *queue, struct pid *pid, u32 portid,
				  u64 cost_ns, int err)
{
	struct sk_buff *msg;

	down_read(&xauto_event_lock);
	if (xauto_event_family && genl_has_listeners(xauto_event_family, &init_net, 0)) {
		msg = xauto_event_message(kind, queue, pid, portid, cost_ns, err);
		if (msg) /* a listener that must miss nothing reads the trace events */
			genlmsg_multicast(xauto_event_family, msg, 0, 0, GFP_KERNEL);
	}
	up_read(&xauto_event_lock);
}

void xauto_event_of_queue(u32 kind, struct xauto_queue *queue, u32 portid, u64 cost_ns, int err)
{
	switch (kind) {
	case XAUTO_KEV_REGISTER:
		trace_register_queue(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_UNREGISTER:
		trace_unregister_queue(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_SUSPEND:
		trace_suspend(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_RESUME:
		trace_resume(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_SET_TIMESLICE:
		trace_set_timeslice(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_SET_INTERLEAVE:
		trace_set_interleave(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_TARGET_GONE:
		trace_target_gone(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_ESCAPED:
		trace_escaped(queue, portid, cost_ns, err);
		break;
	case XAUTO_KEV_GATED:
		trace_gated(queue, portid, cost_ns, err);
		break;
	}
	xauto_event_multicast(kind, queue, queue->pid, portid, cost_ns, err);
}

void xauto_event_of_owner(u32 kind, u32 portid, struct pid *pid)
{
	if (kind == XAUTO_KEV_WATCHDOG)
		trace_watchdog(portid, pid_nr(pid));
	else
		trace_owner_gone(portid, pid_nr(pid));
	xauto_event_multicast(kind, NULL, pid, portid, 0, 0);
}
