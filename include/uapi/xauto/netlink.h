/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * xauto.ko's generic-netlink family: suspending and resuming hardware queues (GPU TSGs, DLA
 * queues) of processes. A client can be written from this file alone.
 *
 * Owners
 * ------
 * The socket is the owner. What it suspended is resumed when it closes, when the process that
 * first registered on it dies, when its watchdog is not fed, and when the module unloads. A queue
 * that several owners suspended runs again when the last of them resumed it: suspension is a union
 * of votes, never one owner's word over another's.
 *
 * Commands, each with its attributes (? = optional), the reply after the arrow
 * --------
 * XAUTO_CMD_REGISTER    TYPE, FD, PID?
 *                       ->  HANDLE, QUEUE
 *     FD is a descriptor of the caller's. The module takes its own reference, so the caller may
 *     close it. To register another process's queue, take its descriptor with pidfd_getfd(2),
 *     whose ptrace rules then apply, and say in PID whose it is. Registering a queue again on the
 *     same socket gives the handle it has. A DLA queue that nobody has registered is resumed: its
 *     slot may have been suspended when another process released it.
 *
 * XAUTO_CMD_UNREGISTER  HANDLE
 *     Resumes it first.
 *
 * XAUTO_CMD_CONTROL     OPS { OP { OP_ACTION, OP_HANDLE, OP_VALUE? } ... }
 *                       ->  with NLM_F_ECHO: RESULTS { { HANDLE, COST_NS } ... }
 *     Done in the order given, at most %XAUTO_MAX_OPS. The first that fails ends the message;
 *     those before it stay done; the extended acknowledgment points at it. Suspending what this
 *     owner has suspended, and resuming what it has not, is no error. When a suspend returns, none
 *     of the queue's work runs (GPU) or none is started (DLA: the running task completes).
 *     The drivers enable queues by themselves (a channel that is bound or closed, power that comes
 *     back, a DLA queue that is released and allocated again). So a suspended queue is suspended
 *     again by each further SUSPEND, every 50 ms by the module, and after a system sleep; see
 *     XAUTO_KEV_ESCAPED. Time slice and interleave level last as long as the registration.
 *
 * XAUTO_CMD_WATCHDOG    TIMEOUT_MS?
 *     Sets the owner's watchdog, %XAUTO_WATCHDOG_MIN_MS..%XAUTO_WATCHDOG_MAX_MS; without
 *     TIMEOUT_MS it only feeds it. Every command feeds it too. It bites only while this owner has
 *     something suspended. An owner starts with %XAUTO_WATCHDOG_DEFAULT_MS. 0, no watchdog, needs
 *     CAP_SYS_NICE. Once it has bitten, the next such command answers ETIMEDOUT: what the owner had
 *     suspended runs, or will in a moment. What it suspends from then on, asked or not, stays so.
 *
 * XAUTO_CMD_GET         HANDLE
 *                       ->  one queue, with TIMESLICE_US as the driver says it now (GPU)
 * XAUTO_CMD_GET         (dump)
 *                       ->  every queue that the caller may see
 *     A queue: QUEUE, TYPE, PID, SUSPENDED, VOTES, SUSPENDS, RESUMES, ERRORS, SUSPENDED_NS,
 *     COST_NS (of all driver calls), COST_MAX_NS, ESCAPES, STUCK_MS, GATED, and HANDLE where it is
 *     registered on this socket.
 *     A long dump comes in parts. If a queue came or went between them, what follows carries
 *     NLM_F_DUMP_INTR, the end at the latest: ask again.
 *
 * XAUTO_CMD_EVENT       multicast to the group %XAUTO_MCGRP_EVENTS
 *     EVENT, QUEUE, TYPE, PID, PORTID, TIME_NS, COST_NS, ERRNO; no QUEUE and no TYPE where the
 *     event is an owner's; ESCAPES with XAUTO_KEV_ESCAPED. Needs CAP_NET_ADMIN to join; a kernel
 *     that cannot ask for it (before 5.10.204, and 5.11) has no such group.
 *
 * A context that does not leave
 * --------
 * A GPU gives up after 100 ms or more, and a context that was slow for 3 s in all its life is
 * killed by its driver. So one that failed is left alone for a while (SUSPEND: EBUSY), and once
 * STUCK_MS is %XAUTO_STUCK_MAX_MS it is GATED: never preempted again, for it would not survive it.
 * Its owner has to wait until its work has ended. That is remembered until its process closes it,
 * also while nobody has it registered.
 *
 * Permission
 * ----------
 * The file must have been opened by the caller's effective user, or the caller needs CAP_SYS_NICE
 * in the user namespace of the one who opened it. The family lives in the initial network
 * namespace. One user has at most %XAUTO_MAX_USER_OWNERS owners, those in user namespaces of the
 * user's making included, and the last %XAUTO_RESERVED_OWNERS of the machine's are for those with
 * CAP_SYS_NICE.
 *
 * Errors, with a text in the extended acknowledgment
 * ------
 * EINVAL      an attribute is missing or unknown, or the file is not what TYPE says
 * ERANGE      an attribute is out of range
 * EBADF       no such descriptor in the calling process
 * ESRCH       no such process
 * EPERM       another user's queue, or see XAUTO_CMD_WATCHDOG
 * ENOENT      no such handle on this socket, or nothing is registered on it
 * ENODEV      the queue's process is gone
 * ENOSPC      too many queues or owners
 * EAGAIN      the socket's owner ended just now: register again
 * EBUSY       not tried: the context did not leave the engine before, see above
 * ENODATA     the DLA file has no queue: its process released it
 * EINTR       the caller was killed while it waited for a driver
 * ESHUTDOWN   the module is being unloaded
 * EOPNOTSUPP  a DLA queue has neither time slice nor interleave level
 * ETIMEDOUT   the GPU did not leave the queue in time (it runs again), or the watchdog had expired
 *             (WATCHDOG), or it did while a SUSPEND waited for the driver (it runs again)
 * others      what the driver answered
 *
 * Rules: append attributes and commands, never renumber; unknown attributes are refused.
 * History: 1 - first version.
 *          1 - appended: ESCAPES, GATED, STUCK_MS, their events; EBUSY, ENODATA, EINTR, ESHUTDOWN.
 */
#ifndef _UAPI_XAUTO_NETLINK_H
#define _UAPI_XAUTO_NETLINK_H

#define XAUTO_FAMILY_NAME "xauto"
#define XAUTO_FAMILY_VERSION 1
#define XAUTO_MCGRP_EVENTS "events"

#define XAUTO_MAX_OPS 64
#define XAUTO_WATCHDOG_MIN_MS 10
#define XAUTO_WATCHDOG_MAX_MS 60000
#define XAUTO_WATCHDOG_DEFAULT_MS 1000
#define XAUTO_MAX_OWNERS 1024
#define XAUTO_MAX_USER_OWNERS 128
#define XAUTO_RESERVED_OWNERS 64
#define XAUTO_STUCK_MAX_MS 1500

enum xauto_cmd {
	XAUTO_CMD_UNSPEC,
	XAUTO_CMD_REGISTER,
	XAUTO_CMD_UNREGISTER,
	XAUTO_CMD_CONTROL,
	XAUTO_CMD_WATCHDOG,
	XAUTO_CMD_GET,
	XAUTO_CMD_EVENT,

	__XAUTO_CMD_MAX,
};

#define XAUTO_CMD_MAX (__XAUTO_CMD_MAX - 1)

enum xauto_attr {
	XAUTO_A_UNSPEC,
	XAUTO_A_PAD,
	XAUTO_A_TYPE,		/* u32, enum xauto_queue_type */
	XAUTO_A_FD,		/* s32 */
	XAUTO_A_PID,		/* u32, the process whose queue it is; default: the caller */
	XAUTO_A_HANDLE,		/* u32, of this socket */
	XAUTO_A_QUEUE,		/* u32, of the whole machine */
	XAUTO_A_OPS,		/* array of enum xauto_op_attr nests */
	XAUTO_A_RESULTS,	/* array of nests of HANDLE and COST_NS */
	XAUTO_A_TIMEOUT_MS,	/* u32 */
	XAUTO_A_TIMESLICE_US,	/* u32 */
	XAUTO_A_SUSPENDED,	/* u8, 1: the hardware does not run it */
	XAUTO_A_VOTES,		/* u32, owners that want it suspended */
	XAUTO_A_SUSPENDS,	/* u64 */
	XAUTO_A_RESUMES,	/* u64 */
	XAUTO_A_ERRORS,		/* u64, driver calls that failed */
	XAUTO_A_SUSPENDED_NS,	/* u64, nanoseconds suspended so far */
	XAUTO_A_COST_NS,	/* u64, nanoseconds in the driver */
	XAUTO_A_COST_MAX_NS,	/* u64, the longest of them */
	XAUTO_A_EVENT,		/* u32, enum xauto_kevent */
	XAUTO_A_PORTID,		/* u32, the owner's netlink port; 0: the module itself */
	XAUTO_A_TIME_NS,	/* u64, CLOCK_MONOTONIC when the action ended */
	XAUTO_A_ERRNO,		/* u32, 0 or a positive errno */
	XAUTO_A_ESCAPES,	/* u64, how often it was found running although suspended */
	XAUTO_A_STUCK_MS,	/* u32, preemptions that took 100 ms or more, in sum */
	XAUTO_A_GATED,		/* u8, 1: it is never preempted again */

	__XAUTO_A_MAX,
};

#define XAUTO_A_MAX (__XAUTO_A_MAX - 1)

enum xauto_op_attr {
	XAUTO_OP_UNSPEC,
	XAUTO_OP_ACTION,	/* u32, enum xauto_action */
	XAUTO_OP_HANDLE,	/* u32 */
	XAUTO_OP_VALUE,		/* u32: time slice in microseconds, or interleave level 0..2 */

	__XAUTO_OP_MAX,
};

#define XAUTO_OP_MAX (__XAUTO_OP_MAX - 1)

enum xauto_queue_type {
	XAUTO_QUEUE_GPU_TSG = 1,
	XAUTO_QUEUE_DLA = 2,
};

enum xauto_action {
	XAUTO_ACTION_SUSPEND = 1,
	XAUTO_ACTION_RESUME = 2,
	XAUTO_ACTION_SET_TIMESLICE = 3,	/* GPU only */
	XAUTO_ACTION_SET_INTERLEAVE = 4, /* GPU only */
};

enum xauto_kevent {
	XAUTO_KEV_REGISTER = 1,
	XAUTO_KEV_UNREGISTER = 2,
	XAUTO_KEV_SUSPEND = 3,
	XAUTO_KEV_RESUME = 4,
	XAUTO_KEV_SET_TIMESLICE = 5,
	XAUTO_KEV_SET_INTERLEAVE = 6,
	XAUTO_KEV_WATCHDOG = 7,	/* an owner did not feed it; its queues' RESUME events follow */
	XAUTO_KEV_OWNER_GONE = 8,	/* an owner closed or died; likewise */
	XAUTO_KEV_TARGET_GONE = 9,	/* the queue's process closed it: nobody but us held it */
	/*
	 * It ran although suspended, and was suspended again at TIME_NS. A GPU tells nobody: the
	 * sign is that it had to be waited for. A context that was enabled and had no work is no
	 * escape. After a system sleep all are told. ERRNO ENODATA: the process released its DLA
	 * queue, so nothing is suspended until it has one again.
	 */
	XAUTO_KEV_ESCAPED = 10,
	XAUTO_KEV_GATED = 11,	/* STUCK_MS has reached its limit */
};

#endif /* _UAPI_XAUTO_NETLINK_H */
