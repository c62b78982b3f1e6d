// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto.ko's generic-netlink family as its header tells it (include/uapi/xauto/netlink.h): a client that is
 * written from that file alone, over the emulated drivers. What they do with a queue is read in debugfs.
 */
#include <errno.h>
#include <fcntl.h>
#include <linux/genetlink.h>
#include <linux/netlink.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "kselftest_harness.h"
#include "uapi/xauto/netlink.h"
#include "uapi/xauto/nvgpu.h"

struct message {
	struct nlmsghdr nl;
	struct genlmsghdr genl;
	char attrs[1024];
};

static void begin(struct message *m, int family, int cmd)
{
	memset(m, 0, sizeof(*m));
	m->nl.nlmsg_len = NLMSG_LENGTH(GENL_HDRLEN);
	m->nl.nlmsg_type = family;
	m->nl.nlmsg_flags = NLM_F_REQUEST | NLM_F_ACK;
	m->genl.cmd = cmd;
	m->genl.version = XAUTO_FAMILY_VERSION;
}

static struct nlattr *put(struct message *m, int type, const void *data, int size)
{
	struct nlattr *attr = (void *)m + NLMSG_ALIGN(m->nl.nlmsg_len);

	attr->nla_type = type;
	attr->nla_len = NLA_HDRLEN + size;
	if (size)
		memcpy((char *)attr + NLA_HDRLEN, data, size);
	m->nl.nlmsg_len = NLMSG_ALIGN(m->nl.nlmsg_len) + NLA_ALIGN(attr->nla_len);
	return attr;
}

static struct nlattr *put_u32(struct message *m, int type, __u32 value)
{
	return put(m, type, &value, sizeof(value));
}

static void end_nest(struct message *m, struct nlattr *nest)
{
	nest->nla_type |= NLA_F_NESTED;
	nest->nla_len = (char *)m + m->nl.nlmsg_len - (char *)nest;
}

/* Sends, and returns the acknowledgment's errno; of a reply before it the attribute @wanted, u16 or u32. */
static int talk(int sock, struct message *m, int wanted, __u32 *value)
{
	static char buffer[8192];

	if (send(sock, m, m->nl.nlmsg_len, 0) < 0)
		return errno;
	for (;;) {
		int left = recv(sock, buffer, sizeof(buffer), 0);
		struct nlmsghdr *nl = (void *)buffer;

		if (left < 0)
			return errno;
		for (; NLMSG_OK(nl, left); nl = NLMSG_NEXT(nl, left)) {
			char *at = (char *)NLMSG_DATA(nl) + GENL_HDRLEN;

			if (nl->nlmsg_type == NLMSG_ERROR)
				return -((struct nlmsgerr *)NLMSG_DATA(nl))->error;
			while (value && at + NLA_HDRLEN <= (char *)nl + nl->nlmsg_len) {
				struct nlattr *attr = (void *)at;
				int size = attr->nla_len - NLA_HDRLEN;

				if (size < 0)
					break;
				if (attr->nla_type == wanted)
					memcpy(value, at + NLA_HDRLEN, size < 4 ? size : 4);
				at += NLA_ALIGN(attr->nla_len);
			}
		}
	}
}

static int family_of(int sock, const char *name)
{
	struct message m;
	__u32 id = 0;

	begin(&m, GENL_ID_CTRL, CTRL_CMD_GETFAMILY);
	m.genl.version = 1;
	put(&m, CTRL_ATTR_FAMILY_NAME, name, strlen(name) + 1);
	return talk(sock, &m, CTRL_ATTR_FAMILY_ID, &id) ? -1 : (int)id;
}

static int netlink(void)
{
	struct timeval limit = { .tv_sec = 10 };
	int sock = socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_GENERIC);

	setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof(limit));
	return sock;
}

/* How many TSGs the emulated GPU holds disabled. */
static int disabled(void)
{
	static char text[65536];
	int fd = open("/sys/kernel/debug/xauto_nvgpu_emu/state", O_RDONLY), count = 0;
	ssize_t size = read(fd, text, sizeof(text) - 1);
	char *at = text;

	close(fd);
	text[size < 0 ? 0 : size] = '\0';
	for (; (at = strstr(at, "enabled=0")); at++)
		count++;
	return count;
}

/* An owner's socket may be closed some time before the driver has been called. */
static bool eventually_disabled(int count)
{
	for (int i = 0; i < 5000 && disabled() != count; i++)
		usleep(1000);
	return disabled() == count;
}

FIXTURE(queue)
{
	int sock, family, tsg, channel;
	__u32 handle;
};

static int act(FIXTURE_DATA(queue) *self, int action, __u32 handle)
{
	struct message m;
	struct nlattr *ops, *op;

	begin(&m, self->family, XAUTO_CMD_CONTROL);
	ops = put(&m, XAUTO_A_OPS, NULL, 0);
	op = put(&m, 1, NULL, 0);
	put_u32(&m, XAUTO_OP_ACTION, action);
	put_u32(&m, XAUTO_OP_HANDLE, handle);
	end_nest(&m, op);
	end_nest(&m, ops);
	return talk(self->sock, &m, 0, NULL);
}

static int enter(FIXTURE_DATA(queue) *self, int type, int fd)
{
	struct message m;

	begin(&m, self->family, XAUTO_CMD_REGISTER);
	put_u32(&m, XAUTO_A_TYPE, type);
	put(&m, XAUTO_A_FD, &fd, sizeof(fd));
	return talk(self->sock, &m, XAUTO_A_HANDLE, &self->handle);
}

FIXTURE_SETUP(queue)
{
	struct nvgpu_gpu_open_tsg_args args = {};
	struct nvgpu_gpu_open_channel_args channel = { .in.runlist_id = -1 };
	int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR | O_CLOEXEC);

	self->sock = netlink();
	self->family = family_of(self->sock, XAUTO_FAMILY_NAME);
	ASSERT_LE(0, ctrl);
	if (ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_TSG, &args))
		ASSERT_EQ(0, ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_TSG_R35, &args));
	self->tsg = args.tsg_fd;
	ASSERT_EQ(0, ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_CHANNEL, &channel));
	close(ctrl);
	self->channel = channel.out.channel_fd;
	ASSERT_EQ(0, ioctl(self->tsg, NVGPU_TSG_IOCTL_BIND_CHANNEL, &self->channel));
	ASSERT_EQ(0, enter(self, XAUTO_QUEUE_GPU_TSG, self->tsg));
	ASSERT_NE(0U, self->handle);
	ASSERT_TRUE(eventually_disabled(0));
}

FIXTURE_TEARDOWN(queue)
{
	close(self->sock);
	close(self->channel);
	close(self->tsg);
}

TEST_F(queue, a_suspended_one_is_disabled_until_it_is_resumed)
{
	ASSERT_EQ(0, act(self, XAUTO_ACTION_SUSPEND, self->handle));
	EXPECT_EQ(1, disabled());
	EXPECT_EQ(0, act(self, XAUTO_ACTION_SUSPEND, self->handle));
	ASSERT_EQ(0, act(self, XAUTO_ACTION_RESUME, self->handle));
	EXPECT_EQ(0, disabled());
}

TEST_F(queue, registered_again_it_has_its_handle)
{
	__u32 first = self->handle;

	ASSERT_EQ(0, enter(self, XAUTO_QUEUE_GPU_TSG, self->tsg));
	EXPECT_EQ(first, self->handle);
}

TEST_F(queue, refusals_have_the_errors_that_the_header_names)
{
	struct message m;

	EXPECT_EQ(ENOENT, act(self, XAUTO_ACTION_SUSPEND, self->handle + 100));
	EXPECT_EQ(EBADF, enter(self, XAUTO_QUEUE_GPU_TSG, 999));
	EXPECT_EQ(EINVAL, enter(self, XAUTO_QUEUE_DLA, self->tsg));
	EXPECT_EQ(ERANGE, act(self, 99, self->handle));
	begin(&m, self->family, XAUTO_CMD_REGISTER);
	EXPECT_EQ(EINVAL, talk(self->sock, &m, 0, NULL));
	begin(&m, self->family, XAUTO_CMD_WATCHDOG);
	put_u32(&m, XAUTO_A_TIMEOUT_MS, XAUTO_WATCHDOG_MAX_MS + 1);
	EXPECT_EQ(ERANGE, talk(self->sock, &m, 0, NULL));
}

TEST_F(queue, what_an_owner_suspended_runs_when_its_socket_closes)
{
	ASSERT_EQ(0, act(self, XAUTO_ACTION_SUSPEND, self->handle));
	ASSERT_EQ(1, disabled());
	close(self->sock);
	self->sock = -1;
	EXPECT_TRUE(eventually_disabled(0));
}

TEST_F(queue, what_an_owner_suspended_runs_when_it_is_not_fed)
{
	struct message m;

	begin(&m, self->family, XAUTO_CMD_WATCHDOG);
	put_u32(&m, XAUTO_A_TIMEOUT_MS, XAUTO_WATCHDOG_MIN_MS);
	ASSERT_EQ(0, talk(self->sock, &m, 0, NULL));
	ASSERT_EQ(0, act(self, XAUTO_ACTION_SUSPEND, self->handle));
	ASSERT_TRUE(eventually_disabled(0));
	begin(&m, self->family, XAUTO_CMD_WATCHDOG);
	EXPECT_EQ(ETIMEDOUT, talk(self->sock, &m, 0, NULL));
}

int main(int argc, char **argv)
{
	int sock = netlink(), family = family_of(sock, XAUTO_FAMILY_NAME);

	close(sock);
	if (family < 0 || access("/sys/kernel/debug/xauto_nvgpu_emu", X_OK))
		ksft_exit_skip("xauto.ko or the emulated nvgpu is not loaded\n");
	return test_harness_run(argc, argv);
}
