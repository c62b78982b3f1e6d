/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The BPF maps of one run, pinned as files under /sys/fs/bpf/xauto/RUN/. Who may write each is said
 * beside it. The same header serves BPF programs, the loader and the workers.
 *
 * One job's way through them:
 *
 *   worker            slots[s].key = what its release adds to the XNode's key
 *                     slots[s].job = XAUTO_BPF_JOB(xnode, seq)        stores, no system call
 *   scheduler         sees it at the thread's next wake-up, tick or yield:
 *                     jobs[s] = a copy of table[bank][xnode]          "latched": kept until the next job
 *   worker            slots[s].waiting != 0 after the store: somebody waits for this CPU, so yield
 *
 * The table has XAUTO_BPF_BANKS banks. A writer fills bank (version + 1) % BANKS: of each entry it
 * clears the stamp, writes the rest, sets the stamp to the new version; then it stores head.version. A
 * reader takes the version, copies the entry, and looks whether the stamp is that version. If not, the
 * table was replaced BANKS times meanwhile, and it copies again.
 *
 * A job's urgency is its key, the smaller the more urgent: entry.key of its XNode plus slot.key of its
 * release. A policy of keys has 0 in the table, and the worker tells nominal release + key_us: an instant
 * of CLOCK_MONOTONIC. A priority is a key that no release moves: it is in the table, and the worker tells
 * 0. Each of the two is within +-XAUTO_BPF_KEY_LIMIT, 36 years: the kernel's queue compares modulo 2^64,
 * and two keys must be less than half of that apart.
 *
 * Rules: append, never renumber; padding is zero. Times are CLOCK_MONOTONIC nanoseconds.
 *
 * History: 1 - first version.
 *          2 - the counts are per CPU, in a map of their own; XAUTO_BPF_STAT_NO_SLOT.
 *          3 - keys instead of priorities; XAUTO_BPF_STAT_BAD_KEY.
 *              Map "policy", which stands for itself.
 */
#ifndef _UAPI_XAUTO_BPF_H
#define _UAPI_XAUTO_BPF_H

#ifndef XAUTO_BPF_TYPES_ARE_DEFINED /* BPF programs have them from elsewhere */
#include <linux/types.h>
#endif

#define XAUTO_BPF_ABI 3
#define XAUTO_BPF_ROOT "/sys/fs/bpf/xauto"

#define XAUTO_BPF_BANKS 4
#define XAUTO_BPF_MAX_XNODES 4096
#define XAUTO_BPF_MAX_SLOTS 256	   /* execution threads of one run */
#define XAUTO_BPF_MAX_CPUS 256
#define XAUTO_BPF_DUMP 32768	   /* of a kernel's dump, which is as long by default */
#define XAUTO_BPF_KEY_LIMIT 0x1000000000000000LL /* 2^60 */

/* A job in one word, so that it can be told by one store: XNode + 1 (0: none), its activation. */
#define XAUTO_BPF_JOB_SHIFT 48
#define XAUTO_BPF_JOB_SEQ 0x00007fffffffffffULL
#define XAUTO_BPF_JOB_ENDED 0x0000800000000000ULL /* exec() has returned; the thread keeps its priority */
#define XAUTO_BPF_JOB_EXPECTED XAUTO_BPF_JOB_SEQ /* as a number: no job, but what the thread will run first */
#define XAUTO_BPF_JOB(xnode, seq) \
	((((__u64)(xnode) + 1) << XAUTO_BPF_JOB_SHIFT) | ((__u64)(seq) & XAUTO_BPF_JOB_SEQ))

/**
 * struct xauto_bpf_head - what the maps of this run hold. Map "head", one element.
 * Written by the run that made the maps; @version also by those that joined it. Whoever writes @version,
 * "table" or "names" holds the lock (flock) on XAUTO_BPF_ROOT.
 * @abi:     XAUTO_BPF_ABI, written when all the rest is ready; 0 before
 * @xnodes:  entries per bank of "table", elements of "hist"
 * @slots:   elements of "slots" and "jobs"
 * @pad:     zero
 * @version: of the table in force; its bank is version % XAUTO_BPF_BANKS. 0: no table yet
 * @owner:   pid of the process that made the maps
 */
struct xauto_bpf_head {
	__u32 abi;
	__u32 xnodes;
	__u32 slots;
	__u32 pad;
	__u64 version;
	__u64 owner;
};

/**
 * struct xauto_bpf_entry - one XNode of the policy. Map "table", bank * xnodes + xnode.
 * Written by the run whose XNode it is; of others' entries it copies those in force into the new bank.
 * @version:   stamp: the table version that this entry belongs to
 * @key:       of each of its jobs, before what the release adds
 * @budget_ns: run time after which the job is demoted to an ordinary thread; 0: none
 * @cpu:       the kernel's number of the CPU; XAUTO_BPF_NO_CPU: not an XNode of a CPU
 * @pad:       zero
 */
struct xauto_bpf_entry {
	__u64 version;
	__s64 key;
	__u64 budget_ns;
	__u32 cpu;
	__u32 pad;
};
#define XAUTO_BPF_NO_CPU 0xffffffffU

/**
 * struct xauto_bpf_slot - one execution thread. Map "slots". Two cache lines, by writer.
 * Written by the worker; @key and @asked_ns before @job:
 * @job:      XAUTO_BPF_JOB() of the job that it runs, or is handed next
 * @since_ns: when @job was begun, for the accounting of trace and top; 0: not yet
 * @jobs:     how many jobs it has begun
 * @busy_ns:  time that finished jobs held the XPU (RUN to FINISH, less what they were suspended)
 * @held_ns:  since when the current job holds the XPU; 0: it does not
 * @tid:      the thread; 0: the slot is free, which the scheduler says of a thread that was killed
 * @xpu:      index into the platform's XPUs
 * @key:      what the release of @job adds to its XNode's key
 * @asked_ns: when @job asked for the CPU: equal keys go by that; 0: when the scheduler takes it up
 * Written by the scheduler:
 * @waiting:  not 0: an XNode thread waits for the CPU that this thread has
 * @pad1:     zero
 */
struct xauto_bpf_slot {
	__u64 job;
	__u64 since_ns;
	__u64 jobs;
	__u64 busy_ns;
	__u64 held_ns;
	__u32 tid;
	__u32 xpu;
	__s64 key;
	__u64 asked_ns;

	__u32 waiting;
	__u32 pad1[15];
};

/**
 * struct xauto_bpf_job - what the scheduler goes by for one thread. Map "jobs", by slot.
 * Written by the scheduler only.
 * @job:        the job word that was latched
 * @version:    the table version it was latched from
 * @key:        that table's and what the release adds
 * @budget_ns:  copied from that one table
 * @used_ns:    run time of the job so far
 * @since_ns:   when it asked for the CPU
 * @queued_ns:  since when it waits in the queue; 0: it does not
 * @cpu:        copied from that one table; XAUTO_BPF_NO_CPU also where the key is out of range
 * @flags:      XAUTO_BPF_JOB_DEMOTED
 */
struct xauto_bpf_job {
	__u64 job;
	__u64 version;
	__s64 key;
	__u64 budget_ns;
	__u64 used_ns;
	__u64 since_ns;
	__u64 queued_ns;
	__u32 cpu;
	__u32 flags;
};
#define XAUTO_BPF_JOB_DEMOTED 1U

/* struct xauto_bpf_counts.stats[] */
#define XAUTO_BPF_STAT_QUEUED 0	      /* XNode threads put into a CPU's queue */
#define XAUTO_BPF_STAT_KICKED 1	      /* ... for which the running thread was preempted */
#define XAUTO_BPF_STAT_RECHECKED 2    /* a lost preemption, found again when a thread began to run */
#define XAUTO_BPF_STAT_KEPT 3	      /* slices that ended with nobody more urgent: the thread went on */
#define XAUTO_BPF_STAT_FLOOR 4	      /* ordinary threads served while XNode threads wanted the CPU */
#define XAUTO_BPF_STAT_AGED 5	      /* less urgent XNode threads served after a long wait */
#define XAUTO_BPF_STAT_DEMOTED 6      /* jobs over budget */
#define XAUTO_BPF_STAT_MISPLACED 7    /* jobs whose CPU their affinity forbids: run elsewhere */
#define XAUTO_BPF_STAT_TORN 8	      /* table entries copied again because the table was being replaced */
#define XAUTO_BPF_STAT_LATCHED 9      /* jobs that got their entry */
#define XAUTO_BPF_STAT_UNKNOWN 10     /* job words that name no XNode of the table */
#define XAUTO_BPF_STAT_NO_SLOT 11     /* looks at a thread that entered itself with a slot that there is not */
#define XAUTO_BPF_STAT_BAD_KEY 12     /* jobs whose key is out of range */
#define XAUTO_BPF_STATS 16

/**
 * struct xauto_bpf_counts - what has happened. Map "counts", one element, per CPU: the sum over all CPUs is
 * the count. Written by the scheduler only, by each CPU for itself; a reader may miss the last few.
 * @stats: XAUTO_BPF_STAT_*
 */
struct xauto_bpf_counts {
	__u64 stats[XAUTO_BPF_STATS];
};

/**
 * struct xauto_bpf_sched - the scheduler's state and its post-mortem. Map "sched", one element.
 * Written by the scheduler only.
 * @running:     1 between the scheduler's init and its exit
 * @mode:        XAUTO_BPF_MODE_*
 * @exit_kind:   enum scx_exit_kind of the kernel; 0: it has not ended
 * @exit_code:   as given by the kernel
 * @exit_reason: text of the kernel, ended by 0
 * @exit_msg:    likewise
 */
struct xauto_bpf_sched {
	__u32 running;
	__u32 mode;
	__u64 exit_kind;
	__u64 exit_code;
	char exit_reason[64];
	char exit_msg[192];
};
#define XAUTO_BPF_MODE_FULL 1	 /* every ordinary thread is ours too, in a fair queue */
#define XAUTO_BPF_MODE_PARTIAL 2 /* only SCHED_EXT threads; for isolated CPUs */

/**
 * struct xauto_bpf_name - what the numbers of XNodes mean, for people. Map "names", by XNode.
 * Written by the run whose XNode it is.
 * @xnode: name of the XNode, cut, ended by 0; empty: nobody's row
 * @xpu:   name of its XPU
 * @at:    index of that XPU in the platform
 * @pad:   zero
 */
struct xauto_bpf_name {
	char xnode[48];
	char xpu[24];
	__u32 at;
	__u32 pad;
};

/**
 * struct xauto_bpf_policy - one XNode as the policy in force has it. Map "policy", by the app's XNodes and no more; its
 * name is XAUTO_BPF_POLICY, and `bpftool map dump` prints it by these names. For people and tools: nobody schedules by
 * it. Every run that may make maps has it, with and without BPF programs. Written by the run, anew with each change of
 * its table.
 * @xnode:     name of the XNode, cut, ended by 0
 * @xpu:       name of its XPU; empty: the run places nothing
 * @by:        what its jobs go by: "key_us", "priority"; "nobody": no one schedules; "off": it gets no jobs
 * @keys:      by keys: how many it has; its jobs have them in turn, and @value is the first
 * @value:     key_us: a job is done by its nominal release plus so many microseconds, and who has less time goes first.
 *             priority: the larger goes first
 * @xpu_index: of that XPU in the platform
 * @table:     index of the policy among the run's tables; rows of two tables: it was read while it changed
 */
struct xauto_bpf_policy {
	char xnode[48];
	char xpu[24];
	char by[12];
	__u32 keys;
	__s64 value;
	__u32 xpu_index;
	__u32 table;
};
#define XAUTO_BPF_POLICY "xauto_policy"

/* ---- tracing ------------------------------------------------------------------------------- */

#define XAUTO_BPF_EV_WAKEUP 1  /* the thread became ready; arg: tid that woke it */
#define XAUTO_BPF_EV_RUN 2     /* it got the CPU; delta_ns: since it became ready */
#define XAUTO_BPF_EV_PREEMPT 3 /* it lost the CPU but is ready; delta_ns: ran; arg: tid that has it */
#define XAUTO_BPF_EV_SLEEP 4   /* it gave the CPU away; delta_ns: ran */
#define XAUTO_BPF_EV_MIGRATE 5 /* cpu: the one it goes to */

/**
 * struct xauto_bpf_event - one step of an XNode thread. Maps "events" (ring buffer) and "pipe" (perf).
 * @ts_ns:    when
 * @job:      XAUTO_BPF_JOB() of the thread at that moment
 * @delta_ns: depends on @kind
 * @tid:      the XNode thread
 * @arg:      depends on @kind
 * @slot:     its slot
 * @cpu:      where
 * @kind:     XAUTO_BPF_EV_*
 * @pad:      zero
 * @other:    name of the thread @arg, as far as it is a thread
 */
struct xauto_bpf_event {
	__u64 ts_ns;
	__u64 job;
	__u64 delta_ns;
	__u32 tid;
	__u32 arg;
	__u32 slot;
	__u16 cpu;
	__u16 kind;
	char other[16];
};

/* Bucket i counts [2^i, 2^(i+1)) microseconds, bucket 0 also what is shorter, the last what is longer. */
#define XAUTO_BPF_BUCKETS 24

/**
 * struct xauto_bpf_hist - one XNode's totals. Map "hist", by XNode. Written by the tracer only.
 * @latency:     ready to running, for each time that it was woken
 * @run:         run time per job
 * @wait:        time that a job was ready but did not run, per job
 * @jobs:        jobs counted in @run and @wait
 * @wakeups:     times counted in @latency
 * @preemptions: times that it lost the CPU while ready
 * @migrations:  between CPUs
 * @run_ns, @wait_ns: sums
 * @latency_max_ns:   largest
 */
struct xauto_bpf_hist {
	__u64 latency[XAUTO_BPF_BUCKETS];
	__u64 run[XAUTO_BPF_BUCKETS];
	__u64 wait[XAUTO_BPF_BUCKETS];
	__u64 jobs;
	__u64 wakeups;
	__u64 preemptions;
	__u64 migrations;
	__u64 run_ns;
	__u64 wait_ns;
	__u64 latency_max_ns;
};

/**
 * struct xauto_bpf_cpu - one CPU. Map "cpus", by CPU. Written by the tracer only.
 * @xnode_ns: time that XNode threads had it
 * @other_ns: time that other threads had it; the rest of the time it was idle
 * @since_ns: begin of the present stretch
 */
struct xauto_bpf_cpu {
	__u64 xnode_ns;
	__u64 other_ns;
	__u64 since_ns;
};

/**
 * struct xauto_bpf_losses - what the tracer could not tell. Map "losses", one element.
 * @events: records for which "events" had no room
 * @pipe:   records that a reader of "pipe" did not get
 * @jobs:   jobs that began and ended between two looks of the tracer: not in the histograms
 * @written: records that were written to "events"
 */
struct xauto_bpf_losses {
	__u64 events;
	__u64 pipe;
	__u64 jobs;
	__u64 written;
};

#ifndef __cplusplus
#define XAUTO_BPF_ASSERT(what) _Static_assert(what, #what)
#else
#define XAUTO_BPF_ASSERT(what) static_assert(what, #what)
#endif
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_head) == 32);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_entry) == 32);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_slot) == 128);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_job) == 64);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_sched) == 280);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_name) == 80);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_policy) == 104);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_event) == 56);
XAUTO_BPF_ASSERT(sizeof(struct xauto_bpf_hist) == 632);

#endif /* _UAPI_XAUTO_BPF_H */
