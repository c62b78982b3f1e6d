/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The trace vocabulary: one fixed record for every layer (runtime, coordinator, kernel, BPF), so
 * that all of them tell one story. Rules: append kinds, never renumber.
 */
#ifndef _UAPI_XAUTO_EVENT_H
#define _UAPI_XAUTO_EVENT_H

#include <linux/types.h>

#define XAUTO_EVENT_VERSION 1

/* What happened. In the order in which one job meets them. */
#define XAUTO_EV_PUBLISH 1   /* a source released a message; seq = its number; arg: see TAKE */
#define XAUTO_EV_ACTIVATE 2  /* all inputs of a module are fresh: its chain starts */
#define XAUTO_EV_READY 3     /* the job was handed to the worker of its XPU */
#define XAUTO_EV_START 4     /* the worker asked for the XPU; arg = us that it was held before */
#define XAUTO_EV_RUN 5       /* the worker may run: exec() is entered */
#define XAUTO_EV_SUSPEND 6   /* the management thread was told to suspend the job's queue */
#define XAUTO_EV_SUSPENDED 7 /* ... and has done so */
#define XAUTO_EV_RESUME 8    /* the management thread was told to resume it */
#define XAUTO_EV_RESUMED 9   /* ... and has done so */
#define XAUTO_EV_FINISH 10   /* exec() returned and the XPU was given back; arg != 0: it failed */
#define XAUTO_EV_DONE 11     /* the module's chain ended and its outputs are published */
#define XAUTO_EV_DROP 12     /* an activation was dropped; arg = XAUTO_DROP_* */

/*
 * With several rates, after ACTIVATE, once per input: seq = when the sensor released what was taken
 * (its origin, ts_ns); arg = the module that published it, or XAUTO_TAKE_SOURCE | the source's
 * index. PUBLISH has such an arg, too; 0 where one event is told for all sources. In both
 * XAUTO_RELEASE_URGENT says that the source, or a module on the way, marked it urgent.
 */
#define XAUTO_EV_TAKE 13

#define XAUTO_EV_MISS 14 /* a result was later than its deadline, or lost; arg = latency, us */
#define XAUTO_EV_HANG 15 /* a job ran past its hang limit; arg = the limit, ms */

/*
 * Before RUN of a module's first XNode, once per topic that it samples: seq = the number of the
 * message that it reads (of the activation that published it, or of the source's release), or
 * XAUTO_SAMPLE_NONE; arg as TAKE's.
 */
#define XAUTO_EV_SAMPLE 16
#define XAUTO_SAMPLE_NONE 0xffffffffffffffffull

#define XAUTO_TAKE_SOURCE 0x80000000u
#define XAUTO_RELEASE_URGENT 0x40000000u

/*
 * The job is suspended, and the more urgent XNode `arg` waits for its work: it goes by that one's
 * urgency until it ends.
 */
#define XAUTO_EV_HELD_UP 17

/*
 * With tables, before PUBLISH: another scenario counts from release seq on. module = the table that
 * it has; arg = the scenario, and above 16 bits why (lib/model/tables.h); xnode = whose job
 * was the reason, if one was.
 */
#define XAUTO_EV_SWITCH 18

/* Before FINISH of a job on a real core: the kernel ran others there meanwhile, for arg us. */
#define XAUTO_EV_NO_CORE 19

#define XAUTO_DROP_FAILED 1   /* exec threw or returned an error */
#define XAUTO_DROP_UPSTREAM 2 /* an input of this activation was dropped upstream */
#define XAUTO_DROP_OVERRUN 3  /* a newer message replaced it before the module was free */
#define XAUTO_DROP_DIED 4     /* the process of the module died */
#define XAUTO_DROP_HUNG 5     /* an XNode ran past its hang limit and was given up */
#define XAUTO_DROP_OFF 6      /* none: the release's table has the module off */
#define XAUTO_DROP_SKIPPED 7  /* none: skipped as was told, or a change of tables drains */

#define XAUTO_EV_NONE 0xffff /* xnode, module, xpu: not applicable */

/**
 * struct xauto_event - one step of one job
 * @ts_ns:  CLOCK_MONOTONIC, nanoseconds
 * @seq:    number of the activation (of the sensor release it stems from)
 * @xnode:  index into the app's xnodes, XAUTO_EV_NONE if the event is a module's
 * @module: index into the app's modules
 * @xpu:    index into the platform's XPUs
 * @kind:   XAUTO_EV_*
 * @arg:    depends on @kind
 * @stamp:  of the slot in the ring (lib/trace/trace.h), zero elsewhere
 */
struct xauto_event {
	__u64 ts_ns;
	__u64 seq;
	__u16 xnode;
	__u16 module;
	__u16 xpu;
	__u16 kind;
	__u32 arg;
	__u32 stamp;
};

#endif /* _UAPI_XAUTO_EVENT_H */
