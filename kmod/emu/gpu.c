// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto_nvgpu_emu.ko: nvgpu's device nodes and ioctls, with their numbers and structures, over an
 * emulated engine (gpu_engine.h). Work is given as a duration (include/uapi/xauto/emu.h).
 */
#include <linux/anon_inodes.h>
#include <linux/cdev.h>
#include <linux/debugfs.h>
#include <linux/device.h>
#include <linux/file.h>
#include <linux/fs.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/pm_runtime.h>
#include <linux/poll.h>
#include <linux/seq_file.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include <uapi/xauto/emu.h>
#include <uapi/xauto/nvgpu.h>

#include "compat.h"
#include "fault.h"
#include "gpu_engine.h"

static char *gpu_release = "r36";
module_param_named(release, gpu_release, charp, 0444);
MODULE_PARM_DESC(release, "whose nvgpu this is: r35 or r36 (default: r36)");

/* Faults, in debugfs: how many of the next calls fail. */
static u32 gpu_fail_preempt; /* the context does not leave: EBUSY, as late as nvgpu says it */
static u32 gpu_fail_enable; /* ENABLE meets a GPU that does not power on */

enum { NODE_CTRL, NODE_TSG, NODE_CHANNEL, NODE_SCHED, N_NODES };

/* Both hierarchies exist at once. */
static const char *const gpu_node_names[2 * N_NODES] = {
	"nvgpu/igpu0/ctrl", "nvgpu/igpu0/tsg", "nvgpu/igpu0/channel", "nvgpu/igpu0/sched",
	"nvhost-ctrl-gpu",  "nvhost-tsg-gpu",  "nvhost-gpu",	      "nvhost-sched-gpu",
};

static struct gpu gpu_emu;
static struct platform_device *gpu_pdev;
static struct class *gpu_node_class;
static struct cdev gpu_node_cdev;
static dev_t gpu_node_base;
static struct dentry *gpu_debug_dir;

static bool gpu_is_r36(void)
{
	return strcmp(gpu_release, "r35") != 0;
}

/*
 * nvgpu's order of refusals: what cannot be of this file is EINVAL, a number that is unknown in its
 * range is the caller's, ENOTTY.
 */
static bool gpu_cmd_is_foreign(unsigned int cmd, unsigned int magic, unsigned int last,
			       unsigned int max_size)
{
	return _IOC_TYPE(cmd) != magic || !_IOC_NR(cmd) || _IOC_NR(cmd) > last ||
	       _IOC_SIZE(cmd) > max_size;
}

/* nvgpu's gk20a_busy() and gk20a_idle(). Power that comes back enables every channel. */
static int gpu_busy(bool fail)
{
	if (fail)
		return -ENODEV;
	pm_runtime_get_sync(&gpu_pdev->dev);
	return 0;
}

static void gpu_idle(void)
{
	pm_runtime_mark_last_busy(&gpu_pdev->dev);
	pm_runtime_put_autosuspend(&gpu_pdev->dev);
}

static int gpu_tsg_file_release(struct inode *inode, struct file *file)
{
	gpu_tsg_put(file->private_data);
	return 0;
}

static const struct file_operations gpu_channel_fops;

static long gpu_tsg_bind_channel(struct gpu_tsg *tsg, void __user *arg, bool bind)
{
	struct file *file;
	long err = -EINVAL;
	int fd;

	if (copy_from_user(&fd, arg, sizeof(fd)))
		return -EFAULT;
	file = fget(fd);
	if (!file)
		return -EBADF;
	/*
	 * A channel is another file of ours; the "channel" node has them as well as OPEN_CHANNEL.
	 */
	if (file->f_op == &gpu_channel_fops)
		err = bind ? gpu_channel_bind(tsg, file->private_data, gpu_is_r36()) :
			     gpu_channel_unbind(tsg, file->private_data);
	fput(file);
	return err;
}

/* Those that need the GPU powered, which may be what enables the TSG. */
static long gpu_tsg_switch(struct gpu_tsg *tsg, unsigned int cmd)
{
	long err = gpu_busy(cmd == NVGPU_IOCTL_TSG_ENABLE &&
			    xauto_emu_take_fault(&gpu_fail_enable));

	if (err)
		return err;
	if (cmd == NVGPU_IOCTL_TSG_ENABLE)
		gpu_tsg_enable(tsg);
	else if (cmd == NVGPU_IOCTL_TSG_DISABLE)
		gpu_tsg_disable(tsg);
	else
		err = gpu_tsg_preempt(tsg, xauto_emu_take_fault(&gpu_fail_preempt));
	gpu_idle();
	return err;
}

static long gpu_tsg_get_share_token(struct gpu_tsg *tsg, void __user *arg)
{
	struct nvgpu_tsg_get_share_token_args args;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	if (!args.source_device_instance_id || !args.target_device_instance_id)
		return -EINVAL;
	args.share_token = gpu_tsg_token(tsg);
	return copy_to_user(arg, &args, sizeof(args)) ? -EFAULT : 0;
}

static long gpu_tsg_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	void __user *arg = (void __user *)value;
	struct nvgpu_runlist_interleave_args interleave;
	struct nvgpu_timeslice_args slice = {};
	struct gpu_tsg *tsg = file->private_data;

	if (gpu_cmd_is_foreign(cmd, NVGPU_TSG_IOCTL_MAGIC, gpu_is_r36() ? 21 : 17, 24))
		return -EINVAL;
	switch (cmd) {
	case NVGPU_TSG_IOCTL_BIND_CHANNEL:
		return gpu_tsg_bind_channel(tsg, arg, true);
	case NVGPU_TSG_IOCTL_UNBIND_CHANNEL:
		return gpu_tsg_bind_channel(tsg, arg, false);
	case NVGPU_IOCTL_TSG_ENABLE:
	case NVGPU_IOCTL_TSG_DISABLE:
	case NVGPU_IOCTL_TSG_PREEMPT:
		return gpu_tsg_switch(tsg, cmd);
	case NVGPU_IOCTL_TSG_SET_RUNLIST_INTERLEAVE:
		if (copy_from_user(&interleave, arg, sizeof(interleave)))
			return -EFAULT;
		return gpu_tsg_set_level(tsg, interleave.level);
	case NVGPU_IOCTL_TSG_SET_TIMESLICE:
		if (copy_from_user(&slice, arg, sizeof(slice)))
			return -EFAULT;
		return gpu_tsg_set_timeslice(tsg, slice.timeslice_us);
	case NVGPU_IOCTL_TSG_GET_TIMESLICE:
		slice.timeslice_us = READ_ONCE(tsg->timeslice_us);
		return copy_to_user(arg, &slice, sizeof(slice)) ? -EFAULT : 0;
	case NVGPU_TSG_IOCTL_GET_SHARE_TOKEN:
		if (gpu_is_r36())
			return gpu_tsg_get_share_token(tsg, arg);
		break;
	}
	return -ENOTTY;
}

static const struct file_operations gpu_tsg_fops = { .owner = THIS_MODULE,
						     .release = gpu_tsg_file_release,
						     .unlocked_ioctl = gpu_tsg_ioctl,
						     .compat_ioctl = gpu_tsg_ioctl,
						     XAUTO_NO_LLSEEK };

static int gpu_channel_file_release(struct inode *inode, struct file *file)
{
	gpu_channel_close(file->private_data);
	return 0;
}

static long gpu_channel_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	void __user *arg = (void __user *)value;
	struct xauto_emu_work work;
	long err;

	if (cmd == NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE)
		return gpu_channel_touch(file->private_data);
	if (cmd != XAUTO_EMU_IOCTL_SUBMIT)
		return -ENOTTY;
	if (copy_from_user(&work, arg, sizeof(work)))
		return -EFAULT;
	if (!work.duration_ns || work.duration_ns > XAUTO_EMU_MAX_DURATION_NS)
		return -EINVAL;
	err = gpu_channel_submit(file->private_data, work.duration_ns, &work.sequence);
	if (err)
		return err;
	return copy_to_user(arg, &work, sizeof(work)) ? -EFAULT : 0;
}

static __poll_t gpu_channel_poll(struct file *file, struct poll_table_struct *table)
{
	struct gpu_channel *channel = file->private_data;
	u64 finished;

	poll_wait(file, &channel->done, table);
	return gpu_channel_idle(channel, &finished) ? EPOLLIN | EPOLLRDNORM : 0;
}

static ssize_t gpu_channel_read(struct file *file, char __user *to, size_t size, loff_t *at)
{
	struct gpu_channel *channel = file->private_data;
	u64 finished;

	if (size < sizeof(finished))
		return -EINVAL;
	gpu_channel_idle(channel, &finished);
	return copy_to_user(to, &finished, sizeof(finished)) ? -EFAULT : sizeof(finished);
}

static const struct file_operations gpu_channel_fops = { .owner = THIS_MODULE,
							 .release = gpu_channel_file_release,
							 .unlocked_ioctl = gpu_channel_ioctl,
							 .compat_ioctl = gpu_channel_ioctl,
							 .poll = gpu_channel_poll,
							 .read = gpu_channel_read,
							 XAUTO_NO_LLSEEK };

/* What r36 asks beside r35's flags, which may be anything there. */
static struct gpu_tsg *gpu_open_or_share(const struct nvgpu_gpu_open_tsg_args *args)
{
	bool shared = args->flags & NVGPU_GPU_IOCTL_OPEN_TSG_FLAGS_SHARE;
	struct gpu_tsg *tsg;

	if (shared != !!args->source_device_instance_id || shared != !!args->share_token)
		return ERR_PTR(-EINVAL);
	if (!shared)
		return gpu_tsg_new(&gpu_emu);
	tsg = gpu_tsg_share(&gpu_emu, args->share_token);
	return tsg ?: ERR_PTR(-EINVAL);
}

/* @size: of the release's struct; the first field is the same in both. */
static long gpu_ctrl_open_tsg(void __user *arg, size_t size)
{
	struct nvgpu_gpu_open_tsg_args args = {};
	struct gpu_tsg *tsg;
	struct file *file;
	char name[32];
	int fd;

	if (copy_from_user(&args, arg, size))
		return -EFAULT;
	tsg = gpu_is_r36() ? gpu_open_or_share(&args) : gpu_tsg_new(&gpu_emu);
	if (IS_ERR(tsg))
		return PTR_ERR(tsg);
	fd = get_unused_fd_flags(O_CLOEXEC);
	if (fd < 0) {
		gpu_tsg_put(tsg);
		return fd;
	}
	snprintf(name, sizeof(name), "nvgpu-ga10b-tsg%d", fd);
	file = anon_inode_getfile(name, &gpu_tsg_fops, tsg, O_RDWR | O_CLOEXEC);
	if (IS_ERR(file)) {
		put_unused_fd(fd);
		gpu_tsg_put(tsg);
		return PTR_ERR(file);
	}
	args.tsg_fd = fd;
	if (copy_to_user(arg, &args, size)) {
		put_unused_fd(fd);
		fput(file);
		return -EFAULT;
	}
	fd_install(fd, file);
	return 0;
}

static long gpu_ctrl_open_channel(void __user *arg)
{
	struct nvgpu_gpu_open_channel_args args;
	struct gpu_channel *channel;
	struct file *file;
	char name[32];
	int fd;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	if (args.in.runlist_id < -1 || args.in.runlist_id >= GPU_ENGINES)
		return -EINVAL;
	channel = gpu_channel_new(&gpu_emu, max(args.in.runlist_id, 0));
	if (!channel)
		return -ENOMEM;
	fd = get_unused_fd_flags(O_CLOEXEC);
	if (fd < 0) {
		gpu_channel_close(channel);
		return fd;
	}
	snprintf(name, sizeof(name), "nvhost-ga10b-fd%d", fd);
	file = anon_inode_getfile(name, &gpu_channel_fops, channel, O_RDWR | O_CLOEXEC);
	if (IS_ERR(file)) {
		put_unused_fd(fd);
		gpu_channel_close(channel);
		return PTR_ERR(file);
	}
	args.out.channel_fd = fd;
	if (copy_to_user(arg, &args, sizeof(args))) {
		put_unused_fd(fd);
		fput(file);
		return -EFAULT;
	}
	fd_install(fd, file);
	return 0;
}

static long gpu_ctrl_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	switch (cmd) {
	case NVGPU_GPU_IOCTL_OPEN_TSG:
		if (!gpu_is_r36())
			break;
		return gpu_ctrl_open_tsg((void __user *)value,
					 sizeof(struct nvgpu_gpu_open_tsg_args));
	case NVGPU_GPU_IOCTL_OPEN_TSG_R35:
		if (gpu_is_r36())
			break;
		return gpu_ctrl_open_tsg((void __user *)value,
					 sizeof(struct nvgpu_gpu_open_tsg_args_r35));
	case NVGPU_GPU_IOCTL_OPEN_CHANNEL:
		return gpu_ctrl_open_channel((void __user *)value);
	}
	return -ENOTTY;
}

static const struct file_operations gpu_ctrl_fops = { .owner = THIS_MODULE,
						      .unlocked_ioctl = gpu_ctrl_ioctl,
						      .compat_ioctl = gpu_ctrl_ioctl,
						      XAUTO_NO_LLSEEK };

/* Bit n of a bitmap: TSG n. The size is told, too, where the caller's is too small. */
static long gpu_sched_tell(const unsigned long *ids, __u32 *size, __u64 buffer)
{
	u64 words[GPU_MAX_TSGS / 64] = {};
	unsigned int id;

	if (*size < sizeof(words) || !buffer) {
		*size = sizeof(words);
		return -ENOSPC;
	}
	for_each_set_bit(id, ids, GPU_MAX_TSGS)
		words[id / 64] |= BIT_ULL(id % 64);
	return copy_to_user(u64_to_user_ptr(buffer), words, sizeof(words)) ? -EFAULT : 0;
}

static long gpu_sched_ioctl(struct file *file, unsigned int cmd, unsigned long value)
{
	struct nvgpu_sched_get_tsgs_by_pid_args by_pid;
	void __user *arg = (void __user *)value;
	struct nvgpu_sched_get_tsgs_args all;
	DECLARE_BITMAP(ids, GPU_MAX_TSGS);
	long err;

	if (gpu_cmd_is_foreign(cmd, NVGPU_SCHED_IOCTL_MAGIC, 11, 32))
		return -EINVAL;
	switch (cmd) {
	case NVGPU_SCHED_IOCTL_GET_TSGS:
		if (copy_from_user(&all, arg, sizeof(all)))
			return -EFAULT;
		gpu_tsgs_of(&gpu_emu, 0, ids);
		err = gpu_sched_tell(ids, &all.size, all.buffer);
		if ((!err || err == -ENOSPC) && copy_to_user(arg, &all, sizeof(all)))
			return -EFAULT;
		return err;
	case NVGPU_SCHED_IOCTL_GET_TSGS_BY_PID:
		if (copy_from_user(&by_pid, arg, sizeof(by_pid)))
			return -EFAULT;
		/* The driver compares with what it noted, whatever namespace the caller is in. */
		gpu_tsgs_of(&gpu_emu, (pid_t)by_pid.pid ?: -1, ids);
		err = gpu_sched_tell(ids, &by_pid.size, by_pid.buffer);
		if ((!err || err == -ENOSPC) && copy_to_user(arg, &by_pid, sizeof(by_pid)))
			return -EFAULT;
		return err;
	}
	return -ENOTTY;
}

static unsigned long gpu_sched_busy; /* bit 0: somebody has it open */

static int gpu_sched_release(struct inode *inode, struct file *file)
{
	clear_bit_unlock(0, &gpu_sched_busy);
	return 0;
}

static const struct file_operations gpu_sched_fops = { .owner = THIS_MODULE,
						       .release = gpu_sched_release,
						       .unlocked_ioctl = gpu_sched_ioctl,
						       .compat_ioctl = gpu_sched_ioctl,
						       XAUTO_NO_LLSEEK };

/* The node decides what the file is. */
static int gpu_node_open(struct inode *inode, struct file *file)
{
	void *made;

	switch (iminor(inode) % N_NODES) {
	case NODE_CTRL:
		replace_fops(file, fops_get(&gpu_ctrl_fops));
		return 0;
	case NODE_TSG:
		made = gpu_tsg_new(&gpu_emu);
		if (IS_ERR(made))
			return PTR_ERR(made);
		file->private_data = made;
		replace_fops(file, fops_get(&gpu_tsg_fops));
		return 0;
	case NODE_CHANNEL:
		made = gpu_channel_new(&gpu_emu, 0);
		if (!made)
			return -ENOMEM;
		file->private_data = made;
		replace_fops(file, fops_get(&gpu_channel_fops));
		return 0;
	case NODE_SCHED:
		if (test_and_set_bit_lock(0, &gpu_sched_busy))
			return -EBUSY;
		replace_fops(file, fops_get(&gpu_sched_fops));
		return 0;
	}
	return -ENXIO;
}

static const struct file_operations gpu_node_fops = {
	.owner = THIS_MODULE,
	.open = gpu_node_open,
};

static char *gpu_devnode(XAUTO_DEVNODE_CONST struct device *dev, umode_t *mode)
{
	if (mode)
		*mode = 0666;
	return kstrdup(gpu_node_names[MINOR(dev->devt)], GFP_KERNEL);
}

static int gpu_create_nodes(void)
{
	int i, err;

	err = alloc_chrdev_region(&gpu_node_base, 0, 2 * N_NODES, "nvgpu");
	if (err)
		return err;
	cdev_init(&gpu_node_cdev, &gpu_node_fops);
	gpu_node_cdev.owner = THIS_MODULE;
	err = cdev_add(&gpu_node_cdev, gpu_node_base, 2 * N_NODES);
	if (err)
		goto err_region;
	gpu_node_class = xauto_class_create("nvgpu-emu");
	if (IS_ERR(gpu_node_class)) {
		err = PTR_ERR(gpu_node_class);
		goto err_cdev;
	}
	gpu_node_class->devnode = gpu_devnode;
	for (i = 0; i < 2 * N_NODES; i++) {
		struct device *dev = device_create(gpu_node_class, &gpu_pdev->dev,
						   gpu_node_base + i, NULL, "nvgpu-emu%d",
						   i);

		if (IS_ERR(dev)) {
			err = PTR_ERR(dev);
			goto err_nodes;
		}
	}
	return 0;

err_nodes:
	while (i-- > 0)
		device_destroy(gpu_node_class, gpu_node_base + i);
	class_destroy(gpu_node_class);
err_cdev:
	cdev_del(&gpu_node_cdev);
err_region:
	unregister_chrdev_region(gpu_node_base, 2 * N_NODES);
	return err;
}

static void gpu_remove_nodes(void)
{
	int i;

	for (i = 0; i < 2 * N_NODES; i++)
		device_destroy(gpu_node_class, gpu_node_base + i);
	class_destroy(gpu_node_class);
	cdev_del(&gpu_node_cdev);
	unregister_chrdev_region(gpu_node_base, 2 * N_NODES);
}

static int gpu_state_show(struct seq_file *out, void *data)
{
	gpu_show(&gpu_emu, out);
	seq_printf(out, "powered=%d\n", pm_runtime_active(&gpu_pdev->dev));
	return 0;
}
DEFINE_SHOW_ATTRIBUTE(gpu_state);

static int gpu_runtime_suspend(struct device *dev)
{
	gpu_power_off(&gpu_emu);
	return 0;
}

static int gpu_runtime_resume(struct device *dev)
{
	gpu_power_on(&gpu_emu);
	return 0;
}

/* A system sleep asks nobody's reference; afterwards it is as after any power-on. */
static int __maybe_unused gpu_system_suspend(struct device *dev)
{
	return pm_runtime_force_suspend(dev);
}

static int __maybe_unused gpu_system_resume(struct device *dev)
{
	return pm_runtime_force_resume(dev);
}

static const struct dev_pm_ops gpu_pm_ops = {
	SET_RUNTIME_PM_OPS(gpu_runtime_suspend, gpu_runtime_resume, NULL)
	SET_SYSTEM_SLEEP_PM_OPS(gpu_system_suspend, gpu_system_resume)
};

static struct platform_driver gpu_driver = {
	.driver = {
		.name = "xauto-gk20a",
		.owner = THIS_MODULE,
		.pm = &gpu_pm_ops,
	},
};

static int __init gpu_emu_init(void)
{
	int err;

	if (strcmp(gpu_release, "r35") && strcmp(gpu_release, "r36"))
		return -EINVAL;
	err = platform_driver_register(&gpu_driver);
	if (err)
		return err;
	gpu_pdev = platform_device_register_simple("xauto-gk20a", PLATFORM_DEVID_NONE, NULL, 0);
	if (IS_ERR(gpu_pdev)) {
		err = PTR_ERR(gpu_pdev);
		goto err_driver;
	}
	gpu_init(&gpu_emu, &gpu_pdev->dev);
	/* Rail gating, quicker than on the board so that tests meet it. */
	pm_runtime_set_autosuspend_delay(&gpu_pdev->dev, 50);
	pm_runtime_use_autosuspend(&gpu_pdev->dev);
	pm_runtime_enable(&gpu_pdev->dev);
	err = gpu_create_nodes();
	if (err)
		goto err_device;
	gpu_debug_dir = debugfs_create_dir("xauto_nvgpu_emu", NULL);
	debugfs_create_file("state", 0444, gpu_debug_dir, NULL, &gpu_state_fops);
	debugfs_create_u32("fail_preempt", 0644, gpu_debug_dir, &gpu_fail_preempt);
	debugfs_create_u32("fail_enable", 0644, gpu_debug_dir, &gpu_fail_enable);
	return 0;

err_device:
	pm_runtime_disable(&gpu_pdev->dev);
	pm_runtime_dont_use_autosuspend(&gpu_pdev->dev);
	platform_device_unregister(gpu_pdev);
err_driver:
	platform_driver_unregister(&gpu_driver);
	return err;
}

static void __exit gpu_emu_exit(void)
{
	debugfs_remove_recursive(gpu_debug_dir);
	gpu_remove_nodes();
	gpu_stop(&gpu_emu);
	pm_runtime_disable(&gpu_pdev->dev);
	pm_runtime_dont_use_autosuspend(&gpu_pdev->dev);
	platform_device_unregister(gpu_pdev);
	platform_driver_unregister(&gpu_driver);
}

module_init(gpu_emu_init);
module_exit(gpu_emu_exit);

MODULE_DESCRIPTION("nvgpu's interface without a GPU, for tests");
MODULE_AUTHOR("The XAuto authors");
MODULE_LICENSE("GPL");
