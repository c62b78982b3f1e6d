/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What we use of the kernel's types, by name. libbpf finds each member in the running kernel's BTF and
 * patches the offsets (CO-RE), so only names matter here and one object fits every kernel; no kernel
 * header and no vmlinux.h is needed to build. Enumerators that differ between kernels are read with
 * bpf_core_enum_value(); the values given here are placeholders then.
 */
#ifndef _XAUTO_KERNEL_BPF_H
#define _XAUTO_KERNEL_BPF_H

typedef signed char __s8;
typedef unsigned char __u8;
typedef short __s16;
typedef unsigned short __u16;
typedef int __s32;
typedef unsigned int __u32;
typedef long long __s64;
typedef unsigned long long __u64;
typedef __u16 __be16;
typedef __u32 __be32;
typedef __u64 __be64;
typedef __u16 __le16;
typedef __u32 __le32;
typedef __u64 __le64;
typedef __u32 __wsum;
typedef __s32 s32;
typedef __u32 u32;
typedef __s64 s64;
typedef __u64 u64;
#ifndef __cplusplus
typedef _Bool bool;
#define true 1
#define false 0
#define NULL ((void *)0)
#endif
#define XAUTO_BPF_TYPES_ARE_DEFINED

enum bpf_map_type {
	BPF_MAP_TYPE_HASH = 1,
	BPF_MAP_TYPE_ARRAY = 2,
	BPF_MAP_TYPE_PERF_EVENT_ARRAY = 4,
	BPF_MAP_TYPE_PERCPU_ARRAY = 6,
	BPF_MAP_TYPE_LRU_HASH = 9,
	BPF_MAP_TYPE_RINGBUF = 27,
	BPF_MAP_TYPE_CGRP_STORAGE = 32,
};

enum {
	BPF_ANY = 0,
	BPF_F_NO_PREALLOC = 1,
	BPF_F_MMAPABLE = 1U << 10,
	BPF_LOCAL_STORAGE_GET_F_CREATE = 1,
};
#define BPF_F_CURRENT_CPU 0xffffffffULL

#define PF_KTHREAD 0x00200000

#pragma clang attribute push(__attribute__((preserve_access_index)), apply_to = record)

/* Whole, not only declared: libbpf compares the kinds of types that a kfunc's arguments point to. */
struct cpumask {
	unsigned long bits[1];
};

struct scx_dispatch_q {
	u64 id;
};

struct sched_ext_entity {
	struct scx_dispatch_q *dsq;
	u32 flags;
	u32 weight;
	u64 slice;
	u64 dsq_vtime;
	unsigned long runnable_at;
};

struct sched_entity {
	u64 sum_exec_runtime;
};

struct cfs_bandwidth {
	s64 period;
	u64 quota;
};

struct cgroup_subsys_state {
	int id;
};

struct task_group {
	struct cgroup_subsys_state css;
	struct cfs_bandwidth cfs_bandwidth;
};

struct cgroup {
	int level;
	struct cgroup_subsys_state *subsys[1];
};

struct css_set {
	struct cgroup *dfl_cgrp;
};

struct ns_common {
	unsigned int inum;
};

struct pid_namespace {
	struct ns_common ns;
};

struct upid {
	int nr;
	struct pid_namespace *ns;
};

/* One upid per level of namespaces; kernels declare the array as [1], as [] or as [0]. */
struct pid {
	unsigned int level;
	struct upid numbers[1];
};

struct task_struct {
	unsigned int flags;
	unsigned int __state;
	int pid;
	int tgid;
	u64 start_time;
	struct pid *thread_pid;
	struct rt_mutex_waiter *pi_blocked_on;
	int nr_cpus_allowed;
	unsigned short migration_disabled;
	const struct cpumask *cpus_ptr;
	struct css_set *cgroups;
	struct sched_entity se;
	struct sched_ext_entity scx;
	char comm[16];
};

struct rb_node {
	unsigned long __rb_parent_color;
};

struct rb_root_cached {
	struct rb_node *rb_leftmost;
};

struct rt_waiter_node {
	struct rb_node entry;
};

struct rt_mutex_base {
	struct rb_root_cached waiters;
	struct task_struct *owner;
};

struct rt_mutex_waiter {
	struct rt_waiter_node tree;
	struct task_struct *task;
	struct rt_mutex_base *lock;
};

/* Before 5.14 `__state` was called `state`, and was a long. */
struct task_struct___old {
	long state;
};

enum cgroup_subsys_id {
	cpu_cgrp_id,
};

enum scx_exit_kind {
	SCX_EXIT_NONE,
};

struct scx_dump_ctx {
	enum scx_exit_kind kind;
};

struct scx_exit_info {
	enum scx_exit_kind kind;
	s64 exit_code;
	const char *reason;
	char *msg;
	char *dump;
};

#pragma clang attribute pop

/* Read through CO-RE only. */
enum scx_public_consts {
	SCX_SLICE_DFL = 20000000ULL,
	SCX_SLICE_INF = 0xffffffffffffffffULL,
};
enum scx_dsq_id_flags {
	SCX_DSQ_LOCAL = 0x8000000000000002ULL,
	SCX_DSQ_LOCAL_ON = 0xC000000000000000ULL,
};
enum scx_enq_flags {
	SCX_ENQ_WAKEUP = 1ULL,
	SCX_ENQ_HEAD = 1ULL << 4,
	SCX_ENQ_PREEMPT = 1ULL << 32,
	SCX_ENQ_LAST = 1ULL << 41,
};
enum scx_ent_flags {
	SCX_TASK_QUEUED = 1,
};
enum scx_kick_flags {
	SCX_KICK_IDLE = 1,
	SCX_KICK_PREEMPT = 2,
};

/* These have the same value from 6.12 on. */
enum {
	SCX_OPS_ENQ_LAST = 1 << 1,    /* ... about one whose slice has ended while nobody else is there */
	SCX_OPS_ENQ_EXITING = 1 << 2, /* ... about exiting ones */
};

/*
 * The operations that we implement. libbpf matches members by name, so those that we leave out, and
 * those that a kernel adds, don't matter.
 */
struct sched_ext_ops {
	s32 (*select_cpu)(struct task_struct *, s32, u64);
	void (*enqueue)(struct task_struct *, u64);
	void (*dispatch)(s32, struct task_struct *);
	void (*tick)(struct task_struct *);
	void (*running)(struct task_struct *);
	void (*stopping)(struct task_struct *, bool);
	void (*enable)(struct task_struct *);
	void (*dump)(struct scx_dump_ctx *);
	void (*dump_cpu)(struct scx_dump_ctx *, s32, bool);
	void (*dump_task)(struct scx_dump_ctx *, struct task_struct *);
	void (*cpu_online)(s32);
	void (*cpu_offline)(s32);
	s32 (*init)(void);
	void (*exit)(struct scx_exit_info *);
	u64 flags;
	u32 timeout_ms;
	u64 hotplug_seq;
	char name[128];
};

/* The kernel's own, found by its name. */
struct bpf_timer {
	__u64 opaque[2];
} __attribute__((aligned(8)));

struct bpf_iter_num {
	__u64 opaque[1];
} __attribute__((aligned(8)));

struct bpf_iter_scx_dsq {
	u64 opaque[6];
} __attribute__((aligned(8)));

#endif /* _XAUTO_KERNEL_BPF_H */
