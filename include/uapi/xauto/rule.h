/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The rule: which of two jobs that want one XPU goes first. User space (lib/coord/rule.h, which
 * has the rest of it) and the sched_ext scheduler judge by the same lines. A claim is a struct of
 * any name with
 *
 *   key        64 bits, signed; the smaller is the more urgent
 *   since_ns   when the job asked for the XPU
 *   slot       makes the order total; nobody's choice
 */
#ifndef _UAPI_XAUTO_RULE_H
#define _UAPI_XAUTO_RULE_H

/* Claim a is before claim b, which is another one: the smaller key, then who asked first. */
#define XAUTO_RULE_BEFORE(a, b)                                      \
	((a).key != (b).key	      ? (a).key < (b).key :           \
	 (a).since_ns != (b).since_ns ? (a).since_ns < (b).since_ns : \
					(a).slot < (b).slot)

/* A job that comes takes the XPU from the one that has it: being as urgent is no reason. */
#define XAUTO_RULE_TAKES(comes, has) ((comes).key < (has).key)

#endif /* _UAPI_XAUTO_RULE_H */
