// SPDX-License-Identifier: GPL-2.0-only
/*
 * The emulated GPU's engine; gpu_engine.h tells the model.
 */
#include <linux/delay.h>
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
static unsigned int gpu_yield_us;
module_param_named(yield_us, gpu_yield_us, uint, 0644);
MODULE_PARM_DESC(yield_us,
		 "how long running work keeps its context on the engine (default: 0, as under CILP)");

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
 * other. @loaded: the context is on the engine, which then asks nobody who is enabled.
 */
static struct gpu_channel *gpu_tsg_busy_channel(struct gpu_tsg *tsg, bool loaded)
{
	struct gpu_channel *channel;

	list_for_each_entry(channel, &tsg->channels, node)
		if ((loaded || channel->enabled) && !list_empty(&channel->work))
			return channel;
	return NULL;
}

static bool gpu_tsg_runnable(struct gpu_tsg *tsg)
{
	return gpu_tsg_busy_channel(tsg, false);
}

static bool gpu_level_is_used(struct gpu_engine *engine, u32 level)
{
	struct gpu_tsg *tsg;

	list_for_each_entry(tsg, &engine->gpu->tsgs, node)
		if (tsg->engine == engine && tsg->level == level)
			return true;
	return false;
}

/* All of this level, each after a round of the level above. */
static void gpu_append_level(struct gpu_engine *engine, u32 level)
{
	struct gpu_tsg *tsg;

	if (level >= NVGPU_RUNLIST_INTERLEAVE_NUM_LEVELS)
		return;
	if (!gpu_level_is_used(engine, level))
		return gpu_append_level(engine, level + 1);
	list_for_each_entry(tsg, &engine->gpu->tsgs, node) {
		if (tsg->engine != engine || tsg->level != level)
			continue;
		gpu_append_level(engine, level + 1);
		if (engine->runlist_length < ARRAY_SIZE(engine->runlist))
			engine->runlist[engine->runlist_length++] = tsg;
	}
}

static void gpu_build_runlist(struct gpu_engine *engine)
{
	engine->runlist_length = 0;
	gpu_append_level(engine, 0);
	if (engine->at >= engine->runlist_length)
		engine->at = 0;
}

static struct gpu_tsg *gpu_pick(struct gpu_engine *engine)
{
	u32 i, at;

	if (!engine->gpu->powered)
		return NULL;
	for (i = 1; i <= engine->runlist_length; i++) {
		at = (engine->at + i) % engine->runlist_length;
		if (gpu_tsg_runnable(engine->runlist[at])) {
			engine->at = at;
			return engine->runlist[at];
		}
	}
	return NULL;
}

static bool gpu_others_wait(struct gpu_engine *engine)
{
	u32 i;

	for (i = 0; i < engine->runlist_length; i++)
		if (engine->runlist[i] != engine->current_tsg &&
		    gpu_tsg_runnable(engine->runlist[i]))
			return true;
	return false;
}

/* Of RUN: shall the context leave? */
static bool gpu_wanted_off(struct gpu_engine *engine, u64 now)
{
	return engine->current_tsg->preempt ||
	       (now >= engine->slice_end && gpu_others_wait(engine));
}

static void gpu_left_engine(struct gpu_engine *engine)
{
	if (engine->current_tsg)
		engine->current_tsg->preempt = false;
	engine->current_tsg = NULL;
}

static void gpu_run(struct gpu_engine *engine, u64 now)
{
	engine->phase = GPU_RUN;
	engine->since = now;
	engine->leaving = 0;
	engine->slice_end = now + gpu_us_to_ns(engine->current_tsg->timeslice_us);
}

static void gpu_save(struct gpu_engine *engine, u64 now)
{
	engine->phase = GPU_SAVE;
	engine->phase_end = now + gpu_us_to_ns(gpu_save_us);
}

/* The engine is free for anybody. */
static void gpu_choose(struct gpu_engine *engine, u64 now)
{
	struct gpu_tsg *next;

	if (engine->current_tsg && engine->current_tsg->preempt)
		return gpu_save(engine, now);
	next = gpu_pick(engine);
	if (!next) {
		engine->phase = GPU_IDLE;
	} else if (next == engine->current_tsg) {
		gpu_run(engine, now);
	} else if (engine->current_tsg) {
		gpu_save(engine, now);
	} else {
		engine->current_tsg = next;
		engine->switches++;
		engine->phase = GPU_RESTORE;
		engine->phase_end = now + gpu_us_to_ns(gpu_restore_us);
	}
}

static void gpu_work_free(struct gpu_channel *channel, struct gpu_work *work)
{
	list_del(&work->node);
	kfree(work);
	channel->waiting--;
	pm_runtime_mark_last_busy(channel->gpu->dev);
	pm_runtime_put_autosuspend(channel->gpu->dev);
}

static void gpu_channel_drop_work(struct gpu_channel *channel)
{
	struct gpu_work *work, *next;

	list_for_each_entry_safe(work, next, &channel->work, node)
		gpu_work_free(channel, work);
	channel->submitted = channel->finished;
	wake_up_all(&channel->done);
}

/* nvgpu's recovery: the TSG is torn down, and its process's work with it. */
static void gpu_tsg_kill(struct gpu_tsg *tsg)
{
	struct gpu_channel *channel;

	tsg->killed = true;
	list_for_each_entry(channel, &tsg->channels, node)
		gpu_channel_drop_work(channel);
}

/* Of RUN. Has a piece of work ended? */
static bool gpu_account(struct gpu_engine *engine, u64 now)
{
	struct gpu_channel *channel = gpu_tsg_busy_channel(engine->current_tsg, true);
	struct gpu_work *work;
	u64 ran = now - engine->since;

	engine->since = now;
	if (!channel)
		return false;
	work = list_first_entry(&channel->work, struct gpu_work, node);
	work->left_ns -= min(work->left_ns, ran);
	engine->current_tsg->ran_ns += ran;
	if (work->left_ns)
		return false;
	gpu_work_free(channel, work);
	channel->finished++;
	wake_up_all(&channel->done);
	return true;
}

static u64 gpu_next_report(struct gpu_engine *engine)
{
	return engine->leaving + (engine->reports + 1) * (u64)GPU_POLL_MS * NSEC_PER_MSEC;
}

static u64 gpu_next_change(struct gpu_engine *engine, u64 now)
{
	struct gpu_channel *channel;
	u64 end;

	switch (engine->phase) {
	case GPU_IDLE:
		return U64_MAX;
	case GPU_SAVE:
	case GPU_RESTORE:
		return engine->phase_end;
	case GPU_RUN:
		break;
	}
	channel = gpu_tsg_busy_channel(engine->current_tsg, true);
	if (!channel)
		return now;
	end = engine->since + list_first_entry(&channel->work, struct gpu_work, node)->left_ns;
	if (engine->leaving)
		return min3(end, engine->leaving + gpu_us_to_ns(gpu_yield_us),
			    gpu_next_report(engine));
	if (engine->current_tsg->preempt)
		return engine->since;
	if (gpu_others_wait(engine))
		end = min(end, max(engine->slice_end, engine->since));
	return end;
}

static void gpu_change_run(struct gpu_engine *engine, u64 now)
{
	struct gpu_tsg *tsg = engine->current_tsg;
	bool ended = gpu_account(engine, now);

	if (!gpu_wanted_off(engine, now)) {
		engine->leaving = 0;
	} else if (!engine->leaving) {
		engine->leaving = now;
		engine->reports = 0;
	} else if (now >= gpu_next_report(engine)) {
		engine->reports++;
		tsg->stuck_ms += GPU_POLL_MS;
		if (tsg->stuck_ms > GPU_STUCK_MAX_MS)
			gpu_tsg_kill(tsg);
	}
	if (!gpu_tsg_busy_channel(tsg, true) ||
	    (engine->leaving &&
	     (ended || now >= engine->leaving + gpu_us_to_ns(gpu_yield_us))))
		gpu_choose(engine, now);
}

static void gpu_change(struct gpu_engine *engine, u64 now)
{
	switch (engine->phase) {
	case GPU_IDLE:
		break;
	case GPU_SAVE:
		gpu_left_engine(engine);
		gpu_choose(engine, now);
		break;
	case GPU_RESTORE:
		gpu_run(engine, now);
		break;
	case GPU_RUN:
		gpu_change_run(engine, now);
		break;
	}
}

/*
 * Everything that has happened up to now; with the lock held before whatever is changed, and again
 * after.
 */
static void gpu_catch_up(struct gpu_engine *engine)
{
	u64 now = ktime_get_ns(), at;

	lockdep_assert_held(&engine->gpu->lock);
	while ((at = gpu_next_change(engine, now)) <= now)
		gpu_change(engine, at);
	if (engine->phase == GPU_RUN)
		gpu_account(engine, now);
}

static void gpu_settle(struct gpu_engine *engine)
{
	u64 now = ktime_get_ns(), at;

	if (engine->phase == GPU_IDLE) {
		if (engine->current_tsg && engine->current_tsg->preempt)
			gpu_left_engine(engine); /* nothing of it was running */
		gpu_choose(engine, now);
	}
	gpu_catch_up(engine);
	at = gpu_next_change(engine, now);
	if (at == U64_MAX)
		hrtimer_try_to_cancel(&engine->timer);
	else
		hrtimer_start(&engine->timer, ns_to_ktime(at), HRTIMER_MODE_ABS_SOFT);
}

static enum hrtimer_restart gpu_on_timer(struct hrtimer *timer)
{
	struct gpu_engine *engine = container_of(timer, struct gpu_engine, timer);

	spin_lock_bh(&engine->gpu->lock);
	gpu_catch_up(engine);
	gpu_settle(engine);
	spin_unlock_bh(&engine->gpu->lock);
	return HRTIMER_NORESTART; /* gpu_settle() has set the next */
}

static void gpu_enter(struct gpu *gpu) __acquires(&gpu->lock)
{
	int i;

	spin_lock_bh(&gpu->lock);
	for (i = 0; i < GPU_ENGINES; i++)
		gpu_catch_up(&gpu->engines[i]);
}

static void gpu_leave(struct gpu *gpu) __releases(&gpu->lock)
{
	int i;

	for (i = 0; i < GPU_ENGINES; i++)
		gpu_settle(&gpu->engines[i]);
	spin_unlock_bh(&gpu->lock);
}

void gpu_init(struct gpu *gpu, struct device *dev)
{
	int i;

	spin_lock_init(&gpu->lock);
	INIT_LIST_HEAD(&gpu->tsgs);
	gpu->dev = dev;
	for (i = 0; i < GPU_ENGINES; i++) {
		gpu->engines[i].gpu = gpu;
		mutex_init(&gpu->engines[i].busy);
		xauto_hrtimer_setup(&gpu->engines[i].timer, gpu_on_timer, HRTIMER_MODE_ABS_SOFT);
	}
}

void gpu_stop(struct gpu *gpu)
{
	int i;

	for (i = 0; i < GPU_ENGINES; i++)
		hrtimer_cancel(&gpu->engines[i].timer);
}

struct gpu_tsg *gpu_tsg_new(struct gpu *gpu)
{
	struct gpu_tsg *tsg = kzalloc(sizeof(*tsg), GFP_KERNEL);

	if (!tsg)
		return ERR_PTR(-ENOMEM);
	tsg->gpu = gpu;
	tsg->tgid = current->tgid;
	tsg->refs = 1;
	INIT_LIST_HEAD(&tsg->channels);
	tsg->timeslice_us = NVGPU_TSG_TIMESLICE_DEFAULT_US;
	gpu_enter(gpu);
	tsg->id = find_first_zero_bit(gpu->ids, GPU_MAX_TSGS);
	if (tsg->id == GPU_MAX_TSGS) {
		gpu_leave(gpu);
		kfree(tsg);
		return ERR_PTR(-ENOSPC);
	}
	__set_bit(tsg->id, gpu->ids);
	list_add_tail(&tsg->node, &gpu->tsgs);
	gpu_leave(gpu);
	return tsg;
}

void gpu_tsgs_of(struct gpu *gpu, pid_t tgid, unsigned long *ids)
{
	struct gpu_tsg *tsg;

	bitmap_zero(ids, GPU_MAX_TSGS);
	spin_lock_bh(&gpu->lock);
	list_for_each_entry(tsg, &gpu->tsgs, node)
		if (!tgid || tsg->tgid == tgid)
			__set_bit(tsg->id, ids);
	spin_unlock_bh(&gpu->lock);
}

u64 gpu_tsg_token(struct gpu_tsg *tsg)
{
	u64 token;

	spin_lock_bh(&tsg->gpu->lock);
	if (!tsg->token)
		tsg->token = ++tsg->gpu->tokens;
	token = tsg->token;
	spin_unlock_bh(&tsg->gpu->lock);
	return token;
}

struct gpu_tsg *gpu_tsg_share(struct gpu *gpu, u64 token)
{
	struct gpu_tsg *tsg, *found = NULL;

	spin_lock_bh(&gpu->lock);
	list_for_each_entry(tsg, &gpu->tsgs, node) {
		if (tsg->token == token) {
			tsg->refs++;
			found = tsg;
			break;
		}
	}
	spin_unlock_bh(&gpu->lock);
	return found;
}

/* What nvgpu does at the end of whatever needed the TSG off, however it was before. */
static void gpu_tsg_enable_all(struct gpu_tsg *tsg)
{
	struct gpu_channel *channel;

	list_for_each_entry(channel, &tsg->channels, node)
		channel->enabled = true;
}

static void gpu_tsg_lose(struct gpu_tsg *tsg, struct gpu_channel *channel)
{
	list_del(&channel->node);
	channel->tsg = NULL;
	if (tsg->engine->current_tsg == tsg)
		tsg->preempt = true;
	gpu_tsg_enable_all(tsg);
}

void gpu_tsg_put(struct gpu_tsg *tsg)
{
	struct gpu *gpu = tsg->gpu;
	struct gpu_engine *engine;

	gpu_enter(gpu);
	if (--tsg->refs) {
		gpu_leave(gpu);
		return;
	}
	engine = tsg->engine;
	list_del(&tsg->node);
	__clear_bit(tsg->id, gpu->ids);
	if (engine) {
		gpu_build_runlist(engine);
		if (engine->current_tsg == tsg) {
			gpu_left_engine(engine);
			gpu_choose(engine, ktime_get_ns());
		}
	}
	gpu_leave(gpu);
	kfree(tsg);
}

void gpu_tsg_enable(struct gpu_tsg *tsg)
{
	gpu_enter(tsg->gpu);
	gpu_tsg_enable_all(tsg);
	gpu_leave(tsg->gpu);
}

void gpu_tsg_disable(struct gpu_tsg *tsg)
{
	struct gpu_channel *channel;

	gpu_enter(tsg->gpu);
	list_for_each_entry(channel, &tsg->channels, node)
		channel->enabled = false;
	gpu_leave(tsg->gpu);
}

static bool gpu_tsg_off_engine(struct gpu_tsg *tsg)
{
	bool off;

	gpu_enter(tsg->gpu);
	off = tsg->engine->current_tsg != tsg || !tsg->preempt;
	gpu_leave(tsg->gpu);
	return off;
}

/* nvgpu's way to wait for a PBDMA or an engine: it looks, and sleeps twice as long each time. */
static int gpu_poll_unit(struct gpu_tsg *tsg, bool stuck)
{
	ktime_t until = ktime_add_ms(ktime_get(), GPU_POLL_MS);
	unsigned int delay_us = 10;

	while (stuck || !gpu_tsg_off_engine(tsg)) {
		if (ktime_after(ktime_get(), until))
			return -EBUSY;
		usleep_range(delay_us, delay_us * 2);
		delay_us = min(delay_us * 2, 200u);
	}
	return 0;
}

int gpu_tsg_preempt(struct gpu_tsg *tsg, bool stuck)
{
	struct gpu_engine *engine = READ_ONCE(tsg->engine);
	int err;

	if (!engine)
		return 0; /* no channel, hence no runlist */
	mutex_lock(&engine->busy);
	gpu_enter(tsg->gpu);
	if (engine->current_tsg == tsg)
		tsg->preempt = true; /* which stays, whoever gives up waiting */
	gpu_leave(tsg->gpu);
	err = gpu_poll_unit(tsg, stuck); /* its PBDMA */
	if (err)
		gpu_poll_unit(tsg, stuck); /* the engine: the same answer, as long again */
	mutex_unlock(&engine->busy);
	return err;
}

int gpu_tsg_set_level(struct gpu_tsg *tsg, u32 level)
{
	struct gpu_engine *engine = READ_ONCE(tsg->engine);

	if (level >= NVGPU_RUNLIST_INTERLEAVE_NUM_LEVELS)
		return -EINVAL;
	if (engine)
		mutex_lock(&engine->busy);
	gpu_enter(tsg->gpu);
	tsg->level = level;
	if (engine)
		gpu_build_runlist(engine);
	gpu_leave(tsg->gpu);
	if (engine)
		mutex_unlock(&engine->busy);
	return 0;
}

int gpu_tsg_set_timeslice(struct gpu_tsg *tsg, u32 us)
{
	struct gpu_engine *engine = READ_ONCE(tsg->engine);

	if (us < NVGPU_TSG_TIMESLICE_MIN_US || us > NVGPU_TSG_TIMESLICE_MAX_US)
		return -EINVAL;
	if (engine)
		mutex_lock(&engine->busy);
	gpu_enter(tsg->gpu);
	tsg->timeslice_us = us;
	gpu_leave(tsg->gpu);
	if (engine)
		mutex_unlock(&engine->busy);
	return 0;
}

struct gpu_channel *gpu_channel_new(struct gpu *gpu, u32 engine)
{
	struct gpu_channel *channel = kzalloc(sizeof(*channel), GFP_KERNEL);

	if (!channel)
		return NULL;
	channel->gpu = gpu;
	channel->engine = &gpu->engines[engine];
	INIT_LIST_HEAD(&channel->node);
	INIT_LIST_HEAD(&channel->work);
	init_waitqueue_head(&channel->done);
	return channel;
}

int gpu_channel_unbind(struct gpu_tsg *tsg, struct gpu_channel *channel)
{
	struct gpu_tsg *from = NULL;

	mutex_lock(&channel->engine->busy);
	gpu_enter(channel->gpu);
	if (!tsg || channel->tsg == tsg)
		from = channel->tsg;
	if (from) {
		gpu_channel_drop_work(channel);
		gpu_tsg_lose(from, channel);
	}
	gpu_leave(channel->gpu);
	mutex_unlock(&channel->engine->busy);
	if (!from)
		return -EINVAL;
	gpu_tsg_put(from);
	return 0;
}

void gpu_channel_close(struct gpu_channel *channel)
{
	gpu_channel_unbind(NULL, channel);
	kfree(channel);
}

int gpu_channel_bind(struct gpu_tsg *tsg, struct gpu_channel *channel, bool enable_all)
{
	struct gpu_engine *engine = channel->engine;
	int err = -EINVAL;

	if (channel->gpu != tsg->gpu)
		return -EINVAL;
	mutex_lock(&engine->busy);
	gpu_enter(tsg->gpu);
	if (!channel->tsg && (!tsg->engine || tsg->engine == engine)) {
		err = 0;
		tsg->refs++;
		channel->tsg = tsg;
		channel->enabled = true;
		list_add_tail(&channel->node, &tsg->channels);
		if (enable_all)
			gpu_tsg_enable_all(tsg);
		WRITE_ONCE(tsg->engine, engine);
		gpu_build_runlist(engine);
	}
	gpu_leave(tsg->gpu);
	mutex_unlock(&engine->busy);
	return err;
}

int gpu_channel_touch(struct gpu_channel *channel)
{
	int err = -EINVAL;

	gpu_enter(channel->gpu);
	if (channel->tsg) {
		gpu_tsg_enable_all(channel->tsg);
		err = 0;
	}
	gpu_leave(channel->gpu);
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
	pm_runtime_get_sync(gpu->dev); /* the work's, until it has finished */
	gpu_enter(gpu);
	if (!channel->tsg) {
		err = -EINVAL;
	} else if (channel->tsg->killed) {
		err = -EIO;
	} else if (channel->waiting >= GPU_MAX_WORK) {
		err = -EAGAIN;
	} else {
		list_add_tail(&work->node, &channel->work);
		channel->waiting++;
		*sequence = ++channel->submitted;
	}
	gpu_leave(gpu);
	if (err) {
		pm_runtime_put_autosuspend(gpu->dev);
		kfree(work);
	}
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
	int i;

	gpu_enter(gpu);
	gpu->powered = false;
	for (i = 0; i < GPU_ENGINES; i++) {
		gpu_left_engine(&gpu->engines[i]);
		gpu->engines[i].phase = GPU_IDLE;
	}
	gpu_leave(gpu);
}

void gpu_power_on(struct gpu *gpu)
{
	struct gpu_tsg *tsg;

	gpu_enter(gpu);
	gpu->powered = true;
	list_for_each_entry(tsg, &gpu->tsgs, node)
		gpu_tsg_enable_all(tsg);
	gpu_leave(gpu);
}

static void gpu_tsg_show(struct gpu_tsg *tsg, u32 number, struct seq_file *out)
{
	struct gpu_channel *channel;
	u32 channels = 0, on = 0;

	list_for_each_entry(channel, &tsg->channels, node) {
		channels++;
		on += channel->enabled;
	}
	seq_printf(out, "tsg=%u enabled=%d current=%d killed=%d stuck_ms=%u level=%u timeslice_us=%u ",
		   number, on || !channels, tsg->engine && tsg == tsg->engine->current_tsg,
		   tsg->killed, tsg->stuck_ms, tsg->level, tsg->timeslice_us);
	seq_printf(out, "busy=%d channels=%u on=%u ran_us=%llu\n",
		   !!gpu_tsg_busy_channel(tsg, true), channels, on,
		   div_u64(tsg->ran_ns, NSEC_PER_USEC));
}

void gpu_show(struct gpu *gpu, struct seq_file *out)
{
	static const char * const phases[] = { "idle", "restore", "run", "save" };
	struct gpu_tsg *tsg;
	u32 i;

	gpu_enter(gpu);
	for (i = 0; i < GPU_ENGINES; i++)
		seq_printf(out, "engine=%u phase=%s switches=%llu runlist=%u\n", i,
			   phases[gpu->engines[i].phase], gpu->engines[i].switches,
			   gpu->engines[i].runlist_length);
	i = 0;
	list_for_each_entry(tsg, &gpu->tsgs, node)
		gpu_tsg_show(tsg, i++, out);
	gpu_leave(gpu);
}
