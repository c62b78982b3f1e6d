/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * The kernel functions (kfuncs) that the scheduler calls, with their older names. A declaration's
 * ___suffix is dropped by libbpf when it looks the name up; weak ones may be missing, and the branch
 * that asks is then removed by the verifier. Each shim says when it can go.
 */
#ifndef _XAUTO_COMPAT_BPF_H
#define _XAUTO_COMPAT_BPF_H

bool bpf_cpumask_test_cpu(u32 cpu, const struct cpumask *cpumask) __ksym;
struct task_struct *bpf_task_from_pid(s32 pid) __ksym;
void bpf_task_release(struct task_struct *p) __ksym;
/* Missing without cgroups. */
struct cgroup *bpf_cgroup_ancestor(struct cgroup *cgrp, int level) __ksym __weak;
void bpf_cgroup_release(struct cgroup *cgrp) __ksym __weak;
void bpf_rcu_read_lock(void)
	__ksym;
void bpf_rcu_read_unlock(void)
	__ksym;
u32 bpf_cpumask_first(const struct cpumask *cpumask) __ksym;
int bpf_iter_num_new(struct bpf_iter_num *it, int start, int end) __ksym;
int *bpf_iter_num_next(struct bpf_iter_num *it) __ksym;
void bpf_iter_num_destroy(struct bpf_iter_num *it) __ksym;

const struct cpumask *scx_bpf_get_online_cpumask(void)
	__ksym;
void scx_bpf_put_cpumask(const struct cpumask *cpumask) __ksym;
s32 scx_bpf_create_dsq(u64 dsq_id, s32 node) __ksym;
s32 scx_bpf_select_cpu_dfl(struct task_struct *p, s32 prev_cpu, u64 wake_flags, bool *is_idle) __ksym;
s32 scx_bpf_pick_idle_cpu(const struct cpumask *cpus_allowed, u64 flags) __ksym;
bool scx_bpf_test_and_clear_cpu_idle(s32 cpu) __ksym;
void scx_bpf_kick_cpu(s32 cpu, u64 flags) __ksym;
s32 scx_bpf_task_cpu(const struct task_struct *p) __ksym;
s32 scx_bpf_dsq_nr_queued(u64 dsq_id) __ksym;
void scx_bpf_dump_bstr(char *fmt, unsigned long long *data, u32 data_len) __ksym;
void scx_bpf_error_bstr(char *fmt, unsigned long long *data, u32 data_len) __ksym;
int bpf_iter_scx_dsq_new(struct bpf_iter_scx_dsq *it, u64 dsq_id, u64 flags) __ksym;
struct task_struct *bpf_iter_scx_dsq_next(struct bpf_iter_scx_dsq *it) __ksym;
void bpf_iter_scx_dsq_destroy(struct bpf_iter_scx_dsq *it) __ksym;

/*
 * Ends the scheduler with a reason: for what cannot be. The text must lie in writable memory, and there is
 * always a parameter, since the kernel wants their array not to be empty.
 */
#define scx_bpf_error(text, param)                                                       \
	({                                                                               \
		static char text_[] = text;                                              \
		unsigned long long param_[] = { (unsigned long long)(param) };           \
		scx_bpf_error_bstr(text_, param_, sizeof(param_));                       \
	})

/* A line of a dump: up to four numbers, or none. */
#define scx_bpf_dump(text, ...)                                                          \
	({                                                                               \
		static char text_[] = text;                                              \
		unsigned long long param_[] = { __VA_ARGS__ };                           \
		scx_bpf_dump_bstr(text_, param_, sizeof(param_));                        \
	})

/* 6.13 renamed dispatch* and consume. The 6.12 names can go when no supported kernel is 6.12. */
void scx_bpf_dsq_insert___k613(struct task_struct *p, u64 dsq_id, u64 slice, u64 enq_flags) __ksym __weak;
void scx_bpf_dispatch___k612(struct task_struct *p, u64 dsq_id, u64 slice, u64 enq_flags) __ksym __weak;
void scx_bpf_dsq_insert_vtime___k613(struct task_struct *p, u64 dsq_id, u64 slice, u64 vtime,
				     u64 enq_flags) __ksym __weak;
void scx_bpf_dispatch_vtime___k612(struct task_struct *p, u64 dsq_id, u64 slice, u64 vtime,
				   u64 enq_flags) __ksym __weak;
bool scx_bpf_dsq_move_to_local___k613(u64 dsq_id) __ksym __weak;
bool scx_bpf_consume___k612(u64 dsq_id) __ksym __weak;
bool scx_bpf_dsq_move___k613(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq_id,
			     u64 enq_flags) __ksym __weak;
bool scx_bpf_dispatch_from_dsq___k612(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq_id,
				      u64 enq_flags) __ksym __weak;

bool scx_bpf_dsq_move_vtime___k613(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq_id,
				   u64 enq_flags) __ksym __weak;
void scx_bpf_dsq_move_set_vtime___k613(struct bpf_iter_scx_dsq *it, u64 vtime) __ksym __weak;
bool scx_bpf_dispatch_vtime_from_dsq___k612(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq_id,
					    u64 enq_flags) __ksym __weak;
void scx_bpf_dispatch_from_dsq_set_vtime___k612(struct bpf_iter_scx_dsq *it, u64 vtime) __ksym __weak;

/* 6.19: setters instead of writing into the task. Older kernels allow the write only. */
bool scx_bpf_task_set_slice___k619(struct task_struct *p, u64 slice) __ksym __weak;
bool scx_bpf_task_set_dsq_vtime___k619(struct task_struct *p, u64 vtime) __ksym __weak;

static __always_inline void insert(struct task_struct *p, u64 dsq, u64 slice, u64 enq_flags)
{
	if (bpf_ksym_exists(scx_bpf_dsq_insert___k613))
		scx_bpf_dsq_insert___k613(p, dsq, slice, enq_flags);
	else
		scx_bpf_dispatch___k612(p, dsq, slice, enq_flags);
}

static __always_inline void insert_vtime(struct task_struct *p, u64 dsq, u64 slice, u64 vtime,
					 u64 enq_flags)
{
	if (bpf_ksym_exists(scx_bpf_dsq_insert_vtime___k613))
		scx_bpf_dsq_insert_vtime___k613(p, dsq, slice, vtime, enq_flags);
	else
		scx_bpf_dispatch_vtime___k612(p, dsq, slice, vtime, enq_flags);
}

static __always_inline bool move_to_local(u64 dsq)
{
	if (bpf_ksym_exists(scx_bpf_dsq_move_to_local___k613))
		return scx_bpf_dsq_move_to_local___k613(dsq);
	return scx_bpf_consume___k612(dsq);
}

static __always_inline bool move_task(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq)
{
	if (bpf_ksym_exists(scx_bpf_dsq_move___k613))
		return scx_bpf_dsq_move___k613(it, p, dsq, 0);
	return scx_bpf_dispatch_from_dsq___k612(it, p, dsq, 0);
}

static __always_inline bool move_task_vtime(struct bpf_iter_scx_dsq *it, struct task_struct *p, u64 dsq,
					    u64 vtime)
{
	if (bpf_ksym_exists(scx_bpf_dsq_move_vtime___k613)) {
		scx_bpf_dsq_move_set_vtime___k613(it, vtime);
		return scx_bpf_dsq_move_vtime___k613(it, p, dsq, 0);
	}
	scx_bpf_dispatch_from_dsq_set_vtime___k612(it, vtime);
	return scx_bpf_dispatch_vtime_from_dsq___k612(it, p, dsq, 0);
}

static __always_inline void set_slice(struct task_struct *p, u64 slice)
{
	if (bpf_ksym_exists(scx_bpf_task_set_slice___k619))
		scx_bpf_task_set_slice___k619(p, slice);
	else
		p->scx.slice = slice;
}

static __always_inline void set_vtime(struct task_struct *p, u64 vtime)
{
	if (bpf_ksym_exists(scx_bpf_task_set_dsq_vtime___k619))
		scx_bpf_task_set_dsq_vtime___k619(p, vtime);
	else
		p->scx.dsq_vtime = vtime;
}

/* Values of 64-bit enumerators differ between kernels (SCX_ENQ_HEAD: 16 on 6.12, 65536 on 7.2). */
#define SCX_VALUE(type, name) bpf_core_enum_value(enum type, name)

#endif /* _XAUTO_COMPAT_BPF_H */
