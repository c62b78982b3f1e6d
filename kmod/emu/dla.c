// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto_nvdla_emu.ko: nvdla's device nodes and ioctls, with their numbers and structures, over
 * emulated DLAs.
 *
 * A DLA runs one task at a time, to its end. Queues take turns, a task each. A suspended queue
 * starts none; the task that runs when it is suspended completes. Tasks are durations
 * (include/uapi/xauto/emu.h).
 *
 * As in the driver, queues are slots of a fixed pool, and a file has at most one. What is suspended
 * is a slot, in the firmware: its commands carry the slot's number, whoever has it by then. No lock
 * keeps a file's queue from being released while a command is on its way; one mutex of the DLA
 * covers commands and submits, and a command may take a second. Power that goes takes the
 * firmware's memory with it; only tasks keep it.
 */
#include <linux/bitmap.h>
#include <linux/cdev.h>
#include <linux/debugfs.h>
#include <linux/delay.h>
#include <linux/device.h>
#include <linux/fs.h>
#include <linux/hrtimer.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/platform_device.h>
#include <linux/pm_runtime.h>
#include <linux/poll.h>
#include <linux/seq_file.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include <uapi/xauto/emu.h>
#include <uapi/xauto/nvdla.h>

#include "compat.h"
#include "fault.h"

#define N_DLAS		 2
#define MAX_QUEUES	 16  /* of one DLA, as nvdla has */
#define MAX_TASKS	 256 /* waiting in one queue */
#define FIRMWARE_VERSION 0x010802

#define COMMAND_LIMIT_US (1000 * 1000) /* nvdla's CMD_TIMEOUT_MSEC */

static char *dla_release = "r36";
module_param_named(release, dla_release, charp, 0444);
MODULE_PARM_DESC(release, "whose nvdla this is: r35, built in, or r36 (default: r36)");
static unsigned int dla_command_us = 50;
module_param_named(command_us, dla_command_us, uint, 0644);
MODULE_PARM_DESC(command_us,
		 "the firmware's time for suspend or resume; above a second: none (default: 50)");
static bool dla_flush_resumes;
module_param_named(flush_resumes, dla_flush_resumes, bool, 0644);
MODULE_PARM_DESC(flush_resumes,
		 "RELEASE_QUEUE makes the firmware forget that the slot is suspended (default: no)");

/* Faults, in debugfs: how many of the next calls the firmware refuses. */
static u32 dla_fail_suspend;
static u32 dla_fail_resume;

struct dla_task {
	struct list_head node;
	u64 duration_ns;
};

/**
 * struct dla_queue - a slot; the DLA's lock covers it
 * @used: ALLOC_QUEUE gave it to a file
 * @tasks: waiting, in order; each holds a power reference
 * @waiting: length of @tasks
 * @submitted: number of the last
 * @finished: how many are done
 * @done: woken when one is, or the queue is released
 */
struct dla_queue {
	bool used;
	struct list_head tasks;
	u32 waiting;
	u64 submitted;
	u64 finished;
	wait_queue_head_t done;
};

/**
 * struct dla - one engine
 * @lock: covers it and its queues
 * @command: nvdla's cmd_lock: one command or submit at a time
 * @pdev: its device, powered while there are tasks
 * @asleep: the system sleeps: every call answers EAGAIN
 * @queues: the slots
 * @suspended: the firmware's, by slot
 * @turn: the slot that ran last
 * @running: the queue whose task runs; NULL: idle, or the queue is gone
 * @busy: a task runs
 * @end: the task's, hrtimer
 */
struct dla {
	spinlock_t lock; /* the DLA and its queues */
	struct mutex command; /* the firmware's mailbox */
	struct platform_device *pdev;
	bool asleep;
	struct dla_queue queues[MAX_QUEUES];
	DECLARE_BITMAP(suspended, MAX_QUEUES);
	u32 turn;
	struct dla_queue *running;
	bool busy;
	struct hrtimer end;
};

/**
 * struct dla_file - an open ctrl node
 * @dla: the node's
 * @queue: NULL before ALLOC_QUEUE; no lock covers it, as in the driver
 */
struct dla_file {
	struct dla *dla;
	struct dla_queue *queue;
};

static struct dla dla_engines[N_DLAS];
static struct class *dla_node_class;
static struct cdev dla_node_cdev;
static dev_t dla_node_base;
static struct dentry *dla_debug_dir;

static u32 dla_id(struct dla *dla, struct dla_queue *queue)
{
	return queue - dla->queues;
}

static void dla_put_power(struct dla *dla)
{
	pm_runtime_mark_last_busy(&dla->pdev->dev);
	pm_runtime_put_autosuspend(&dla->pdev->dev);
}

/* The DLA is idle: whose turn is it? */
static void dla_start_next(struct dla *dla)
{
	struct dla_queue *queue;
	struct dla_task *task;
	u32 i, at;

	lockdep_assert_held(&dla->lock);
	for (i = 1; i <= MAX_QUEUES; i++) {
		at = (dla->turn + i) % MAX_QUEUES;
		queue = &dla->queues[at];
		if (test_bit(at, dla->suspended) || list_empty(&queue->tasks))
			continue;
		task = list_first_entry(&queue->tasks, struct dla_task, node);
		list_del(&task->node);
		queue->waiting--;
		dla->turn = at;
		dla->running = queue;
		dla->busy = true;
		hrtimer_start(&dla->end, ns_to_ktime(task->duration_ns), HRTIMER_MODE_REL_SOFT);
		kfree(task);
		return;
	}
}

static enum hrtimer_restart dla_task_ends(struct hrtimer *timer)
{
	struct dla *dla = container_of(timer, struct dla, end);

	spin_lock_bh(&dla->lock);
	if (dla->running) {
		dla->running->finished++;
		wake_up_all(&dla->running->done);
	}
	dla->running = NULL;
	dla->busy = false;
	dla_put_power(dla);
	dla_start_next(dla);
	spin_unlock_bh(&dla->lock);
	return HRTIMER_NORESTART;
}

static long dla_alloc_queue(struct dla_file *file)
{
	struct dla *dla = file->dla;
	long err = -EAGAIN; /* the driver's word for a pool that is empty */
	int i;

	spin_lock_bh(&dla->lock);
	if (file->queue)
		err = -EINVAL;
	for (i = 0; err == -EAGAIN && i < MAX_QUEUES; i++) {
		struct dla_queue *queue = &dla->queues[i];

		if (queue->used)
			continue;
		queue->used = true;
		queue->submitted = 0;
		queue->finished = 0;
		WRITE_ONCE(file->queue, queue);
		err = 0;
	}
	spin_unlock_bh(&dla->lock);
	return err;
}

static long dla_release_queue(struct dla_file *file)
{
	struct dla *dla = file->dla;
	struct dla_task *task, *next;
	struct dla_queue *queue;

	mutex_lock(&dla->command); /* QUEUE_FLUSH */
	spin_lock_bh(&dla->lock);
	queue = file->queue;
	if (queue) {
		list_for_each_entry_safe(task, next, &queue->tasks, node) {
			list_del(&task->node);
			kfree(task);
			dla_put_power(dla);
		}
		queue->waiting = 0;
		if (dla->running == queue)
			dla->running = NULL; /* its task runs to the end for nobody */
		if (dla_flush_resumes)
			clear_bit(dla_id(dla, queue), dla->suspended);
		queue->used = false;
		WRITE_ONCE(file->queue, NULL);
		wake_up_all(&queue->done);
	}
	spin_unlock_bh(&dla->lock);
	mutex_unlock(&dla->command);
	return queue ? 0 : -EINVAL;
}

static int dla_submit_one(struct dla *dla, struct dla_queue *queue, struct xauto_emu_work *work)
{
	struct dla_task *task;
	int err = 0;

	if (!work->duration_ns || work->duration_ns > XAUTO_EMU_MAX_DURATION_NS)
		return -EINVAL;
	task = kmalloc(sizeof(*task), GFP_KERNEL);
	if (!task)
		return -ENOMEM;
	task->duration_ns = work->duration_ns;
	pm_runtime_get_sync(&dla->pdev->dev); /* the task's, until it has ended */
	spin_lock_bh(&dla->lock);
	if (!queue->used) {
		err = -EINVAL; /* released meanwhile */
	} else if (queue->waiting >= MAX_TASKS) {
		err = -EAGAIN;
	} else {
		list_add_tail(&task->node, &queue->tasks);
		queue->waiting++;
		work->sequence = ++queue->submitted;
		if (!dla->busy)
			dla_start_next(dla);
	}
	spin_unlock_bh(&dla->lock);
	if (err) {
		kfree(task);
		dla_put_power(dla);
	}
	return err;
}

static long dla_submit(struct dla *dla, struct dla_queue *queue, void __user *arg)
{
	struct xauto_emu_work __user *tasks;
	struct nvdla_submit_args args;
	struct xauto_emu_work work;
	int i, err = 0;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	if (args.version != XAUTO_EMU_TASK_VERSION || args.flags || !args.num_tasks ||
	    args.num_tasks > NVDLA_MAX_TASKS_PER_SUBMIT)
		return -EINVAL;
	tasks = u64_to_user_ptr(args.tasks);
	for (i = 0; i < args.num_tasks && !err; i++) {
		if (copy_from_user(&work, &tasks[i], sizeof(work)))
			return -EFAULT;
		mutex_lock(&dla->command);
		err = dla_submit_one(dla, queue, &work);
		mutex_unlock(&dla->command);
		if (!err && copy_to_user(&tasks[i], &work, sizeof(work)))
			err = -EFAULT;
	}
	return err;
}

/* A command about a slot, whoever has it when the firmware comes to it. */
static long dla_command(struct dla *dla, u32 id, bool suspend)
{
	u32 us = READ_ONCE(dla_command_us);
	long err = 0;

	mutex_lock(&dla->command);
	pm_runtime_get_sync(&dla->pdev->dev);
	if (us)
		fsleep(min_t(u32, us, COMMAND_LIMIT_US));
	if (us > COMMAND_LIMIT_US) {
		err = -ETIMEDOUT;
	} else if (xauto_emu_take_fault(suspend ? &dla_fail_suspend : &dla_fail_resume)) {
		err = -EINVAL; /* whatever the firmware says */
	} else {
		spin_lock_bh(&dla->lock);
		assign_bit(id, dla->suspended, suspend);
		if (!suspend && !dla->busy)
			dla_start_next(dla);
		spin_unlock_bh(&dla->lock);
	}
	dla_put_power(dla);
	mutex_unlock(&dla->command);
	return err;
}

static long dla_set_status(struct dla *dla, struct dla_queue *queue, void __user *arg)
{
	struct nvdla_set_queue_status_args args;
	bool suspend;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	suspend = args.status & NVDLA_SET_QUEUE_SUSPEND;
	if (suspend == !!(args.status & NVDLA_SET_QUEUE_RESUME))
		return -EINVAL;
	return dla_command(dla, dla_id(dla, queue), suspend);
}

/* No command: the slot's number, and the fence of what was submitted last. */
static long dla_get_status(struct dla *dla, struct dla_queue *queue, void __user *arg)
{
	struct nvdev_fence fence = {};
	struct nvdla_get_q_status_args args;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	args.id = dla_id(dla, queue);
	fence.syncpoint_index = args.id;
	fence.syncpoint_value = READ_ONCE(queue->submitted);
	if (copy_to_user(u64_to_user_ptr(args.fence), &fence, sizeof(fence)))
		return -EFAULT;
	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long dla_ping(void __user *arg)
{
	struct nvdla_ping_args args;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	args.out_response = args.in_challenge * 4; /* nvdla's firmware answers so */
	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long dla_firmware_version(void __user *arg)
{
	struct nvdla_get_fw_ver_args args = { .version = FIRMWARE_VERSION };

	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long dla_ctrl_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	struct dla_file *dla_file = file->private_data;
	void __user *arg = (void __user *)value;
	struct dla *dla = dla_file->dla;
	struct dla_queue *queue = READ_ONCE(dla_file->queue);

	if (READ_ONCE(dla->asleep))
		return -EAGAIN;
	switch (cmd) {
	case NVDLA_IOCTL_PING:
		return dla_ping(arg);
	case NVDLA_IOCTL_GET_FIRMWARE_VERSION:
		return dla_firmware_version(arg); /* with a queue or without */
	case NVDLA_IOCTL_ALLOC_QUEUE:
		return dla_alloc_queue(dla_file);
	case NVDLA_IOCTL_RELEASE_QUEUE:
		return dla_release_queue(dla_file);
	case NVDLA_IOCTL_EMU_TASK_SUBMIT:
		return queue ? dla_submit(dla, queue, arg) : -EINVAL;
	case NVDLA_IOCTL_SET_QUEUE_STATUS:
		return queue ? dla_set_status(dla, queue, arg) : -EINVAL;
	case NVDLA_IOCTL_GET_QUEUE_STATUS:
		return queue ? dla_get_status(dla, queue, arg) : -EINVAL;
	}
	return -ENOIOCTLCMD;
}

static bool dla_file_idle(struct dla_file *file, u64 *finished)
{
	struct dla *dla = file->dla;
	struct dla_queue *queue;
	bool idle = true;

	*finished = 0;
	spin_lock_bh(&dla->lock);
	queue = file->queue;
	if (queue) {
		*finished = queue->finished;
		idle = list_empty(&queue->tasks) && dla->running != queue;
	}
	spin_unlock_bh(&dla->lock);
	return idle;
}

static __poll_t dla_ctrl_poll(struct file *file, struct poll_table_struct *table)
{
	struct dla_file *dla_file = file->private_data;
	struct dla_queue *queue = READ_ONCE(dla_file->queue);
	u64 finished;

	if (queue) /* a slot is there for ever */
		poll_wait(file, &queue->done, table);
	return dla_file_idle(dla_file, &finished) ? EPOLLIN | EPOLLRDNORM : 0;
}

static ssize_t dla_ctrl_read(struct file *file, char __user *to, size_t size, loff_t *at)
{
	u64 finished;

	if (size < sizeof(finished))
		return -EINVAL;
	dla_file_idle(file->private_data, &finished);
	return copy_to_user(to, &finished, sizeof(finished)) ? -EFAULT : sizeof(finished);
}

static int dla_ctrl_open(struct inode *inode, struct file *file)
{
	struct dla_file *dla_file;

	if (iminor(inode) >= N_DLAS)
		return -ENXIO;
	dla_file = kzalloc(sizeof(*dla_file), GFP_KERNEL);
	if (!dla_file)
		return -ENOMEM;
	dla_file->dla = &dla_engines[iminor(inode)];
	file->private_data = dla_file;
	return 0;
}

static int dla_ctrl_release(struct inode *inode, struct file *file)
{
	struct dla_file *dla_file = file->private_data;

	dla_release_queue(dla_file);
	kfree(dla_file);
	return 0;
}

/* A file of a built-in driver names no module; its node still does, and keeps this one loaded. */
#define DLA_FOPS(module)                         \
	{                                        \
		.owner = (module),               \
		.open = dla_ctrl_open,           \
		.release = dla_ctrl_release,     \
		.unlocked_ioctl = dla_ctrl_ioctl, \
		.compat_ioctl = dla_ctrl_ioctl,  \
		.poll = dla_ctrl_poll,           \
		.read = dla_ctrl_read,           \
		XAUTO_NO_LLSEEK                  \
	}
static const struct file_operations dla_module_fops = DLA_FOPS(THIS_MODULE);
static const struct file_operations dla_built_in_fops = DLA_FOPS(NULL);

static bool dla_is_built_in(void)
{
	return !strcmp(dla_release, "r35");
}

static char *dla_devnode(XAUTO_DEVNODE_CONST struct device *dev, umode_t *mode)
{
	if (mode)
		*mode = 0666;
	return kasprintf(GFP_KERNEL, "nvhost-ctrl-nvdla%u", MINOR(dev->devt));
}

static int dla_state_show(struct seq_file *out, void *data)
{
	int i, id;

	for (i = 0; i < N_DLAS; i++) {
		struct dla *dla = &dla_engines[i];

		spin_lock_bh(&dla->lock);
		seq_printf(out, "dla=%d busy=%d powered=%d\n", i, dla->busy,
			   pm_runtime_active(&dla->pdev->dev));
		for (id = 0; id < MAX_QUEUES; id++) {
			struct dla_queue *queue = &dla->queues[id];

			if (queue->used)
				seq_printf(out,
					   "queue=%d suspended=%d running=%d waiting=%u finished=%llu\n",
					   id, test_bit(id, dla->suspended), dla->running == queue,
					   queue->waiting, queue->finished);
			else if (test_bit(id, dla->suspended))
				seq_printf(out, "free=%d stale=1\n", id);
		}
		spin_unlock_bh(&dla->lock);
	}
	return 0;
}
DEFINE_SHOW_ATTRIBUTE(dla_state);

static struct dla *dla_of(struct device *dev)
{
	int i;

	for (i = 0; i < N_DLAS - 1; i++)
		if (dla_engines[i].pdev && &dla_engines[i].pdev->dev == dev)
			break;
	return &dla_engines[i];
}

static int dla_runtime_suspend(struct device *dev)
{
	return 0;
}

/* nvdla's poweron_reset: the firmware starts anew. */
static int dla_runtime_resume(struct device *dev)
{
	struct dla *dla = dla_of(dev);

	spin_lock_bh(&dla->lock);
	bitmap_zero(dla->suspended, MAX_QUEUES);
	if (!dla->busy)
		dla_start_next(dla);
	spin_unlock_bh(&dla->lock);
	return 0;
}

/* A task that is pending keeps the system awake. */
static int __maybe_unused dla_system_suspend(struct device *dev)
{
	struct dla *dla = dla_of(dev);
	bool pending;
	int i;

	spin_lock_bh(&dla->lock);
	pending = dla->busy;
	for (i = 0; i < MAX_QUEUES; i++)
		pending |= !list_empty(&dla->queues[i].tasks);
	dla->asleep = !pending;
	spin_unlock_bh(&dla->lock);
	return pending ? -EBUSY : pm_runtime_force_suspend(dev);
}

static int __maybe_unused dla_system_resume(struct device *dev)
{
	WRITE_ONCE(dla_of(dev)->asleep, false);
	return pm_runtime_force_resume(dev);
}

static const struct dev_pm_ops dla_pm_ops = {
	SET_RUNTIME_PM_OPS(dla_runtime_suspend, dla_runtime_resume, NULL)
	SET_SYSTEM_SLEEP_PM_OPS(dla_system_suspend, dla_system_resume)
};

static struct platform_driver dla_driver = {
	.driver = {
		.name = "nvdla",
		.pm = &dla_pm_ops,
	},
};

static void dla_remove(struct dla *dla)
{
	hrtimer_cancel(&dla->end);
	pm_runtime_disable(&dla->pdev->dev);
	pm_runtime_dont_use_autosuspend(&dla->pdev->dev);
	platform_device_unregister(dla->pdev);
}

static int dla_add(struct dla *dla, int id)
{
	int i;

	spin_lock_init(&dla->lock);
	mutex_init(&dla->command);
	for (i = 0; i < MAX_QUEUES; i++) {
		INIT_LIST_HEAD(&dla->queues[i].tasks);
		init_waitqueue_head(&dla->queues[i].done);
	}
	xauto_hrtimer_setup(&dla->end, dla_task_ends, HRTIMER_MODE_REL_SOFT);
	dla->pdev = platform_device_register_simple("nvdla", id, NULL, 0);
	if (IS_ERR(dla->pdev))
		return PTR_ERR(dla->pdev);
	pm_runtime_set_autosuspend_delay(&dla->pdev->dev, 50);
	pm_runtime_use_autosuspend(&dla->pdev->dev);
	pm_runtime_enable(&dla->pdev->dev);
	return 0;
}

static void dla_remove_nodes(int count)
{
	while (count-- > 0)
		device_destroy(dla_node_class, dla_node_base + count);
	class_destroy(dla_node_class);
	cdev_del(&dla_node_cdev);
	unregister_chrdev_region(dla_node_base, N_DLAS);
}

static int dla_create_nodes(void)
{
	int i, err;

	err = alloc_chrdev_region(&dla_node_base, 0, N_DLAS, "nvhost-nvdla");
	if (err)
		return err;
	cdev_init(&dla_node_cdev, dla_is_built_in() ? &dla_built_in_fops : &dla_module_fops);
	dla_node_cdev.owner = THIS_MODULE;
	err = cdev_add(&dla_node_cdev, dla_node_base, N_DLAS);
	if (err)
		goto err_region;
	dla_node_class = xauto_class_create("nvdla-emu");
	if (IS_ERR(dla_node_class)) {
		err = PTR_ERR(dla_node_class);
		goto err_cdev;
	}
	dla_node_class->devnode = dla_devnode;
	for (i = 0; i < N_DLAS; i++) {
		struct device *dev = device_create(dla_node_class, &dla_engines[i].pdev->dev,
						   dla_node_base + i, NULL, "ctrl-nvdla%d", i);

		if (IS_ERR(dev)) {
			dla_remove_nodes(i);
			return PTR_ERR(dev);
		}
	}
	return 0;

err_cdev:
	cdev_del(&dla_node_cdev);
err_region:
	unregister_chrdev_region(dla_node_base, N_DLAS);
	return err;
}

static int __init dla_emu_init(void)
{
	int i, err;

	if (!dla_is_built_in() && strcmp(dla_release, "r36"))
		return -EINVAL;
	err = platform_driver_register(&dla_driver);
	if (err)
		return err;
	if (dla_is_built_in())
		dla_driver.driver.owner = NULL;
	for (i = 0; i < N_DLAS; i++) {
		err = dla_add(&dla_engines[i], i);
		if (err)
			goto err_dlas;
	}
	err = dla_create_nodes();
	if (err)
		goto err_dlas;
	dla_debug_dir = debugfs_create_dir("xauto_nvdla_emu", NULL);
	debugfs_create_file("state", 0444, dla_debug_dir, NULL, &dla_state_fops);
	debugfs_create_u32("fail_suspend", 0644, dla_debug_dir, &dla_fail_suspend);
	debugfs_create_u32("fail_resume", 0644, dla_debug_dir, &dla_fail_resume);
	return 0;

err_dlas:
	while (i-- > 0)
		dla_remove(&dla_engines[i]);
	platform_driver_unregister(&dla_driver);
	return err;
}

static void __exit dla_emu_exit(void)
{
	int i;

	debugfs_remove_recursive(dla_debug_dir);
	dla_remove_nodes(N_DLAS);
	for (i = 0; i < N_DLAS; i++)
		dla_remove(&dla_engines[i]);
	platform_driver_unregister(&dla_driver);
}

module_init(dla_emu_init);
module_exit(dla_emu_exit);

MODULE_DESCRIPTION("nvdla's interface without a DLA, for tests");
MODULE_AUTHOR("The XAuto authors");
MODULE_LICENSE("GPL");
