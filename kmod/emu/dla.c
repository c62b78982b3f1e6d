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

static unsigned int command_us = 50;
module_param(command_us, uint, 0644);
MODULE_PARM_DESC(command_us, "the firmware's time for suspend or resume (default: 50)");

/* Faults, in debugfs: how many of the next calls fail. */
static u32 fail_suspend;
static u32 fail_resume;

struct task {
	struct list_head node;
	u64 duration_ns;
};

/**
 * struct queue - what ALLOC_QUEUE gave to a file
 * @dla: it belongs to
 * @node: in the DLA's list, moved to its end when its turn is over
 * @tasks: waiting, in order
 * @waiting: length of @tasks
 * @suspended: starts none
 * @submitted: number of the last
 * @finished: how many are done
 * @done: the file's, woken when one is
 */
struct queue {
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
	struct queue *running;
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
	struct queue *queue;
	wait_queue_head_t done;
};

static struct dla dlas[N_DLAS];
static struct class *node_class;
static struct cdev node_cdev;
static dev_t node_base;
static struct dentry *debug_dir;

/* The DLA is idle: whose turn is it? */
static void start_next(struct dla *dla)
{
	struct queue *queue;
	struct task *task;

	lockdep_assert_held(&dla->lock);
	list_for_each_entry(queue, &dla->queues, node) {
		if (queue->suspended || list_empty(&queue->tasks))
			continue;
		task = list_first_entry(&queue->tasks, struct task, node);
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

static enum hrtimer_restart task_ends(struct hrtimer *timer)
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
	start_next(dla);
	spin_unlock_bh(&dla->lock);
	return HRTIMER_NORESTART;
}

static long alloc_queue(struct dla_file *file)
{
	struct dla *dla = file->dla;
	struct queue *queue;

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

static long release_queue(struct dla_file *file)
{
	struct queue *queue = file->queue;
	struct task *task, *next;

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

static int submit_one(struct queue *queue, struct xauto_emu_work *work)
{
	struct dla *dla = queue->dla;
	struct task *task;
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
			start_next(dla);
	}
	spin_unlock_bh(&dla->lock);
	return err;
}

static long submit(struct queue *queue, void __user *arg)
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
			err = submit_one(queue, &work);
			if (!err && copy_to_user(&tasks[i], &work, sizeof(work)))
				err = -EFAULT;
		}
	}
	pm_runtime_mark_last_busy(dev);
	pm_runtime_put_autosuspend(dev);
	return err;
}

static long set_status(struct queue *queue, void __user *arg)
{
	struct device *dev = &queue->dla->pdev->dev;
	struct nvdla_set_queue_status_args args;
	bool suspend;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	suspend = args.status & NVDLA_SET_QUEUE_SUSPEND;
	if (suspend == !!(args.status & NVDLA_SET_QUEUE_RESUME))
		return -EINVAL;
	if (take_fault(suspend ? &fail_suspend : &fail_resume))
		return -ETIMEDOUT;
	pm_runtime_get_sync(dev);
	if (command_us)
		usleep_range(command_us, command_us + command_us / 8 + 1);
	spin_lock_bh(&queue->dla->lock);
	queue->suspended = suspend;
	if (!suspend && !queue->dla->busy)
		start_next(queue->dla);
	spin_unlock_bh(&queue->dla->lock);
	pm_runtime_mark_last_busy(dev);
	pm_runtime_put_autosuspend(dev);
	return 0;
}

static long ping(void __user *arg)
{
	struct nvdla_ping_args args;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	args.out_response = args.in_challenge * 4; /* nvdla's firmware answers so */
	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long firmware_version(void __user *arg)
{
	struct nvdla_get_fw_ver_args args = { .version = FIRMWARE_VERSION };

	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long locked_ioctl(struct dla_file *file, unsigned int cmd, void __user *arg)
{
	switch (cmd) {
	case NVDLA_IOCTL_PING:
		return ping(arg);
	case NVDLA_IOCTL_GET_FIRMWARE_VERSION:
		return firmware_version(arg);
	case NVDLA_IOCTL_ALLOC_QUEUE:
		return alloc_queue(file);
	case NVDLA_IOCTL_RELEASE_QUEUE:
		return release_queue(file);
	}
	if (!file->queue)
		return -EINVAL;
	switch (cmd) {
	case NVDLA_IOCTL_EMU_TASK_SUBMIT:
		return submit(file->queue, arg);
	case NVDLA_IOCTL_SET_QUEUE_STATUS:
		return set_status(file->queue, arg);
	}
	return -ENOTTY;
}

static long ctrl_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	struct dla_file *dla_file = file->private_data;
	long err;

	mutex_lock(&dla_file->lock);
	err = locked_ioctl(dla_file, cmd, (void __user *)value);
	mutex_unlock(&dla_file->lock);
	return err;
}

static bool idle(struct dla_file *file, u64 *finished)
{
	struct queue *queue = file->queue;
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

static __poll_t ctrl_poll(struct file *file, struct poll_table_struct *table)
{
	struct dla_file *dla_file = file->private_data;
	bool ready;
	u64 finished;

	mutex_lock(&dla_file->lock);
	poll_wait(file, &dla_file->done, table);
	ready = idle(dla_file, &finished);
	mutex_unlock(&dla_file->lock);
	return ready ? EPOLLIN | EPOLLRDNORM : 0;
}

static ssize_t ctrl_read(struct file *file, char __user *to, size_t size, loff_t *at)
{
	struct dla_file *dla_file = file->private_data;
	u64 finished;

	if (size < sizeof(finished))
		return -EINVAL;
	mutex_lock(&dla_file->lock);
	idle(dla_file, &finished);
	mutex_unlock(&dla_file->lock);
	return copy_to_user(to, &finished, sizeof(finished)) ? -EFAULT : sizeof(finished);
}

static int ctrl_open(struct inode *inode, struct file *file)
{
	struct dla_file *dla_file;

	if (iminor(inode) >= N_DLAS)
		return -ENXIO;
	dla_file = kzalloc(sizeof(*dla_file), GFP_KERNEL);
	if (!dla_file)
		return -ENOMEM;
	dla_file->dla = &dlas[iminor(inode)];
	mutex_init(&dla_file->lock);
	init_waitqueue_head(&dla_file->done);
	file->private_data = dla_file;
	return 0;
}

static int ctrl_release(struct inode *inode, struct file *file)
{
	struct dla_file *dla_file = file->private_data;

	release_queue(dla_file);
	kfree(dla_file);
	return 0;
}

static const struct file_operations ctrl_fops = {
	.owner = THIS_MODULE,
	.open = ctrl_open,
	.release = ctrl_release,
	.unlocked_ioctl = ctrl_ioctl,
	.compat_ioctl = ctrl_ioctl,
	.poll = ctrl_poll,
	.read = ctrl_read,
	XAUTO_NO_LLSEEK
};

static char *devnode(XAUTO_DEVNODE_CONST struct device *dev, umode_t *mode)
{
	if (mode)
		*mode = 0666;
	return kasprintf(GFP_KERNEL, "nvhost-ctrl-nvdla%u", MINOR(dev->devt));
}

static int state_show(struct seq_file *out, void *data)
{
	struct queue *queue;
	int i;

	for (i = 0; i < N_DLAS; i++) {
		struct dla *dla = &dlas[i];

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
DEFINE_SHOW_ATTRIBUTE(state);

static int dla_runtime_pm(struct device *dev)
{
	return 0; /* a queue's state is the firmware's, which the driver restores */
}

static const struct dev_pm_ops dla_pm_ops = {
	SET_RUNTIME_PM_OPS(dla_runtime_pm, dla_runtime_pm, NULL)
};

static struct platform_driver driver = {
	.driver = {
		.name = "xauto-nvdla",
		.owner = THIS_MODULE,
		.pm = &dla_pm_ops,
	},
};

static void remove_dla(struct dla *dla)
{
	hrtimer_cancel(&dla->end);
	pm_runtime_disable(&dla->pdev->dev);
	pm_runtime_dont_use_autosuspend(&dla->pdev->dev);
	platform_device_unregister(dla->pdev);
}

static int add_dla(struct dla *dla, int id)
{
	spin_lock_init(&dla->lock);
	INIT_LIST_HEAD(&dla->queues);
	xauto_hrtimer_setup(&dla->end, task_ends, HRTIMER_MODE_REL_SOFT);
	dla->pdev = platform_device_register_simple("xauto-nvdla", id, NULL, 0);
	if (IS_ERR(dla->pdev))
		return PTR_ERR(dla->pdev);
	pm_runtime_set_autosuspend_delay(&dla->pdev->dev, 50);
	pm_runtime_use_autosuspend(&dla->pdev->dev);
	pm_runtime_enable(&dla->pdev->dev);
	return 0;
}

static void remove_nodes(int count)
{
	while (count-- > 0)
		device_destroy(node_class, node_base + count);
	class_destroy(node_class);
	cdev_del(&node_cdev);
	unregister_chrdev_region(node_base, N_DLAS);
}

static int create_nodes(void)
{
	int i, err;

	err = alloc_chrdev_region(&node_base, 0, N_DLAS, "nvhost-nvdla");
	if (err)
		return err;
	cdev_init(&node_cdev, &ctrl_fops);
	node_cdev.owner = THIS_MODULE;
	err = cdev_add(&node_cdev, node_base, N_DLAS);
	if (err)
		goto err_region;
	node_class = xauto_class_create("nvdla-emu");
	if (IS_ERR(node_class)) {
		err = PTR_ERR(node_class);
		goto err_cdev;
	}
	node_class->devnode = devnode;
	for (i = 0; i < N_DLAS; i++) {
		struct device *dev = device_create(node_class, &dlas[i].pdev->dev, node_base + i,
						   NULL, "ctrl-nvdla%d", i);

		if (IS_ERR(dev)) {
			remove_nodes(i);
			return PTR_ERR(dev);
		}
	}
	return 0;

err_cdev:
	cdev_del(&node_cdev);
err_region:
	unregister_chrdev_region(node_base, N_DLAS);
	return err;
}

static int __init dla_emu_init(void)
{
	int i, err = platform_driver_register(&driver);

	if (err)
		return err;
	for (i = 0; i < N_DLAS; i++) {
		err = add_dla(&dlas[i], i);
		if (err)
			goto err_dlas;
	}
	err = create_nodes();
	if (err)
		goto err_dlas;
	debug_dir = debugfs_create_dir("xauto_nvdla_emu", NULL);
	debugfs_create_file("state", 0444, debug_dir, NULL, &state_fops);
	debugfs_create_u32("fail_suspend", 0644, debug_dir, &fail_suspend);
	debugfs_create_u32("fail_resume", 0644, debug_dir, &fail_resume);
	return 0;

err_dlas:
	while (i-- > 0)
		remove_dla(&dlas[i]);
	platform_driver_unregister(&driver);
	return err;
}

static void __exit dla_emu_exit(void)
{
	int i;

	debugfs_remove_recursive(debug_dir);
	remove_nodes(N_DLAS);
	for (i = 0; i < N_DLAS; i++)
		remove_dla(&dlas[i]);
	platform_driver_unregister(&driver);
}

module_init(dla_emu_init);
module_exit(dla_emu_exit);

MODULE_DESCRIPTION("nvdla's interface without a DLA, for tests");
MODULE_AUTHOR("The XAuto authors");
MODULE_LICENSE("GPL");
