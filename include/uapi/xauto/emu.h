/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * What the emulator modules (kmod/emu/) take in place of real work: a duration. Everything else
 * about them is nvgpu.h's and nvdla.h's. On a GPU, work goes to a channel; on a DLA, through the
 * driver's own EMU_TASK_SUBMIT.
 *
 * A channel or DLA file polls readable when all work submitted to it has finished; read(2) of 8
 * bytes then gives how many pieces of work that file has finished so far.
 */
#ifndef _UAPI_XAUTO_EMU_H
#define _UAPI_XAUTO_EMU_H

#include <linux/ioctl.h>
#include <linux/types.h>

#define XAUTO_EMU_IOCTL_MAGIC 'X'
#define XAUTO_EMU_TASK_VERSION 1
#define XAUTO_EMU_MAX_DURATION_NS 60000000000ull

/**
 * struct xauto_emu_work - one piece of work
 * @duration_ns: how long the engine takes for it, alone, 1..%XAUTO_EMU_MAX_DURATION_NS
 * @sequence: out: its number on this channel or queue, from 1
 */
struct xauto_emu_work {
	__u64 duration_ns;
	__u64 sequence;
};

/* On a channel that is bound to a TSG. */
#define XAUTO_EMU_IOCTL_SUBMIT _IOWR(XAUTO_EMU_IOCTL_MAGIC, 1, struct xauto_emu_work)

/*
 * NVDLA_IOCTL_EMU_TASK_SUBMIT takes an array of struct xauto_emu_work, version
 * %XAUTO_EMU_TASK_VERSION.
 */

#endif /* _UAPI_XAUTO_EMU_H */
