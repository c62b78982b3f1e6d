/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * DOC: the emulated GPU
 *
 * Two engines, as a GPU has one for graphics and compute and one for asynchronous copies. Each has
 * a runlist of TSGs, each with channels that hold work in order. A TSG is on one runlist: that of
 * the first channel bound to it. An engine runs one TSG at a time for its time slice, then the next
 * runnable one in the runlist; in it, a TSG of a higher interleave level stands before every one of
 * a lower level. Changing the TSG costs saving the old context and restoring the new one.
 *
 *	IDLE --work--> RESTORE --> RUN --slice over and others wait, preempted, no work left--> SAVE
 *	SAVE --another has work--> RESTORE of that one; --nobody has--> IDLE
 *
 * What is enabled is a channel, as in nvgpu: a TSG's DISABLE and ENABLE are those of its channels.
 * A TSG without an enabled channel is not picked again; the one that is on the engine stays until
 * others wait for it or it is preempted. nvgpu enables channels behind everybody's back, and so
 * does this: when a channel of the TSG is closed, unbound, bound or given a preemption mode, and
 * when power comes back (gpu_power_on()).
 *
 * A context that is to leave leaves when its running work ends, or after gpu_yield_us. If that
 * takes long, hardware reports it every 100 ms; the reports of a TSG's whole life add up, and above
 * 3 s nvgpu kills it.
 *
 * Time is real (ktime); an hrtimer fires at the next change, so the CPU has little to do however
 * long the work is.
 */
#ifndef XAUTO_EMU_GPU_ENGINE_H
#define XAUTO_EMU_GPU_ENGINE_H

#include <linux/bitmap.h>
#include <linux/hrtimer.h>
#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/spinlock.h>
#include <linux/types.h>
#include <linux/wait.h>

struct device;
struct seq_file;

#define GPU_MAX_TSGS 256
#define GPU_MAX_WORK 4096 /* waiting on one channel */
#define GPU_ENGINES 2
#define GPU_POLL_MS 100 /* nvgpu's ctxsw_timeout_period_ms */
#define GPU_STUCK_MAX_MS 3000 /* nvgpu's ctxsw_timeout_max_ms */

/**
 * struct gpu_tsg - a time slice group
 * @gpu: it belongs to
 * @engine: whose runlist it is on, NULL before the first channel is bound
 * @node: in the GPU's list
 * @id: its bit in what the sched node tells
 * @tgid: the process that opened it, as the initial PID namespace knows it
 * @refs: files that share it, and channels bound to it: it outlives its files, as in nvgpu
 * @token: other files can be opened with, 0: none was asked for
 * @channels: bound ones
 * @preempt: asked to leave the engine
 * @killed: it was stuck for too long, its channels take no work any more
 * @stuck_ms: of all its switches that took long
 * @level: interleave level, 0..2
 * @timeslice_us: how long it may run while others wait
 * @ran_ns: on the engine, switching not counted
 */
struct gpu_tsg {
	struct gpu *gpu;
	struct gpu_engine *engine;
	struct list_head node;
	u32 id;
	pid_t tgid;
	u32 refs;
	u64 token;
	struct list_head channels;
	bool preempt;
	bool killed;
	u32 stuck_ms;
	u32 level;
	u32 timeslice_us;
	u64 ran_ns;
};

/**
 * struct gpu_channel - a queue of work
 * @gpu: it belongs to
 * @engine: that it was opened for
 * @tsg: bound to, or NULL
 * @node: in the TSG's list
 * @enabled: the engine may take work from it
 * @work: waiting and running, in order; each holds a power reference
 * @waiting: length of @work
 * @submitted: number of the last
 * @finished: how many are done
 * @done: woken when one is
 */
struct gpu_channel {
	struct gpu *gpu;
	struct gpu_engine *engine;
	struct gpu_tsg *tsg;
	struct list_head node;
	bool enabled;
	struct list_head work;
	u32 waiting;
	u64 submitted;
	u64 finished;
	wait_queue_head_t done;
};

enum gpu_phase { GPU_IDLE, GPU_RESTORE, GPU_RUN, GPU_SAVE };

/**
 * struct gpu_engine - what runs TSGs; the GPU's lock covers all but @busy
 * @gpu: it belongs to
 * @busy: nvgpu's runlist mutex: a PREEMPT holds it while it polls
 * @runlist: the round, rebuilt when a TSG comes, goes or changes level
 * @runlist_length: of @runlist
 * @at: position of the one picked last
 * @phase: what the engine does
 * @current_tsg: whose context is loaded, being saved or restored
 * @phase_end: of SAVE and RESTORE
 * @since: of RUN: up to where work has been accounted for
 * @slice_end: of RUN
 * @leaving: of RUN: since when the context is to leave, 0: it is not
 * @reports: of RUN: how often the hardware has reported that it does not
 * @timer: the next change
 * @switches: contexts restored
 */
struct gpu_engine {
	struct gpu *gpu;
	struct mutex busy; /* the runlist, against those who would change it meanwhile */
	struct gpu_tsg *runlist[2048];
	u32 runlist_length;
	u32 at;
	enum gpu_phase phase;
	struct gpu_tsg *current_tsg;
	u64 phase_end;
	u64 since;
	u64 slice_end;
	u64 leaving;
	u32 reports;
	struct hrtimer timer;
	u64 switches;
};

/**
 * struct gpu - all of it
 * @lock: covers the GPU, its engines, TSGs and channels
 * @dev: powered while there is work
 * @powered: the engines may run
 * @tsgs: all
 * @ids: of @tsgs
 * @tokens: given out so far
 * @engines: graphics and compute, then copies
 */
struct gpu {
	spinlock_t lock; /* the GPU, its engines, TSGs and channels */
	struct device *dev;
	bool powered;
	struct list_head tsgs;
	DECLARE_BITMAP(ids, GPU_MAX_TSGS);
	u64 tokens;
	struct gpu_engine engines[GPU_ENGINES];
};

void gpu_init(struct gpu *gpu, struct device *dev);
void gpu_stop(struct gpu *gpu);

struct gpu_tsg *gpu_tsg_new(struct gpu *gpu);
/* One more file of the TSG with this token; NULL: there is none. */
struct gpu_tsg *gpu_tsg_share(struct gpu *gpu, u64 token);
u64 gpu_tsg_token(struct gpu_tsg *tsg);
/* A file of it is closed, or a channel unbound; with the last of them the TSG goes. */
void gpu_tsg_put(struct gpu_tsg *tsg);
/* Those that @tgid has opened; 0: all. */
void gpu_tsgs_of(struct gpu *gpu, pid_t tgid, unsigned long *ids);
/* The caller holds a power reference, as for the next two. */
void gpu_tsg_enable(struct gpu_tsg *tsg);
void gpu_tsg_disable(struct gpu_tsg *tsg);
/* Polls until it is off the engine; @stuck: it never is. -EBUSY: it is still there. */
int gpu_tsg_preempt(struct gpu_tsg *tsg, bool stuck);
int gpu_tsg_set_level(struct gpu_tsg *tsg, u32 level);
int gpu_tsg_set_timeslice(struct gpu_tsg *tsg, u32 us);

struct gpu_channel *gpu_channel_new(struct gpu *gpu, u32 engine);
/* Its file is closed: what waits is dropped. */
void gpu_channel_close(struct gpu_channel *channel);
/* @enable_all: every channel of the TSG (r36), not the new one alone (r35). */
int gpu_channel_bind(struct gpu_tsg *tsg, struct gpu_channel *channel, bool enable_all);
/* @tsg: the one that it must be bound to, or NULL for whichever. */
int gpu_channel_unbind(struct gpu_tsg *tsg, struct gpu_channel *channel);
/* Another preemption mode ends with the channel's TSG enabled. */
int gpu_channel_touch(struct gpu_channel *channel);
int gpu_channel_submit(struct gpu_channel *channel, u64 duration_ns, u64 *sequence);
bool gpu_channel_idle(struct gpu_channel *channel, u64 *finished);

/* Power is about to go: contexts are taken off the engines. */
void gpu_power_off(struct gpu *gpu);
/* Power is back: nvgpu binds every channel again, and that enables it. */
void gpu_power_on(struct gpu *gpu);
void gpu_show(struct gpu *gpu, struct seq_file *out);

#endif /* XAUTO_EMU_GPU_ENGINE_H */
