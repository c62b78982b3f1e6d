/* SPDX-License-Identifier: GPL-2.0-only */
#ifndef XAUTO_POWER_H
#define XAUTO_POWER_H

struct device;
struct file;

/* @devices: XAUTO_MAX_POWER entries, NULL where there is none. */
void xauto_power_find(const struct file *file, struct device **devices);
void xauto_power_forget(struct device **devices);

/* Powered until the matching put. 0 or a negative errno, and then nothing is held. May sleep. */
int xauto_power_get(struct device **devices);
void xauto_power_put(struct device **devices);

#endif /* XAUTO_POWER_H */
