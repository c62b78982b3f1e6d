// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto_nvdla_emu.ko: nvdla's device nodes and ioctls, with their numbers and structures, over
 * emulated DLAs.
 *
 * A DLA runs one task at a time, to its end. Queues take turns, a task each. A suspended queue
 * starts none; the task that runs when it is suspended completes. Tasks are durations
 * (include/uapi/xauto/emu.h).
 */
#include <linux/cdev.h>
#include <linux/debugfs.h>
#include <linux/delay.h>
#include <linux/device.h>
#include <linux/fs.h>
#include <linux/hrtimer.h>
#include <linux/module.h>
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

static unsigned int dla_command_us = 50;
module_param_named(command_us, dla_command_us, uint, 0644);
MODULE_PARM_DESC(command_us, "the firmware's time for suspend or resume (default: 50)");

/* Faults, in debugfs: how many of the next calls fail. */
static u32 dla_fail_suspend;
static u32 dla_fail_resume;

struct dla_task {
	struct list_head node;
	u64 duration_ns;
};

/**
 * struct dla_queue - what ALLOC_QUEUE gave to a file
 * @dla: it belongs to
 * @node: in the DLA's list, moved to its end when its turn is over
 * @tasks: waiting, in order
 * @waiting: length of @tasks
 * @suspended: starts none
 * @submitted: number of the last
 * @finished: how many are done
 * @done: the file's, woken when one is
 */
struct dla_queue {
	struct dla *dla;
	struct list_head node;
	struct list_head tasks;
	u32 waiting;
	bool suspended;
	u64 submitted;
	u64 finished;
	wait_queue_head_t *done;
};

/**
 * struct dla - one engine
 * @lock: covers it and its queues
 * @pdev: its device, powered while a task runs
 * @queues: the order of turns
 * @n_queues: length of @queues
 * @running: the queue whose task runs; NULL: idle, or the queue is gone
 * @busy: a task runs
 * @end: the task's, hrtimer
 */
struct dla {
	spinlock_t lock; /* the DLA and its queues */
	struct platform_device *pdev;
	struct list_head queues;
	u32 n_queues;
	struct dla_queue *running;
	bool busy;
	struct hrtimer end;
};

/**
 * struct dla_file - an open ctrl node
 * @dla: the node's
 * @lock: covers @queue
 * @queue: NULL before ALLOC_QUEUE
 * @done: those who poll; lives as long as the file, the queue does not
 */
struct dla_file {
	struct dla *dla;
	struct mutex lock; /* @queue */
	struct dla_queue *queue;
	wait_queue_head_t done;
};

static struct dla dla_engines[N_DLAS];
static struct class *dla_node_class;
static struct cdev dla_node_cdev;
static dev_t dla_node_base;
static struct dentry *dla_debug_dir;

/* The DLA is idle: whose turn is it? */
static void dla_start_next(struct dla *dla)
{
	struct dla_queue *queue;
	struct dla_task *task;

	lockdep_assert_held(&dla->lock);
	list_for_each_entry(queue, &dla->queues, node) {
		if (queue->suspended || list_empty(&queue->tasks))
			continue;
		task = list_first_entry(&queue->tasks, struct dla_task, node);
		list_del(&task->node);
		queue->waiting--;
		list_move_tail(&queue->node, &dla->queues);
		dla->running = queue;
		dla->busy = true;
		pm_runtime_get_noresume(&dla->pdev->dev);
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
		wake_up_all(dla->running->done);
	}
	dla->running = NULL;
	dla->busy = false;
	pm_runtime_mark_last_busy(&dla->pdev->dev);
	pm_runtime_put_autosuspend(&dla->pdev->dev);
	dla_start_next(dla);
	spin_unlock_bh(&dla->lock);
	return HRTIMER_NORESTART;
}

static long dla_alloc_queue(struct dla_file *file)
{
	struct dla *dla = file->dla;
	struct dla_queue *queue;

	if (file->queue)
		return -EINVAL;
	queue = kzalloc(sizeof(*queue), GFP_KERNEL);
	if (!queue)
		return -ENOMEM;
	queue->dla = dla;
	INIT_LIST_HEAD(&queue->tasks);
	queue->done = &file->done;
	spin_lock_bh(&dla->lock);
	if (dla->n_queues >= MAX_QUEUES) {
		spin_unlock_bh(&dla->lock);
		kfree(queue);
		return -ENOSPC;
	}
	dla->n_queues++;
	list_add_tail(&queue->node, &dla->queues);
	spin_unlock_bh(&dla->lock);
	file->queue = queue;
	return 0;
}

static long dla_release_queue(struct dla_file *file)
{
	struct dla_queue *queue = file->queue;
	struct dla_task *task, *next;

	if (!queue)
		return -EINVAL;
	spin_lock_bh(&queue->dla->lock);
	list_for_each_entry_safe(task, next, &queue->tasks, node)
		kfree(task);
	list_del(&queue->node);
	queue->dla->n_queues--;
	if (queue->dla->running == queue)
		queue->dla->running = NULL; /* its task runs to the end for nobody */
	spin_unlock_bh(&queue->dla->lock);
	file->queue = NULL;
	kfree(queue);
	return 0;
}

static int dla_submit_one(struct dla_queue *queue, struct xauto_emu_work *work)
{
	struct dla *dla = queue->dla;
	struct dla_task *task;
	int err = 0;

	if (!work->duration_ns || work->duration_ns > XAUTO_EMU_MAX_DURATION_NS)
		return -EINVAL;
	task = kmalloc(sizeof(*task), GFP_KERNEL);
	if (!task)
		return -ENOMEM;
	task->duration_ns = work->duration_ns;
	spin_lock_bh(&dla->lock);
	if (queue->waiting >= MAX_TASKS) {
		err = -EAGAIN;
		kfree(task);
	} else {
		list_add_tail(&task->node, &queue->tasks);
		queue->waiting++;
		work->sequence = ++queue->submitted;
		if (!dla->busy)
			dla_start_next(dla);
	}
	spin_unlock_bh(&dla->lock);
	return err;
}

static long dla_submit(struct dla_queue *queue, void __user *arg)
{
	struct device *dev = &queue->dla->pdev->dev;
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
	pm_runtime_get_sync(dev);
	for (i = 0; i < args.num_tasks && !err; i++) {
		if (copy_from_user(&work, &tasks[i], sizeof(work))) {
			err = -EFAULT;
		} else {
			err = dla_submit_one(queue, &work);
			if (!err && copy_to_user(&tasks[i], &work, sizeof(work)))
				err = -EFAULT;
		}
	}
	pm_runtime_mark_last_busy(dev);
	pm_runtime_put_autosuspend(dev);
	return err;
}

static long dla_set_status(struct dla_queue *queue, void __user *arg)
{
	struct device *dev = &queue->dla->pdev->dev;
	struct nvdla_set_queue_status_args args;
	bool suspend;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	suspend = args.status & NVDLA_SET_QUEUE_SUSPEND;
	if (suspend == !!(args.status & NVDLA_SET_QUEUE_RESUME))
		return -EINVAL;
	if (xauto_emu_take_fault(suspend ? &dla_fail_suspend : &dla_fail_resume))
		return -ETIMEDOUT;
	pm_runtime_get_sync(dev);
	if (dla_command_us)
		usleep_range(dla_command_us, dla_command_us + dla_command_us / 8 + 1);
	spin_lock_bh(&queue->dla->lock);
	queue->suspended = suspend;
	if (!suspend && !queue->dla->busy)
		dla_start_next(queue->dla);
	spin_unlock_bh(&queue->dla->lock);
	pm_runtime_mark_last_busy(dev);
	pm_runtime_put_autosuspend(dev);
	return 0;
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

static long dla_locked_ioctl(struct dla_file *file, unsigned int cmd, void __user *arg)
{
	switch (cmd) {
	case NVDLA_IOCTL_PING:
		return dla_ping(arg);
	case NVDLA_IOCTL_GET_FIRMWARE_VERSION:
		return dla_firmware_version(arg);
	case NVDLA_IOCTL_ALLOC_QUEUE:
		return dla_alloc_queue(file);
	case NVDLA_IOCTL_RELEASE_QUEUE:
		return dla_release_queue(file);
	}
	if (!file->queue)
		return -EINVAL;
	switch (cmd) {
	case NVDLA_IOCTL_EMU_TASK_SUBMIT:
		return dla_submit(file->queue, arg);
	case NVDLA_IOCTL_SET_QUEUE_STATUS:
		return dla_set_status(file->queue, arg);
	}
	return -ENOTTY;
}

static long dla_ctrl_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	struct dla_file *dla_file = file->private_data;
	long err;

	mutex_lock(&dla_file->lock);
	err = dla_locked_ioctl(dla_file, cmd, (void __user *)value);
	mutex_unlock(&dla_file->lock);
	return err;
}

static bool dla_file_idle(struct dla_file *file, u64 *finished)
{
	struct dla_queue *queue = file->queue;
	bool idle = true;

	*finished = 0;
	if (queue) {
		spin_lock_bh(&queue->dla->lock);
		*finished = queue->finished;
		idle = list_empty(&queue->tasks) && queue->dla->running != queue;
		spin_unlock_bh(&queue->dla->lock);
	}
	return idle;
}

static __poll_t dla_ctrl_poll(struct file *file, struct poll_table_struct *table)
{
	struct dla_file *dla_file = file->private_data;
	bool ready;
	u64 finished;

	mutex_lock(&dla_file->lock);
	poll_wait(file, &dla_file->done, table);
	ready = dla_file_idle(dla_file, &finished);
	mutex_unlock(&dla_file->lock);
	return ready ? EPOLLIN | EPOLLRDNORM : 0;
}

static ssize_t dla_ctrl_read(struct file *file, char __user *to, size_t size, loff_t *at)
{
	struct dla_file *dla_file = file->private_data;
	u64 finished;

	if (size < sizeof(finished))
		return -EINVAL;
	mutex_lock(&dla_file->lock);
	dla_file_idle(dla_file, &finished);
	mutex_unlock(&dla_file->lock);
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
	mutex_init(&dla_file->lock);
	init_waitqueue_head(&dla_file->done);
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

static const struct file_operations dla_ctrl_fops = { .owner = THIS_MODULE,
						      .open = dla_ctrl_open,
						      .release = dla_ctrl_release,
						      .unlocked_ioctl = dla_ctrl_ioctl,
						      .compat_ioctl = dla_ctrl_ioctl,
						      .poll = dla_ctrl_poll,
						      .read = dla_ctrl_read,
						      XAUTO_NO_LLSEEK };

static char *dla_devnode(XAUTO_DEVNODE_CONST struct device *dev, umode_t *mode)
{
	if (mode)
		*mode = 0666;
	return kasprintf(GFP_KERNEL, "nvhost-ctrl-nvdla%u", MINOR(dev->devt));
}

static int dla_state_show(struct seq_file *out, void *data)
{
	struct dla_queue *queue;
	int i;

	for (i = 0; i < N_DLAS; i++) {
		struct dla *dla = &dla_engines[i];

		spin_lock_bh(&dla->lock);
		seq_printf(out, "dla=%d busy=%d powered=%d\n", i, dla->busy,
			   pm_runtime_active(&dla->pdev->dev));
		list_for_each_entry(queue, &dla->queues, node)
			seq_printf(out, "queue suspended=%d running=%d waiting=%u finished=%llu\n",
				   queue->suspended, dla->running == queue, queue->waiting,
				   queue->finished);
		spin_unlock_bh(&dla->lock);
	}
	return 0;
}
DEFINE_SHOW_ATTRIBUTE(dla_state);

static int dla_runtime_pm(struct device *dev)
{
	return 0; /* a queue's state is the firmware's, which the driver restores */
}

static const struct dev_pm_ops dla_pm_ops = {
	SET_RUNTIME_PM_OPS(dla_runtime_pm, dla_runtime_pm, NULL)
};

static struct platform_driver dla_driver = {
	.driver = {
		.name = "xauto-nvdla",
		.owner = THIS_MODULE,
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
	spin_lock_init(&dla->lock);
	INIT_LIST_HEAD(&dla->queues);
	xauto_hrtimer_setup(&dla->end, dla_task_ends, HRTIMER_MODE_REL_SOFT);
	dla->pdev = platform_device_register_simple("xauto-nvdla", id, NULL, 0);
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
	cdev_init(&dla_node_cdev, &dla_ctrl_fops);
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
	int i, err = platform_driver_register(&dla_driver);

	if (err)
		return err;
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
