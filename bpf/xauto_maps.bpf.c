// SPDX-License-Identifier: GPL-2.0-only
/*
 * No program, only maps: what exists for every run where BPF is permitted, before anybody decides about
 * a scheduler or a tracer. lib/kernel/libbpf/maps.cc sizes and pins them.
 */
#include "kernel.bpf.h"
#include <bpf/bpf_helpers.h>
#include "uapi/xauto/bpf.h"
#include "maps.bpf.h"

char _license[] SEC("license") = "GPL";

XAUTO_MAP_HEAD;
XAUTO_MAP_TABLE;
XAUTO_MAP_SLOTS;
XAUTO_MAP_JOBS;
XAUTO_MAP_SCHED;
XAUTO_MAP_COUNTS;
XAUTO_MAP_NAMES;
XAUTO_MAP_THREADS;
