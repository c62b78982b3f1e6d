// SPDX-License-Identifier: GPL-2.0-only
/*
 * Calling a driver's ioctl from the kernel.
 *
 * DOC: an address space for arguments
 *
 * A driver reads an ioctl's argument with copy_from_user(), and since set_fs() went there is no
 * way to hand it kernel memory. The fail-safe paths need such ioctls (a DLA queue's resume takes a
 * struct) at moments when the owner's process is dead and its memory gone, so the memory must be
 * ours and must outlive every client.
 *
 * So the module maps one page in the address space of the process that loads it and keeps that
 * address space (not the process) alive. Our kernel threads enter it for the time of one call.
 * Once the loader has exited, nobody but us is in there, and what it had mapped beside our page is
 * given back. What stays pinned until the module unloads is that page, its page tables and the
 * loader's executable.
 *
 * Rejected: memory of the caller (it can unmap or rewrite it while the driver reads, and it is
 * gone when it is needed most); memory of the queue's process (the same); the drivers' internal
 * functions (not exported, and another set in each release).
 */
#include <linux/fs.h>
#include <linux/kthread.h>
#include <linux/mm.h>
#include <linux/mman.h>
#include <linux/mutex.h>
#include <linux/sched/mm.h>
#include <linux/sched/signal.h>
#include <linux/security.h>
#include <linux/uaccess.h>

#include "compat.h"
#include "device.h"
#include "uarg.h"

#define UARG_MAX 64 /* of an argument, and of what is written beside it */

/**
 * struct xauto_uarg_lane - a device's thread and its part of the page
 * @busy: held by the one whose call it is
 * @worker: the thread
 * @work: the call
 * @address: of this lane's bytes in the page
 * @file: the call's, as the next three: written before the work is queued, read after it was
 *   flushed
 * @cmd: the ioctl's number
 * @arg: kernel memory, in and out
 * @result: the driver's answer
 */
struct xauto_uarg_lane {
	struct mutex busy; /* one call at a time */
	struct kthread_worker *worker;
	struct kthread_work work;
	unsigned long address;
	struct file *file;
	unsigned int cmd;
	void *arg;
	long result;
};

static struct xauto_uarg_lane xauto_uarg_lanes[XAUTO_DEVICES]; /* by the device's index */
static struct mm_struct *xauto_uarg_mm;
static unsigned long xauto_uarg_page;
static bool xauto_uarg_alone; /* the loader's own mappings are gone; lane 0's thread only */

/* On lane 0's thread, inside the mm. Its last other user gone: drop everything but our page. */
static void xauto_uarg_trim(void)
{
	if (xauto_uarg_alone || atomic_read(&xauto_uarg_mm->mm_users) != 1)
		return;
	xauto_uarg_alone = true;
	vm_munmap(0, xauto_uarg_page);
	vm_munmap(xauto_uarg_page + PAGE_SIZE,
		  xauto_uarg_mm->task_size - xauto_uarg_page - PAGE_SIZE);
}

/* As the kernel's vfs_ioctl(), which newer kernels do not export. */
static long xauto_vfs_ioctl(struct file *file, unsigned int cmd, unsigned long arg)
{
	long err = file->f_op->unlocked_ioctl ? file->f_op->unlocked_ioctl(file, cmd, arg) :
						-ENOIOCTLCMD;

	switch (err) {
	case -ENOIOCTLCMD:
		return -ENOTTY;
	case -ENODEV:
		return -EIO;
	}
	return err;
}

static void xauto_uarg_call(struct kthread_work *work)
{
	struct xauto_uarg_lane *lane = container_of(work, struct xauto_uarg_lane, work);
	void __user *user = (void __user *)lane->address;
	size_t size = _IOC_SIZE(lane->cmd);

	kthread_use_mm(xauto_uarg_mm);
	if (lane == &xauto_uarg_lanes[0])
		xauto_uarg_trim();
	if (copy_to_user(user, lane->arg, size)) {
		lane->result = -EFAULT;
	} else {
		lane->result = xauto_vfs_ioctl(lane->file, lane->cmd, lane->address);
		if ((_IOC_DIR(lane->cmd) & _IOC_READ) && copy_from_user(lane->arg, user, size))
			lane->result = -EFAULT;
	}
	kthread_unuse_mm(xauto_uarg_mm);
}

long xauto_ioctl_arg(struct xauto_device *device, struct file *file, unsigned int cmd, void *arg,
		     u64 *scratch)
{
	struct xauto_uarg_lane *lane = &xauto_uarg_lanes[device->index];
	long result;

	if (WARN_ON_ONCE(_IOC_SIZE(cmd) > UARG_MAX))
		return -ENOTTY;
	/* Here, since this is who asks; the lane's thread is the kernel. */
	result = security_file_ioctl(file, cmd, lane->address);
	if (result)
		return result;
	if (mutex_lock_killable(&lane->busy))
		return -EINTR;
	if (scratch)
		*scratch = lane->address + UARG_MAX;
	lane->file = file;
	lane->cmd = cmd;
	lane->arg = arg;
	kthread_queue_work(lane->worker, &lane->work);
	kthread_flush_work(&lane->work);
	result = lane->result;
	mutex_unlock(&lane->busy);
	return result;
}

long xauto_ioctl(struct file *file, unsigned int cmd)
{
	int err = security_file_ioctl(file, cmd, 0);

	return err ? err : xauto_vfs_ioctl(file, cmd, 0);
}

void xauto_uarg_exit(void)
{
	int i;

	for (i = 0; i < XAUTO_DEVICES; i++)
		if (xauto_uarg_lanes[i].worker)
			kthread_destroy_worker(xauto_uarg_lanes[i].worker);
	mmput(xauto_uarg_mm);
}

int xauto_uarg_init(void)
{
	int i;

	if (!current->mm)
		return -ENODEV; /* built into the kernel: there is no loader */
	xauto_uarg_page =
		vm_mmap(NULL, 0, PAGE_SIZE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, 0);
	if (IS_ERR_VALUE(xauto_uarg_page))
		return (int)xauto_uarg_page;
	xauto_uarg_mm = current->mm;
	mmget(xauto_uarg_mm);

	for (i = 0; i < XAUTO_DEVICES; i++) {
		struct xauto_uarg_lane *lane = &xauto_uarg_lanes[i];

		mutex_init(&lane->busy);
		lane->address = xauto_uarg_page + i * 2 * UARG_MAX;
		kthread_init_work(&lane->work, xauto_uarg_call);
		lane->worker = xauto_kthread_run_worker(0, "xauto/ioctl%d", i);
		if (IS_ERR(lane->worker)) {
			int err = PTR_ERR(lane->worker);

			lane->worker = NULL;
			xauto_uarg_exit();
			return err;
		}
	}
	return 0;
}
