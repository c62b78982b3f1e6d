/* SPDX-License-Identifier: GPL-2.0-only */
#ifndef XAUTO_NETLINK_H
#define XAUTO_NETLINK_H

int xauto_netlink_init(void);
/* When it returns, no message is being handled and none will be. */
void xauto_netlink_exit(void);

#endif /* XAUTO_NETLINK_H */
