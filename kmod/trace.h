/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Trace events xauto:*, for bpftool, bpftrace, perf and trace-cmd. Fields are append only.
 */
#undef TRACE_SYSTEM
#define TRACE_SYSTEM xauto

#if !defined(XAUTO_TRACE_H) || defined(TRACE_HEADER_MULTI_READ)
#define XAUTO_TRACE_H

#include <linux/pid.h>
#include <linux/tracepoint.h>

#include "queue.h"

/* perf and trace-cmd read the events' formats, where a name without its value means nothing. */
TRACE_DEFINE_ENUM(XAUTO_QUEUE_GPU_TSG);
TRACE_DEFINE_ENUM(XAUTO_QUEUE_DLA);

DECLARE_EVENT_CLASS(xauto_queue,
	TP_PROTO(struct xauto_queue *queue, u32 portid, u64 cost_ns, int err),
	TP_ARGS(queue, portid, cost_ns, err),
	TP_STRUCT__entry(
		__field(u64, cost_ns)
		__field(u32, queue)
		__field(u32, type)
		__field(s32, pid)
		__field(u32, portid)
		__field(u32, votes)
		__field(s32, err)
		__field(u64, escapes)
	),
	TP_fast_assign(
		__entry->cost_ns = cost_ns;
		__entry->queue = queue->id;
		__entry->type = queue->type;
		__entry->pid = pid_nr(queue->pid);
		__entry->portid = portid;
		__entry->votes = queue->votes;
		__entry->err = err;
		__entry->escapes = queue->stats.escapes;
	),
	TP_printk("queue=%u type=%s pid=%d portid=%u votes=%u cost_ns=%llu err=%d escapes=%llu",
		  __entry->queue,
		  __print_symbolic(__entry->type, { XAUTO_QUEUE_GPU_TSG, "gpu" },
				   { XAUTO_QUEUE_DLA, "dla" }),
		  __entry->pid, __entry->portid, __entry->votes, __entry->cost_ns, __entry->err,
		  __entry->escapes)
);

#define XAUTO_QUEUE_EVENT(name)                                                            \
	DEFINE_EVENT(xauto_queue, name,                                                    \
		TP_PROTO(struct xauto_queue *queue, u32 portid, u64 cost_ns, int err),     \
		TP_ARGS(queue, portid, cost_ns, err))

XAUTO_QUEUE_EVENT(register_queue);
XAUTO_QUEUE_EVENT(unregister_queue);
XAUTO_QUEUE_EVENT(suspend);
XAUTO_QUEUE_EVENT(resume);
XAUTO_QUEUE_EVENT(set_timeslice);
XAUTO_QUEUE_EVENT(set_interleave);
XAUTO_QUEUE_EVENT(target_gone);
XAUTO_QUEUE_EVENT(escaped);
XAUTO_QUEUE_EVENT(gated);

DECLARE_EVENT_CLASS(xauto_owner,
	TP_PROTO(u32 portid, int pid),
	TP_ARGS(portid, pid),
	TP_STRUCT__entry(
		__field(u32, portid)
		__field(s32, pid)
	),
	TP_fast_assign(
		__entry->portid = portid;
		__entry->pid = pid;
	),
	TP_printk("portid=%u pid=%d", __entry->portid, __entry->pid)
);

DEFINE_EVENT(xauto_owner, watchdog, TP_PROTO(u32 portid, int pid), TP_ARGS(portid, pid));
DEFINE_EVENT(xauto_owner, owner_gone, TP_PROTO(u32 portid, int pid), TP_ARGS(portid, pid));

#endif /* XAUTO_TRACE_H */

#undef TRACE_INCLUDE_PATH
#define TRACE_INCLUDE_PATH .
#undef TRACE_INCLUDE_FILE
#define TRACE_INCLUDE_FILE trace
#include <trace/define_trace.h>
