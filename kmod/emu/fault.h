/* SPDX-License-Identifier: GPL-2.0-only */
/* Faults on demand: counters in debugfs say how many of the next calls fail. */
#ifndef XAUTO_EMU_FAULT_H
#define XAUTO_EMU_FAULT_H

#include <linux/atomic.h>
#include <linux/compiler.h>
#include <linux/types.h>

/* Shall this call fail? Counts it. */
static inline bool xauto_emu_take_fault(u32 *count)
{
	u32 left = READ_ONCE(*count);

	return left && cmpxchg(count, left, left - 1) == left;
}

#endif /* XAUTO_EMU_FAULT_H */
