/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * DOC: the emulated GPU
 *
 * One engine, a runlist of TSGs, each with channels that hold work in order. The engine runs one
 * TSG at a time for its time slice, then the next runnable one in the runlist; in it, a TSG of a
 * higher interleave level stands before every one of a lower level. Changing the TSG costs saving
 * the old context and restoring the new one.
 *
 *	IDLE --work--> RESTORE --> RUN --slice over, preempted, no work left--> SAVE
 *	SAVE --another has work--> RESTORE of that one; --nobody has--> IDLE
 *
 * A disabled TSG is not picked again; the one that is on the engine stays until its slice ends or
 * it is preempted. A TSG without work stays loaded while nobody else has any.
 *
 * Time is real (ktime); an hrtimer fires at the next change, so the CPU has little to do however
 * long the work is.
 */
#ifndef XAUTO_EMU_GPU_ENGINE_H
#define XAUTO_EMU_GPU_ENGINE_H

#include <linux/hrtimer.h>
#include <linux/kref.h>
#include <linux/list.h>
#include <linux/spinlock.h>
#include <linux/types.h>
#include <linux/wait.h>

struct device;
struct seq_file;

#define GPU_MAX_TSGS 32
#define GPU_MAX_WORK 4096 /* waiting on one channel */

/**
 * struct gpu_tsg - a time slice group
 * @gpu: it belongs to
 * @node: in the GPU's list
 * @channels: bound ones
 * @enabled: may be picked
 * @preempt: asked to leave the engine
 * @lost: power went while its context was off: it can never be enabled again
 * @level: interleave level, 0..2
 * @timeslice_us: how long it may run while others wait
 * @ran_ns: on the engine, switching not counted
 */
struct gpu_tsg {
	struct gpu *gpu;
	struct list_head node;
	struct list_head channels;
	bool enabled;
	bool preempt;
	bool lost;
	u32 level;
	u32 timeslice_us;
	u64 ran_ns;
};

/**
 * struct gpu_channel - a queue of work
 * @ref: its file, and the TSG that it is bound to
 * @gpu: it belongs to
 * @tsg: bound to, or NULL
 * @node: in the TSG's list
 * @work: waiting and running, in order
 * @waiting: length of @work
 * @submitted: number of the last
 * @finished: how many are done
 * @done: woken when one is
 */
struct gpu_channel {
	struct kref ref;
	struct gpu *gpu;
	struct gpu_tsg *tsg;
	struct list_head node;
	struct list_head work;
	u32 waiting;
	u64 submitted;
	u64 finished;
	wait_queue_head_t done;
};

enum gpu_phase { GPU_IDLE, GPU_RESTORE, GPU_RUN, GPU_SAVE };

/**
 * struct gpu - the engine
 * @lock: covers everything of the GPU, its TSGs and channels
 * @dev: powered while not idle
 * @tsgs: all
 * @n_tsgs: length of @tsgs
 * @runlist: the round, rebuilt when a TSG comes, goes or changes level
 * @runlist_length: of @runlist
 * @at: position of the one picked last
 * @phase: what the engine does
 * @current_tsg: whose context is loaded, being saved or restored
 * @phase_end: of SAVE and RESTORE
 * @since: of RUN: up to where work has been accounted for
 * @slice_end: of RUN
 * @timer: the next change
 * @off: woken when a context has left the engine
 * @switches: contexts restored
 */
struct gpu {
	spinlock_t lock; /* the GPU, its TSGs and channels */
	struct device *dev;
	struct list_head tsgs;
	u32 n_tsgs;
	struct gpu_tsg *runlist[2048];
	u32 runlist_length;
	u32 at;
	enum gpu_phase phase;
	struct gpu_tsg *current_tsg;
	u64 phase_end;
	u64 since;
	u64 slice_end;
	struct hrtimer timer;
	wait_queue_head_t off;
	u64 switches;
};

void gpu_init(struct gpu *gpu, struct device *dev);
void gpu_stop(struct gpu *gpu);

struct gpu_tsg *gpu_tsg_new(struct gpu *gpu);
void gpu_tsg_free(struct gpu_tsg *tsg);
int gpu_tsg_enable(struct gpu_tsg *tsg);
void gpu_tsg_disable(struct gpu_tsg *tsg);
/* Waits until it is off the engine. */
int gpu_tsg_preempt(struct gpu_tsg *tsg);
int gpu_tsg_set_level(struct gpu_tsg *tsg, u32 level);
int gpu_tsg_set_timeslice(struct gpu_tsg *tsg, u32 us);

struct gpu_channel *gpu_channel_new(struct gpu *gpu);
void gpu_channel_put(struct gpu_channel *channel);
/* Its file is closed: what waits is dropped. */
void gpu_channel_close(struct gpu_channel *channel);
int gpu_channel_bind(struct gpu_tsg *tsg, struct gpu_channel *channel);
int gpu_channel_submit(struct gpu_channel *channel, u64 duration_ns, u64 *sequence);
bool gpu_channel_idle(struct gpu_channel *channel, u64 *finished);

/* Power is about to go: contexts with unfinished work that are off the engine are lost. */
void gpu_power_off(struct gpu *gpu);
void gpu_show(struct gpu *gpu, struct seq_file *out);

#endif /* XAUTO_EMU_GPU_ENGINE_H */
