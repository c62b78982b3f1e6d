// SPDX-License-Identifier: GPL-2.0-only
/*
 * The emulated GPU's engine; gpu_engine.h tells the model.
 */
#include <linux/device.h>
#include <linux/moduleparam.h>
#include <linux/pm_runtime.h>
#include <linux/seq_file.h>
#include <linux/slab.h>

#include <uapi/xauto/nvgpu.h>

#include "compat.h"
#include "gpu_engine.h"

static unsigned int gpu_save_us = 100;
module_param_named(save_us, gpu_save_us, uint, 0644);
MODULE_PARM_DESC(save_us, "taking a context off the engine (default: 100)");
static unsigned int gpu_restore_us = 175;
module_param_named(restore_us, gpu_restore_us, uint, 0644);
MODULE_PARM_DESC(restore_us, "putting a context on the engine (default: 175)");

struct gpu_work {
	struct list_head node;
	u64 left_ns;
};

static u64 gpu_us_to_ns(u32 us)
{
	return (u64)us * NSEC_PER_USEC;
}

/*
 * The channel whose work is next; round robin is left out, channels of a TSG run one after the
 * other.
 */
static struct gpu_channel *gpu_tsg_busy_channel(struct gpu_tsg *tsg)
{
	struct gpu_channel *channel;

	list_for_each_entry(channel, &tsg->channels, node)
		if (!list_empty(&channel->work))
			return channel;
	return NULL;
}

static bool gpu_tsg_runnable(struct gpu_tsg *tsg)
{
	return tsg->enabled && !tsg->lost && gpu_tsg_busy_channel(tsg);
}

static bool gpu_level_is_used(struct gpu *gpu, u32 level)
{
	struct gpu_tsg *tsg;

	list_for_each_entry(tsg, &gpu->tsgs, node)
		if (tsg->level == level)
			return true;
	return false;
}

/* All of this level, each after a round of the level above. */
static void gpu_append_level(struct gpu *gpu, u32 level)
{
	struct gpu_tsg *tsg;

	if (level >= NVGPU_RUNLIST_INTERLEAVE_NUM_LEVELS)
		return;
	if (!gpu_level_is_used(gpu, level))
		return gpu_append_level(gpu, level + 1);
	list_for_each_entry(tsg, &gpu->tsgs, node) {
		if (tsg->level != level)
			continue;
		gpu_append_level(gpu, level + 1);
		if (gpu->runlist_length < ARRAY_SIZE(gpu->runlist))
			gpu->runlist[gpu->runlist_length++] = tsg;
	}
}

static void gpu_build_runlist(struct gpu *gpu)
{
	gpu->runlist_length = 0;
	gpu_append_level(gpu, 0);
	if (gpu->at >= gpu->runlist_length)
		gpu->at = 0;
}

static struct gpu_tsg *gpu_pick(struct gpu *gpu)
{
	u32 i, at;

	for (i = 1; i <= gpu->runlist_length; i++) {
		at = (gpu->at + i) % gpu->runlist_length;
		if (gpu_tsg_runnable(gpu->runlist[at])) {
			gpu->at = at;
			return gpu->runlist[at];
		}
	}
	return NULL;
}

static bool gpu_others_wait(struct gpu *gpu)
{
	struct gpu_tsg *tsg;

	list_for_each_entry(tsg, &gpu->tsgs, node)
		if (tsg != gpu->current_tsg && gpu_tsg_runnable(tsg))
			return true;
	return false;
}

/*
 * The engine has power while it is not idle. Whoever ends the idleness holds a reference as well.
 */
static void gpu_set_phase(struct gpu *gpu, enum gpu_phase phase)
{
	if (gpu->phase == GPU_IDLE && phase != GPU_IDLE)
		pm_runtime_get_noresume(gpu->dev);
	if (gpu->phase != GPU_IDLE && phase == GPU_IDLE) {
		pm_runtime_mark_last_busy(gpu->dev);
		pm_runtime_put_autosuspend(gpu->dev);
	}
	gpu->phase = phase;
}

static void gpu_left_engine(struct gpu *gpu)
{
	if (gpu->current_tsg)
		gpu->current_tsg->preempt = false;
	gpu->current_tsg = NULL;
	wake_up_all(&gpu->off);
}

static void gpu_run(struct gpu *gpu, u64 now)
{
	gpu_set_phase(gpu, GPU_RUN);
	gpu->since = now;
	gpu->slice_end = now + gpu_us_to_ns(gpu->current_tsg->timeslice_us);
}

/* The engine is free for anybody. */
static void gpu_choose(struct gpu *gpu, u64 now)
{
	struct gpu_tsg *next;

	if (gpu->current_tsg && gpu->current_tsg->preempt) {
		gpu_set_phase(gpu, GPU_SAVE);
		gpu->phase_end = now + gpu_us_to_ns(gpu_save_us);
		return;
	}
	next = gpu_pick(gpu);
	if (!next) {
		gpu_set_phase(gpu, GPU_IDLE);
	} else if (next == gpu->current_tsg) {
		gpu_run(gpu, now);
	} else if (gpu->current_tsg) {
		gpu_set_phase(gpu, GPU_SAVE);
		gpu->phase_end = now + gpu_us_to_ns(gpu_save_us);
	} else {
		gpu->current_tsg = next;
		gpu->switches++;
		gpu_set_phase(gpu, GPU_RESTORE);
		gpu->phase_end = now + gpu_us_to_ns(gpu_restore_us);
	}
}

static void gpu_account(struct gpu *gpu, u64 now)
{
	struct gpu_channel *channel = gpu_tsg_busy_channel(gpu->current_tsg);
	struct gpu_work *work;
	u64 ran = now - gpu->since;

	gpu->since = now;
	if (!channel)
		return;
	work = list_first_entry(&channel->work, struct gpu_work, node);
	work->left_ns -= min(work->left_ns, ran);
	gpu->current_tsg->ran_ns += ran;
	if (work->left_ns)
		return;
	list_del(&work->node);
	kfree(work);
	channel->waiting--;
	channel->finished++;
	wake_up_all(&channel->done);
}

static u64 gpu_next_change(struct gpu *gpu, u64 now)
{
	struct gpu_channel *channel;
	u64 end;

	switch (gpu->phase) {
	case GPU_IDLE:
		return U64_MAX;
	case GPU_SAVE:
	case GPU_RESTORE:
		return gpu->phase_end;
	case GPU_RUN:
		break;
	}
	channel = gpu_tsg_busy_channel(gpu->current_tsg);
	if (!channel || gpu->current_tsg->preempt)
		return now;
	end = gpu->since + list_first_entry(&channel->work, struct gpu_work, node)->left_ns;
	if (!gpu->current_tsg->enabled || gpu_others_wait(gpu))
		end = min(end, max(gpu->slice_end, gpu->since));
	return end;
}

static void gpu_change(struct gpu *gpu, u64 now)
{
	struct gpu_tsg *tsg = gpu->current_tsg;

	switch (gpu->phase) {
	case GPU_IDLE:
		break;
	case GPU_SAVE:
		gpu_left_engine(gpu);
		gpu_choose(gpu, now);
		break;
	case GPU_RESTORE:
		gpu_run(gpu, now);
		break;
	case GPU_RUN:
		gpu_account(gpu, now);
		if (tsg->preempt || !gpu_tsg_busy_channel(tsg) ||
		    (now >= gpu->slice_end && (!tsg->enabled || gpu_others_wait(gpu))))
			gpu_choose(gpu, now);
		break;
	}
}

/*
 * Everything that has happened up to now; with the lock held before whatever is changed, and again
 * after.
 */
static void gpu_catch_up(struct gpu *gpu)
{
	u64 now = ktime_get_ns(), at;

	lockdep_assert_held(&gpu->lock);
	while ((at = gpu_next_change(gpu, now)) <= now)
		gpu_change(gpu, at);
	if (gpu->phase == GPU_RUN)
		gpu_account(gpu, now);
}

static void gpu_settle(struct gpu *gpu)
{
	u64 now = ktime_get_ns(), at;

	if (gpu->phase == GPU_IDLE) {
		if (gpu->current_tsg && gpu->current_tsg->preempt)
			gpu_left_engine(gpu); /* nothing of it was running */
		gpu_choose(gpu, now);
	}
	gpu_catch_up(gpu);
	at = gpu_next_change(gpu, now);
	if (at == U64_MAX)
		hrtimer_try_to_cancel(&gpu->timer);
	else
		hrtimer_start(&gpu->timer, ns_to_ktime(at), HRTIMER_MODE_ABS_SOFT);
}

static enum hrtimer_restart gpu_on_timer(struct hrtimer *timer)
{
	struct gpu *gpu = container_of(timer, struct gpu, timer);

	spin_lock_bh(&gpu->lock);
	gpu_catch_up(gpu);
	gpu_settle(gpu);
	spin_unlock_bh(&gpu->lock);
	return HRTIMER_NORESTART; /* gpu_settle() has set the next */
}

static void gpu_enter(struct gpu *gpu) __acquires(&gpu->lock)
{
	spin_lock_bh(&gpu->lock);
	gpu_catch_up(gpu);
}

static void gpu_leave(struct gpu *gpu) __releases(&gpu->lock)
{
	gpu_settle(gpu);
	spin_unlock_bh(&gpu->lock);
}

void gpu_init(struct gpu *gpu, struct device *dev)
{
	spin_lock_init(&gpu->lock);
	INIT_LIST_HEAD(&gpu->tsgs);
	init_waitqueue_head(&gpu->off);
	gpu->dev = dev;
	xauto_hrtimer_setup(&gpu->timer, gpu_on_timer, HRTIMER_MODE_ABS_SOFT);
}

void gpu_stop(struct gpu *gpu)
{
	hrtimer_cancel(&gpu->timer);
}

struct gpu_tsg *gpu_tsg_new(struct gpu *gpu)
{
	struct gpu_tsg *tsg = kzalloc(sizeof(*tsg), GFP_KERNEL);

	if (!tsg)
		return ERR_PTR(-ENOMEM);
	tsg->gpu = gpu;
	INIT_LIST_HEAD(&tsg->channels);
	tsg->enabled = true;
	tsg->timeslice_us = NVGPU_TSG_TIMESLICE_DEFAULT_US;
	gpu_enter(gpu);
	if (gpu->n_tsgs >= GPU_MAX_TSGS) {
		gpu_leave(gpu);
		kfree(tsg);
		return ERR_PTR(-ENOSPC);
	}
	gpu->n_tsgs++;
	list_add_tail(&tsg->node, &gpu->tsgs);
	gpu_build_runlist(gpu);
	gpu_leave(gpu);
	return tsg;
}

static void gpu_channel_drop_work(struct gpu_channel *channel)
{
	struct gpu_work *work, *next;

	list_for_each_entry_safe(work, next, &channel->work, node) {
		list_del(&work->node);
		kfree(work);
	}
	channel->waiting = 0;
	channel->submitted = channel->finished;
	wake_up_all(&channel->done);
}

static void gpu_channel_unbind(struct gpu_channel *channel)
{
	list_del(&channel->node);
	channel->tsg = NULL;
}

void gpu_tsg_free(struct gpu_tsg *tsg)
{
	struct gpu *gpu = tsg->gpu;
	struct gpu_channel *channel, *next;
	LIST_HEAD(unbound);

	gpu_enter(gpu);
	list_for_each_entry_safe(channel, next, &tsg->channels, node) {
		gpu_channel_drop_work(channel);
		gpu_channel_unbind(channel);
		list_add(&channel->node, &unbound);
	}
	list_del(&tsg->node);
	gpu->n_tsgs--;
	gpu_build_runlist(gpu);
	if (gpu->current_tsg == tsg) {
		gpu_left_engine(gpu);
		gpu_choose(gpu, ktime_get_ns());
	}
	gpu_leave(gpu);
	list_for_each_entry_safe(channel, next, &unbound, node)
		gpu_channel_put(channel);
	kfree(tsg);
}

int gpu_tsg_enable(struct gpu_tsg *tsg)
{
	int err = 0;

	pm_runtime_get_sync(tsg->gpu->dev);
	gpu_enter(tsg->gpu);
	if (tsg->lost)
		err = -EIO;
	else
		tsg->enabled = true;
	gpu_leave(tsg->gpu);
	pm_runtime_mark_last_busy(tsg->gpu->dev);
	pm_runtime_put_autosuspend(tsg->gpu->dev);
	return err;
}

void gpu_tsg_disable(struct gpu_tsg *tsg)
{
	gpu_enter(tsg->gpu);
	tsg->enabled = false;
	gpu_leave(tsg->gpu);
}

static bool gpu_tsg_off_engine(struct gpu_tsg *tsg)
{
	bool off;

	spin_lock_bh(&tsg->gpu->lock);
	off = tsg->gpu->current_tsg != tsg || !tsg->preempt;
	spin_unlock_bh(&tsg->gpu->lock);
	return off;
}

int gpu_tsg_preempt(struct gpu_tsg *tsg)
{
	gpu_enter(tsg->gpu);
	if (tsg->gpu->current_tsg == tsg)
		tsg->preempt = true;
	gpu_leave(tsg->gpu);
	return wait_event_timeout(tsg->gpu->off, gpu_tsg_off_engine(tsg), 3 * HZ) ? 0 : -ETIMEDOUT;
}

int gpu_tsg_set_level(struct gpu_tsg *tsg, u32 level)
{
	if (level >= NVGPU_RUNLIST_INTERLEAVE_NUM_LEVELS)
		return -EINVAL;
	gpu_enter(tsg->gpu);
	tsg->level = level;
	gpu_build_runlist(tsg->gpu);
	gpu_leave(tsg->gpu);
	return 0;
}

int gpu_tsg_set_timeslice(struct gpu_tsg *tsg, u32 us)
{
	if (us < NVGPU_TSG_TIMESLICE_MIN_US || us > NVGPU_TSG_TIMESLICE_MAX_US)
		return -EINVAL;
	gpu_enter(tsg->gpu);
	tsg->timeslice_us = us;
	gpu_leave(tsg->gpu);
	return 0;
}

struct gpu_channel *gpu_channel_new(struct gpu *gpu)
{
	struct gpu_channel *channel = kzalloc(sizeof(*channel), GFP_KERNEL);

	if (!channel)
		return NULL;
	kref_init(&channel->ref);
	channel->gpu = gpu;
	INIT_LIST_HEAD(&channel->node);
	INIT_LIST_HEAD(&channel->work);
	init_waitqueue_head(&channel->done);
	return channel;
}

static void gpu_channel_free(struct kref *ref)
{
	kfree(container_of(ref, struct gpu_channel, ref));
}

void gpu_channel_put(struct gpu_channel *channel)
{
	kref_put(&channel->ref, gpu_channel_free);
}

void gpu_channel_close(struct gpu_channel *channel)
{
	bool bound;

	gpu_enter(channel->gpu);
	gpu_channel_drop_work(channel);
	bound = channel->tsg;
	if (bound)
		gpu_channel_unbind(channel);
	gpu_leave(channel->gpu);
	if (bound)
		gpu_channel_put(channel);
	gpu_channel_put(channel);
}

int gpu_channel_bind(struct gpu_tsg *tsg, struct gpu_channel *channel)
{
	int err = 0;

	if (channel->gpu != tsg->gpu)
		return -EINVAL;
	gpu_enter(tsg->gpu);
	if (channel->tsg) {
		err = -EINVAL;
	} else {
		kref_get(&channel->ref);
		channel->tsg = tsg;
		list_add_tail(&channel->node, &tsg->channels);
	}
	gpu_leave(tsg->gpu);
	return err;
}

int gpu_channel_submit(struct gpu_channel *channel, u64 duration_ns, u64 *sequence)
{
	struct gpu *gpu = channel->gpu;
	struct gpu_work *work = kmalloc(sizeof(*work), GFP_KERNEL);
	int err = 0;

	if (!work)
		return -ENOMEM;
	work->left_ns = duration_ns;
	pm_runtime_get_sync(gpu->dev);
	gpu_enter(gpu);
	if (!channel->tsg) {
		err = -EINVAL;
	} else if (channel->tsg->lost) {
		err = -EIO;
	} else if (channel->waiting >= GPU_MAX_WORK) {
		err = -EAGAIN;
	} else {
		list_add_tail(&work->node, &channel->work);
		channel->waiting++;
		*sequence = ++channel->submitted;
	}
	gpu_leave(gpu);
	pm_runtime_mark_last_busy(gpu->dev);
	pm_runtime_put_autosuspend(gpu->dev);
	if (err)
		kfree(work);
	return err;
}

bool gpu_channel_idle(struct gpu_channel *channel, u64 *finished)
{
	bool idle;

	spin_lock_bh(&channel->gpu->lock);
	*finished = channel->finished;
	idle = list_empty(&channel->work);
	spin_unlock_bh(&channel->gpu->lock);
	return idle;
}

void gpu_power_off(struct gpu *gpu)
{
	struct gpu_tsg *tsg;

	spin_lock_bh(&gpu->lock);
	list_for_each_entry(tsg, &gpu->tsgs, node) {
		if (!tsg->enabled && gpu_tsg_busy_channel(tsg)) {
			tsg->lost = true;
			dev_err(gpu->dev,
				"power went while a disabled TSG had work: its context is lost\n");
		}
	}
	spin_unlock_bh(&gpu->lock);
}

void gpu_show(struct gpu *gpu, struct seq_file *out)
{
	static const char * const phases[] = { "idle", "restore", "run", "save" };
	struct gpu_tsg *tsg;
	u32 i = 0;

	gpu_enter(gpu);
	seq_printf(out, "phase=%s switches=%llu runlist=%u\n", phases[gpu->phase], gpu->switches,
		   gpu->runlist_length);
	list_for_each_entry(tsg, &gpu->tsgs, node)
		seq_printf(
			out,
			"tsg=%u enabled=%d current=%d lost=%d level=%u timeslice_us=%u busy=%d ran_us=%llu\n",
			i++, tsg->enabled, tsg == gpu->current_tsg, tsg->lost, tsg->level,
			tsg->timeslice_us, !!gpu_tsg_busy_channel(tsg),
			div_u64(tsg->ran_ns, NSEC_PER_USEC));
	gpu_leave(gpu);
}
