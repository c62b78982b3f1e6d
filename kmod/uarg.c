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
#include <linux/uaccess.h>

#include "compat.h"
#include "uarg.h"

#define UARG_MAX 64
/* A driver may take long for one device; the others' calls then go through the other lanes. */
#define UARG_LANES 4

/**
 * struct xauto_uarg_lane - a thread and its part of the page
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

static struct xauto_uarg_lane xauto_uarg_lanes[UARG_LANES];
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
		lane->result =
			lane->file->f_op->unlocked_ioctl(lane->file, lane->cmd, lane->address);
		if ((_IOC_DIR(lane->cmd) & _IOC_READ) && copy_from_user(lane->arg, user, size))
			lane->result = -EFAULT;
	}
	kthread_unuse_mm(xauto_uarg_mm);
}

static struct xauto_uarg_lane *xauto_uarg_take_lane(void)
{
	struct xauto_uarg_lane *lane;
	int i;

	for (i = 0; i < UARG_LANES; i++)
		if (mutex_trylock(&xauto_uarg_lanes[i].busy))
			return &xauto_uarg_lanes[i];
	lane = &xauto_uarg_lanes[raw_smp_processor_id() % UARG_LANES];
	mutex_lock(&lane->busy);
	return lane;
}

long xauto_ioctl_arg(struct file *file, unsigned int cmd, void *arg)
{
	struct xauto_uarg_lane *lane;
	long result;

	if (WARN_ON_ONCE(_IOC_SIZE(cmd) > UARG_MAX) || !file->f_op->unlocked_ioctl)
		return -ENOTTY;
	lane = xauto_uarg_take_lane();
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
	if (!file->f_op->unlocked_ioctl)
		return -ENOTTY;
	return file->f_op->unlocked_ioctl(file, cmd, 0);
}

void xauto_uarg_exit(void)
{
	int i;

	for (i = 0; i < UARG_LANES; i++)
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

	for (i = 0; i < UARG_LANES; i++) {
		struct xauto_uarg_lane *lane = &xauto_uarg_lanes[i];

		mutex_init(&lane->busy);
		lane->address = xauto_uarg_page + i * UARG_MAX;
		kthread_init_work(&lane->work, xauto_uarg_call);
		lane->worker = kthread_create_worker(0, "xauto/ioctl%d", i);
		if (IS_ERR(lane->worker)) {
			int err = PTR_ERR(lane->worker);

			lane->worker = NULL;
			xauto_uarg_exit();
			return err;
		}
	}
	return 0;
}
