// SPDX-License-Identifier: GPL-2.0-only
/*
 * The door: policies, parsing, permission, replies. Touches no hardware. The ABI and its rules are
 * in include/uapi/xauto/netlink.h.
 */
#include <linux/cred.h>
#include <linux/file.h>
#include <linux/pid.h>
#include <linux/sched.h>
#include <net/genetlink.h>
#include <net/net_namespace.h>

#include <uapi/xauto/netlink.h>

#include "compat.h"
#include "event.h"
#include "netlink.h"
#include "owner.h"
#include "queue.h"

static struct genl_family xauto_family;

static const struct nla_policy xauto_op_policy[XAUTO_OP_MAX + 1] = {
	[XAUTO_OP_ACTION] =
		NLA_POLICY_RANGE(NLA_U32, XAUTO_ACTION_SUSPEND, XAUTO_ACTION_SET_INTERLEAVE),
	[XAUTO_OP_HANDLE] = NLA_POLICY_MIN(NLA_U32, 1),
	[XAUTO_OP_VALUE] = { .type = NLA_U32 },
};

static const struct nla_policy xauto_register_policy[XAUTO_A_MAX + 1] = {
	[XAUTO_A_TYPE] = NLA_POLICY_RANGE(NLA_U32, XAUTO_QUEUE_GPU_TSG, XAUTO_QUEUE_DLA),
	[XAUTO_A_FD] = NLA_POLICY_MIN(NLA_S32, 0),
	[XAUTO_A_PID] = NLA_POLICY_MIN(NLA_U32, 1),
};

static const struct nla_policy xauto_handle_policy[XAUTO_A_MAX + 1] = {
	[XAUTO_A_HANDLE] = NLA_POLICY_MIN(NLA_U32, 1),
};

static const struct nla_policy xauto_control_policy[XAUTO_A_MAX + 1] = {
	[XAUTO_A_OPS] = NLA_POLICY_NESTED_ARRAY(xauto_op_policy),
};

static XAUTO_RANGE_CONST struct netlink_range_validation xauto_watchdog_range = {
	.max = XAUTO_WATCHDOG_MAX_MS, /* the short form ends at 32767 */
};

static const struct nla_policy xauto_watchdog_policy[XAUTO_A_MAX + 1] = {
	[XAUTO_A_TIMEOUT_MS] = NLA_POLICY_FULL_RANGE(NLA_U32, &xauto_watchdog_range),
};

/*
 * @skb: the caller's message. Who sends it needs the capability; who opened the socket does, too,
 * unless the message has an address (sendto(2)), for which netlink asks the sender alone.
 */
static bool xauto_may_touch(struct sk_buff *skb, const struct cred *opener)
{
	return uid_eq(current_euid(), opener->euid) ||
	       netlink_ns_capable(skb, opener->user_ns, CAP_SYS_NICE);
}

/* Is this attribute there? If not, says so; the text must be constant, hence no function. */
#define xauto_has_attr(info, attr)                           \
	((info)->attrs[attr] ? true : ({                     \
		GENL_SET_ERR_MSG(info, #attr " is missing"); \
		false;                                       \
	}))

/*
 * Whose queue it is: the caller's, or that of the process named, if it is the opener's or the
 * caller may touch it anyway.
 */
static struct pid *xauto_target_pid(struct sk_buff *skb, struct genl_info *info,
				    const struct cred *opener)
{
	struct nlattr *attr = info->attrs[XAUTO_A_PID];
	struct task_struct *task;
	struct pid *pid;
	kuid_t uid = INVALID_UID;

	if (!attr)
		return get_pid(task_tgid(current));
	pid = find_get_pid(nla_get_u32(attr));
	rcu_read_lock();
	task = pid ? pid_task(pid, PIDTYPE_TGID) : NULL;
	if (task)
		uid = task_euid(task);
	rcu_read_unlock();
	if (!task) {
		put_pid(pid);
		NL_SET_ERR_MSG_ATTR(info->extack, attr, "there is no such process");
		return ERR_PTR(-ESRCH);
	}
	if (!uid_eq(uid, opener->euid) && !netlink_ns_capable(skb, opener->user_ns, CAP_SYS_NICE)) {
		put_pid(pid);
		NL_SET_ERR_MSG_ATTR(info->extack, attr,
				    "that process is not the user's who opened the queue");
		return ERR_PTR(-EPERM);
	}
	return pid;
}

static int xauto_reply_registered(struct genl_info *info, u32 handle, u32 id)
{
	struct sk_buff *msg = genlmsg_new(NLMSG_DEFAULT_SIZE, GFP_KERNEL);
	void *header;

	if (!msg)
		return -ENOMEM;
	header = genlmsg_put_reply(msg, info, &xauto_family, 0, XAUTO_CMD_REGISTER);
	if (!header || nla_put_u32(msg, XAUTO_A_HANDLE, handle) ||
	    nla_put_u32(msg, XAUTO_A_QUEUE, id)) {
		nlmsg_free(msg);
		return -EMSGSIZE;
	}
	genlmsg_end(msg, header);
	return genlmsg_reply(msg, info);
}

static int xauto_claim_file(struct sk_buff *skb, struct genl_info *info, struct file *file)
{
	struct xauto_owner *owner;
	struct xauto_queue *queue;
	u32 handle = 0, id;
	struct pid *pid;
	int err;

	if (!xauto_may_touch(skb, file->f_cred)) {
		NL_SET_ERR_MSG_ATTR(
			info->extack, info->attrs[XAUTO_A_FD],
			"another user opened it: CAP_SYS_NICE in that user's namespace is needed");
		return -EPERM;
	}
	pid = xauto_target_pid(skb, info, file->f_cred);
	if (IS_ERR(pid))
		return PTR_ERR(pid);
	queue = xauto_queue_get(nla_get_u32(info->attrs[XAUTO_A_TYPE]), file, pid, info->extack);
	put_pid(pid);
	if (IS_ERR(queue)) {
		NL_SET_BAD_ATTR(info->extack, info->attrs[XAUTO_A_FD]);
		return PTR_ERR(queue);
	}
	id = queue->id;
	owner = xauto_owner_get(skb, info->extack);
	if (IS_ERR(owner)) {
		xauto_queue_put(queue);
		return PTR_ERR(owner);
	}
	err = xauto_owner_claim(owner, queue, &handle, info->extack);
	if (!err) {
		err = xauto_reply_registered(info, handle, id);
		if (err)
			xauto_owner_unclaim(owner, handle);
	}
	xauto_owner_put(owner);
	return err;
}

static int xauto_cmd_register(struct sk_buff *skb, struct genl_info *info)
{
	struct file *file;
	int err;

	if (!xauto_has_attr(info, XAUTO_A_TYPE))
		return -EINVAL;
	if (!xauto_has_attr(info, XAUTO_A_FD))
		return -EINVAL;
	file = fget(nla_get_s32(info->attrs[XAUTO_A_FD]));
	if (!file) {
		NL_SET_ERR_MSG_ATTR(info->extack, info->attrs[XAUTO_A_FD],
				    "no such file descriptor in the calling process");
		return -EBADF;
	}
	err = xauto_claim_file(skb, info, file);
	fput(file);
	return err;
}

static struct xauto_owner *xauto_caller(struct sk_buff *skb, struct genl_info *info)
{
	struct xauto_owner *owner = xauto_owner_find(skb);

	if (!owner)
		GENL_SET_ERR_MSG(info, "nothing is registered on this socket");
	return owner;
}

static int xauto_cmd_unregister(struct sk_buff *skb, struct genl_info *info)
{
	struct xauto_owner *owner;
	int err;

	if (!xauto_has_attr(info, XAUTO_A_HANDLE))
		return -EINVAL;
	owner = xauto_caller(skb, info);
	if (!owner)
		return -ENOENT;
	err = xauto_owner_unclaim(owner, nla_get_u32(info->attrs[XAUTO_A_HANDLE]));
	if (err == -ENOENT)
		NL_SET_ERR_MSG_ATTR(info->extack, info->attrs[XAUTO_A_HANDLE],
				    "no such handle on this socket");
	else if (err == -EINTR)
		NL_SET_ERR_MSG(info->extack, "interrupted; the module goes on");
	else if (err)
		NL_SET_ERR_MSG(
			info->extack,
			"unregistered, but the driver did not resume it; the module tries again");
	xauto_owner_put(owner);
	return err;
}

/* The acknowledgment's text must be constant, so it is a ladder and no table. */
static void xauto_explain(struct netlink_ext_ack *extack, struct nlattr *at, u32 action, int err)
{
	if (err == -ENOENT)
		NL_SET_ERR_MSG(extack, "no such handle on this socket");
	else if (err == -ENODEV)
		NL_SET_ERR_MSG(extack, "the queue's process is gone");
	else if (err == -EOPNOTSUPP)
		NL_SET_ERR_MSG(extack, "a DLA queue has neither time slice nor interleave level");
	else if (err == -EINTR)
		NL_SET_ERR_MSG(extack, "interrupted");
	else if (err == -ENODATA)
		NL_SET_ERR_MSG(extack, "its process has released the DLA queue");
	else if (action == XAUTO_ACTION_SUSPEND && err == -EBUSY)
		NL_SET_ERR_MSG(extack,
			       "not tried: this context did not leave the engine in time before");
	else if (action == XAUTO_ACTION_RESUME)
		NL_SET_ERR_MSG(extack, "the driver did not resume it; the module tries again");
	else if (action == XAUTO_ACTION_SUSPEND && err == -ETIMEDOUT)
		NL_SET_ERR_MSG(
			extack,
			"not off the engine in time, or the watchdog bit meanwhile: it runs again");
	else if (action == XAUTO_ACTION_SET_TIMESLICE && err == -EINVAL)
		NL_SET_ERR_MSG(extack,
			       "the driver refused this time slice (nvgpu: 1000..50000 us)");
	else if (action == XAUTO_ACTION_SET_INTERLEAVE && err == -EINVAL)
		NL_SET_ERR_MSG(extack, "the driver refused this interleave level (nvgpu: 0..2)");
	else if (err == -EPERM)
		NL_SET_ERR_MSG(extack,
			       "the driver refused: another program holds its scheduling controls");
	else
		NL_SET_ERR_MSG(extack, "the driver refused; the error is its answer");
	NL_SET_BAD_ATTR(extack, at);
}

static int xauto_do_op(struct genl_info *info, struct xauto_owner *owner, struct nlattr *nest,
		       struct sk_buff *reply)
{
	struct nlattr *tb[XAUTO_OP_MAX + 1], *result;
	u32 action, handle, value = 0;
	u64 cost;
	int err;

	err = nla_parse_nested(tb, XAUTO_OP_MAX, nest, xauto_op_policy, info->extack);
	if (err)
		return err;
	if (!tb[XAUTO_OP_ACTION] || !tb[XAUTO_OP_HANDLE]) {
		NL_SET_ERR_MSG_ATTR(info->extack, nest,
				    "an operation needs XAUTO_OP_ACTION and XAUTO_OP_HANDLE");
		return -EINVAL;
	}
	action = nla_get_u32(tb[XAUTO_OP_ACTION]);
	handle = nla_get_u32(tb[XAUTO_OP_HANDLE]);
	if (action == XAUTO_ACTION_SET_TIMESLICE || action == XAUTO_ACTION_SET_INTERLEAVE) {
		if (!tb[XAUTO_OP_VALUE]) {
			NL_SET_ERR_MSG_ATTR(info->extack, nest,
					    "this operation needs XAUTO_OP_VALUE");
			return -EINVAL;
		}
		value = nla_get_u32(tb[XAUTO_OP_VALUE]);
	}
	err = xauto_owner_act(owner, action, handle, value, &cost);
	if (err) {
		xauto_explain(info->extack, nest, action, err);
		return err;
	}
	if (!reply)
		return 0;
	result = nla_nest_start(reply, 1);
	if (!result || nla_put_u32(reply, XAUTO_A_HANDLE, handle) ||
	    nla_put_u64_64bit(reply, XAUTO_A_COST_NS, cost, XAUTO_A_PAD))
		return -EMSGSIZE;
	nla_nest_end(reply, result);
	return 0;
}

static int xauto_count_ops(struct nlattr *ops)
{
	struct nlattr *nest;
	int rest, count = 0;

	nla_for_each_nested(nest, ops, rest)
		count++;
	return count;
}

static int xauto_do_ops(struct genl_info *info, struct xauto_owner *owner, struct sk_buff *reply)
{
	struct nlattr *nest, *results = NULL;
	int rest, err;

	if (reply) {
		results = nla_nest_start(reply, XAUTO_A_RESULTS);
		if (!results)
			return -EMSGSIZE;
	}
	nla_for_each_nested(nest, info->attrs[XAUTO_A_OPS], rest) {
		err = xauto_do_op(info, owner, nest, reply);
		if (err)
			return err;
	}
	if (results)
		nla_nest_end(reply, results);
	return 0;
}

static int xauto_cmd_control(struct sk_buff *skb, struct genl_info *info)
{
	struct xauto_owner *owner;
	struct sk_buff *reply = NULL;
	void *header = NULL;
	int count, err;

	if (!xauto_has_attr(info, XAUTO_A_OPS))
		return -EINVAL;
	count = xauto_count_ops(info->attrs[XAUTO_A_OPS]);
	if (!count || count > XAUTO_MAX_OPS) {
		NL_SET_ERR_MSG_ATTR(info->extack, info->attrs[XAUTO_A_OPS],
				    "a message holds 1 to 64 operations");
		return -EINVAL;
	}
	owner = xauto_caller(skb, info);
	if (!owner)
		return -ENOENT;
	/*
	 * Before anything is done, since what is done is not undone. 24 bytes of payload and two
	 * headers an operation.
	 */
	if (info->nlhdr->nlmsg_flags & NLM_F_ECHO) {
		err = -ENOMEM;
		reply = genlmsg_new(nla_total_size(count * 40), GFP_KERNEL);
		if (!reply)
			goto out;
		header = genlmsg_put_reply(reply, info, &xauto_family, 0, XAUTO_CMD_CONTROL);
		if (!header)
			goto out;
	}
	err = xauto_do_ops(info, owner, reply);
	if (!err && reply) {
		genlmsg_end(reply, header);
		err = genlmsg_reply(reply, info);
		reply = NULL;
	}
out:
	nlmsg_free(reply);
	xauto_owner_put(owner);
	return err;
}

static int xauto_cmd_watchdog(struct sk_buff *skb, struct genl_info *info)
{
	struct nlattr *attr = info->attrs[XAUTO_A_TIMEOUT_MS];
	struct xauto_owner *owner;
	int err = 0;
	u32 ms;

	owner = xauto_caller(skb, info); /* which feeds it */
	if (!owner)
		return -ENOENT;
	if (attr) {
		ms = nla_get_u32(attr);
		if (ms && ms < XAUTO_WATCHDOG_MIN_MS) {
			NL_SET_ERR_MSG_ATTR(info->extack, attr,
					    "a watchdog is 10 to 60000 ms, or 0 for none");
			err = -EINVAL;
		} else if (!ms && !netlink_ns_capable(skb, &init_user_ns, CAP_SYS_NICE)) {
			NL_SET_ERR_MSG_ATTR(info->extack, attr,
					    "going without a watchdog needs CAP_SYS_NICE");
			err = -EPERM;
		} else {
			xauto_owner_set_watchdog(owner, ms);
		}
	}
	if (!err && xauto_owner_expired(owner)) {
		NL_SET_ERR_MSG(
			info->extack,
			"the watchdog had expired: what this socket had suspended was resumed");
		err = -ETIMEDOUT;
	}
	xauto_owner_put(owner);
	return err;
}

static int xauto_fill_queue(struct sk_buff *msg, struct xauto_queue *queue,
			    struct xauto_owner *owner, bool ask_driver)
{
	struct xauto_queue_info q;
	u32 handle = owner ? xauto_owner_handle(owner, queue) : 0;

	xauto_queue_describe(queue, ask_driver, &q);
	if (nla_put_u32(msg, XAUTO_A_QUEUE, q.id) || nla_put_u32(msg, XAUTO_A_TYPE, q.type) ||
	    nla_put_u32(msg, XAUTO_A_PID, pid_vnr(queue->pid)) ||
	    nla_put_u8(msg, XAUTO_A_SUSPENDED, q.suspended) ||
	    nla_put_u32(msg, XAUTO_A_VOTES, q.votes) ||
	    nla_put_u64_64bit(msg, XAUTO_A_SUSPENDS, q.stats.suspends, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_RESUMES, q.stats.resumes, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_ERRORS, q.stats.errors, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_SUSPENDED_NS, q.stats.suspended_ns, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_COST_NS, q.stats.cost_ns, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_COST_MAX_NS, q.stats.cost_max_ns, XAUTO_A_PAD) ||
	    nla_put_u64_64bit(msg, XAUTO_A_ESCAPES, q.stats.escapes, XAUTO_A_PAD) ||
	    nla_put_u32(msg, XAUTO_A_STUCK_MS, q.stuck_ms) ||
	    nla_put_u8(msg, XAUTO_A_GATED, q.gated) ||
	    (q.timeslice_us && nla_put_u32(msg, XAUTO_A_TIMESLICE_US, q.timeslice_us)) ||
	    (handle && nla_put_u32(msg, XAUTO_A_HANDLE, handle)))
		return -EMSGSIZE;
	return 0;
}

static int xauto_cmd_get(struct sk_buff *skb, struct genl_info *info)
{
	struct xauto_queue *queue = NULL;
	struct xauto_owner *owner;
	struct sk_buff *msg;
	void *header;
	int err;

	if (!xauto_has_attr(info, XAUTO_A_HANDLE))
		return -EINVAL;
	owner = xauto_caller(skb, info);
	if (owner)
		queue = xauto_owner_queue(owner, nla_get_u32(info->attrs[XAUTO_A_HANDLE]));
	if (!queue) {
		if (owner) {
			NL_SET_ERR_MSG_ATTR(info->extack, info->attrs[XAUTO_A_HANDLE],
					    "no such handle on this socket");
			xauto_owner_put(owner);
		}
		return -ENOENT;
	}
	err = -ENOMEM;
	msg = genlmsg_new(NLMSG_DEFAULT_SIZE, GFP_KERNEL);
	if (!msg)
		goto out;
	err = -EMSGSIZE;
	header = genlmsg_put_reply(msg, info, &xauto_family, 0, XAUTO_CMD_GET);
	if (!header || xauto_fill_queue(msg, queue, owner, true)) {
		nlmsg_free(msg);
		goto out;
	}
	genlmsg_end(msg, header);
	err = genlmsg_reply(msg, info);
out:
	xauto_queue_put(queue);
	xauto_owner_put(owner);
	return err;
}

static int xauto_dump_queue(struct sk_buff *msg, struct netlink_callback *cb,
			    struct xauto_queue *queue)
{
	struct xauto_owner *owner;
	void *header;
	int err;

	if (!READ_ONCE(queue->file) || !xauto_may_touch(cb->skb, queue->cred))
		return 0;
	header = genlmsg_put(msg, NETLINK_CB(cb->skb).portid, cb->nlh->nlmsg_seq, &xauto_family,
			     NLM_F_MULTI, XAUTO_CMD_GET);
	if (!header)
		return -EMSGSIZE;
	genl_dump_check_consistent(cb, header);
	owner = xauto_owner_find(cb->skb);
	err = xauto_fill_queue(msg, queue, owner, false);
	if (owner)
		xauto_owner_put(owner);
	if (err)
		genlmsg_cancel(msg, header);
	else
		genlmsg_end(msg, header);
	return err;
}

/*
 * All parts are made with the rights of who asks. Who reads makes those after the first, and may be
 * a program of more rights that was given the socket.
 */
static int xauto_dump_start(struct netlink_callback *cb)
{
	cb->args[1] = (long)get_current_cred();
	return 0;
}

static int xauto_dump_done(struct netlink_callback *cb)
{
	put_cred((const struct cred *)cb->args[1]);
	return 0;
}

/* One part of the dump, from the queue where the last one ended; empty at the end. */
static int xauto_cmd_dump(struct sk_buff *msg, struct netlink_callback *cb)
{
	const struct cred *reader = override_creds((const struct cred *)cb->args[1]);
	unsigned long id = cb->args[0];
	struct xauto_queue *queue;
	int err = 0;

	/* Read before the queues are: what changes while they are read shows in the next part. */
	cb->seq = xauto_queue_generation();
	while (!err && (queue = xauto_queue_next(&id))) {
		err = xauto_dump_queue(msg, cb, queue);
		xauto_queue_put(queue);
		if (!err)
			id++;
	}
	cb->args[0] = id;
	revert_creds(reader);
	return msg->len;
}

static const struct genl_ops xauto_genl_ops[] = {
	{
		.cmd = XAUTO_CMD_REGISTER,
		.doit = xauto_cmd_register,
		.policy = xauto_register_policy,
		.maxattr = XAUTO_A_MAX,
	},
	{
		.cmd = XAUTO_CMD_UNREGISTER,
		.doit = xauto_cmd_unregister,
		.policy = xauto_handle_policy,
		.maxattr = XAUTO_A_MAX,
	},
	{
		.cmd = XAUTO_CMD_CONTROL,
		.doit = xauto_cmd_control,
		.policy = xauto_control_policy,
		.maxattr = XAUTO_A_MAX,
	},
	{
		.cmd = XAUTO_CMD_WATCHDOG,
		.doit = xauto_cmd_watchdog,
		.policy = xauto_watchdog_policy,
		.maxattr = XAUTO_A_MAX,
	},
	{
		.cmd = XAUTO_CMD_GET,
		.doit = xauto_cmd_get,
		.start = xauto_dump_start,
		.dumpit = xauto_cmd_dump,
		.done = xauto_dump_done,
		.policy = xauto_handle_policy,
		.maxattr = XAUTO_A_MAX,
	},
};

static const struct genl_multicast_group xauto_genl_groups[] = {
	{ .name = XAUTO_MCGRP_EVENTS, XAUTO_MCGRP_NEEDS_NET_ADMIN },
};

static struct genl_family xauto_family __ro_after_init = {
	.name = XAUTO_FAMILY_NAME,
	.version = XAUTO_FAMILY_VERSION,
	.maxattr = XAUTO_A_MAX,
	.module = THIS_MODULE,
	.ops = xauto_genl_ops,
	.n_ops = ARRAY_SIZE(xauto_genl_ops),
	.mcgrps = xauto_genl_groups,
	.n_mcgrps = XAUTO_MCGRP_IS_GUARDED ? ARRAY_SIZE(xauto_genl_groups) : 0,
	.parallel_ops = true, /* one coordinator does not wait for another's driver call */
	XAUTO_GENL_RESV_START_OP(XAUTO_CMD_GET + 1)
};

int xauto_netlink_init(void)
{
	int err = genl_register_family(&xauto_family);

	if (!err && xauto_family.n_mcgrps)
		xauto_event_publish_to(&xauto_family);
	return err;
}

void xauto_netlink_exit(void)
{
	xauto_event_publish_to(NULL);
	genl_unregister_family(&xauto_family);
}
