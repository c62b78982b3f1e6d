/* SPDX-License-Identifier: GPL-2.0-only */
/* Which driver made a file, and is it one that we know? Asked before any of its ioctls. */
#ifndef XAUTO_DRIVER_H
#define XAUTO_DRIVER_H

#include <linux/dcache.h>
#include <linux/fs.h>
#include <linux/kernel.h>
#include <linux/magic.h>
#include <linux/module.h>
#include <linux/string.h>

/* @names: separated by commas. */
static inline bool xauto_names_have(const char *names, const char *name)
{
	size_t length = strlen(name);
	const char *at = names;

	while (at) {
		if (!strncmp(at, name, length) && (at[length] == ',' || !at[length]))
			return true;
		at = strchr(at, ',');
		if (at)
			at++;
	}
	return false;
}

/*
 * @names: of modules; "kernel" stands for a driver that is built in. A file's operations name the
 * module they live in; nobody can forge that.
 */
static inline bool xauto_file_is_of(const struct file *file, const char *names)
{
	struct module *owner = file->f_op->owner;

	return xauto_names_have(names, owner ? module_name(owner) : "kernel");
}

/*
 * The name of the file, for a device node or an anonymous file; empty for any other, since those
 * names are anybody's choice. "kernel" is the owner of a thousand kinds of files, and an ioctl's
 * number means something else to each.
 */
static inline void xauto_file_name(const struct file *file, char *name, size_t size)
{
	struct dentry *dentry = file->f_path.dentry;

	name[0] = 0;
	if (!S_ISCHR(file_inode(file)->i_mode) && dentry->d_sb->s_magic != ANON_INODE_FS_MAGIC)
		return;
	spin_lock(&dentry->d_lock); /* against a rename */
	strscpy(name, dentry->d_name.name, size);
	spin_unlock(&dentry->d_lock);
}

/* Is it @prefix, and then nothing but a number? */
static inline bool xauto_is_numbered(const char *name, const char *prefix)
{
	unsigned int number;

	return !strncmp(name, prefix, strlen(prefix)) &&
	       !kstrtouint(name + strlen(prefix), 10, &number);
}

#endif /* XAUTO_DRIVER_H */
