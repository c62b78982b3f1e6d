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

/**
 * struct thread_entry - whose slot it is. Map "threads". A thread enters itself (lib/kernel/thread_slots.cc)
 * and is taken out when it ends. The key: the inode of its PID namespace << 32 | its id there, which is
 * all that a thread in a container knows of itself.
 * @slot:       element of "slots" and "jobs"
 * @entered_ns: when. Ids are used again: a thread that began later is another one
 */
struct thread_entry {
	u64 slot;
	u64 entered_ns;
};

#define XAUTO_MAP_THREADS                                       \
	struct {                                                \
		__uint(type, BPF_MAP_TYPE_HASH);                \
		__uint(max_entries, XAUTO_BPF_MAX_SLOTS);       \
		__type(key, u64);                               \
		__type(value, struct thread_entry);             \
	} threads SEC(".maps")

#endif /* _XAUTO_MAPS_BPF_H */
