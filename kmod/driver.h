/* SPDX-License-Identifier: GPL-2.0-only */
/* Which driver made a file, and is it one that we know? */
#ifndef XAUTO_DRIVER_H
#define XAUTO_DRIVER_H

#include <linux/fs.h>
#include <linux/module.h>
#include <linux/string.h>

/*
 * @names: module names, separated by commas; "kernel" stands for a driver that is built in.
 * A file's operations name the module they live in; nobody can forge that.
 */
static inline bool xauto_file_is_of(const struct file *file, const char *names)
{
	const char *name = file->f_op->owner ? module_name(file->f_op->owner) : "kernel";
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

#endif /* XAUTO_DRIVER_H */
