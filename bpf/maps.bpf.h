/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * The maps that scheduler, tracer, loader and workers share; include/uapi/xauto/bpf.h says what is in
 * them. xauto_maps.bpf.c makes them, sized for the run; the other objects are given the ones that are
 * there. Each object names only those that it uses.
 */
#ifndef _XAUTO_MAPS_BPF_H
#define _XAUTO_MAPS_BPF_H

#define SHARED_ARRAY(name, elements, element)          \
	struct {                                        \
		__uint(type, BPF_MAP_TYPE_ARRAY);       \
		__uint(max_entries, elements);          \
		__uint(map_flags, BPF_F_MMAPABLE);      \
		__type(key, u32);                       \
		__type(value, element);                 \
	} name SEC(".maps")

#define XAUTO_MAP_HEAD SHARED_ARRAY(head, 1, struct xauto_bpf_head)
#define XAUTO_MAP_TABLE SHARED_ARRAY(table, (XAUTO_BPF_BANKS * XAUTO_BPF_MAX_XNODES), struct xauto_bpf_entry)
#define XAUTO_MAP_SLOTS SHARED_ARRAY(slots, XAUTO_BPF_MAX_SLOTS, struct xauto_bpf_slot)
#define XAUTO_MAP_JOBS SHARED_ARRAY(jobs, XAUTO_BPF_MAX_SLOTS, struct xauto_bpf_job)
#define XAUTO_MAP_SCHED SHARED_ARRAY(sched, 1, struct xauto_bpf_sched)
#define XAUTO_MAP_COUNTS                                        \
	struct {                                                \
		__uint(type, BPF_MAP_TYPE_PERCPU_ARRAY);        \
		__uint(max_entries, 1);                         \
		__type(key, u32);                               \
		__type(value, struct xauto_bpf_counts);         \
	} counts SEC(".maps")
#define XAUTO_MAP_NAMES SHARED_ARRAY(names, XAUTO_BPF_MAX_XNODES, struct xauto_bpf_name)

/* Thread id to slot. A thread enters itself; it is taken out when it ends. */
#define XAUTO_MAP_THREADS                                       \
	struct {                                                \
		__uint(type, BPF_MAP_TYPE_HASH);                \
		__uint(max_entries, XAUTO_BPF_MAX_SLOTS);       \
		__type(key, u32);                               \
		__type(value, u32);                             \
	} threads SEC(".maps")

#endif /* _XAUTO_MAPS_BPF_H */
