// SPDX-License-Identifier: Apache-2.0
#include "kernel/queue_control.h"

#include <array>
#include <cerrno>
#include <cstring>
#include <string>

#include <netlink/attr.h>
#include <netlink/errno.h>
#include <netlink/genl/ctrl.h>
#include <netlink/genl/genl.h>
#include <netlink/msg.h>
#include <netlink/socket.h>
#include <poll.h>
#include <sys/socket.h>

namespace xauto::kernel {
namespace {

using Attributes = std::array<nlattr*, XAUTO_A_MAX + 1>;

struct SocketFree {
  void operator()(nl_sock* socket) const { nl_socket_free(socket); }
};
struct MessageFree {
  void operator()(nl_msg* message) const { nlmsg_free(message); }
};
using NlSocket = std::unique_ptr<nl_sock, SocketFree>;
using NlMessage = std::unique_ptr<nl_msg, MessageFree>;

constexpr int kReplyTimeoutS = 10;  // a driver's own time-outs are shorter

ErrorCode code_of(int error) {
  switch (error) {
    case EPERM:
    case EACCES:
      return ErrorCode::kPermission;
    case ENOENT:
    case ESRCH:
      return ErrorCode::kNotFound;
    case EINVAL:
    case EBADF:
    case EOPNOTSUPP:
    case ERANGE:
      return ErrorCode::kInvalid;
    case ETIMEDOUT:
      return ErrorCode::kTimeout;
    case ENODEV:
    case EBUSY:
    case ENODATA:
    case ESHUTDOWN:
      return ErrorCode::kUnavailable;
    default:
      return ErrorCode::kIo;
  }
}

std::string hint_of(int error) {
  if (error == EPERM) return "run as the user who opened the queue, or with CAP_SYS_NICE";
  return {};
}

std::uint64_t u64_of(const Attributes& attributes, int type) {
  return attributes[static_cast<std::size_t>(type)] != nullptr
             ? nla_get_u64(attributes[static_cast<std::size_t>(type)])
             : 0;
}
std::uint32_t u32_of(const Attributes& attributes, int type) {
  return attributes[static_cast<std::size_t>(type)] != nullptr
             ? nla_get_u32(attributes[static_cast<std::size_t>(type)])
             : 0;
}

}  // namespace

struct QueueControl::Socket {
  NlSocket socket{nl_socket_alloc()};
  int family = -1;
  std::vector<QueueInfo> infos;
  std::vector<std::uint64_t> costs;
  RegisteredQueue registered;
  bool interrupted = false;  // the list changed while it was dumped
  int error = 0;
  std::string error_text;
  std::uint32_t error_offset = 0;

  [[nodiscard]] NlMessage message(std::uint8_t command, int flags = 0) const {
    NlMessage message(nlmsg_alloc());
    if (message)
      genlmsg_put(message.get(), NL_AUTO_PORT, NL_AUTO_SEQ, family, 0, flags, command,
                  XAUTO_FAMILY_VERSION);
    return message;
  }
  [[nodiscard]] Status exchange(nl_msg* message, const std::string& where);
  void take_reply(nlmsghdr* header);
  void take_error(const nlmsgerr& answer, const nlmsghdr& header);
};

void QueueControl::Socket::take_reply(nlmsghdr* header) {
  Attributes a{};
  if (genlmsg_parse(header, 0, a.data(), XAUTO_A_MAX, nullptr) < 0) return;
  const auto* generic = static_cast<const genlmsghdr*>(nlmsg_data(header));
  if (generic->cmd == XAUTO_CMD_REGISTER) {
    registered = {u32_of(a, XAUTO_A_HANDLE), u32_of(a, XAUTO_A_QUEUE)};
  } else if (generic->cmd == XAUTO_CMD_GET) {
    QueueInfo info;
    info.queue = u32_of(a, XAUTO_A_QUEUE);
    info.type = static_cast<QueueType>(u32_of(a, XAUTO_A_TYPE));
    info.pid = static_cast<pid_t>(u32_of(a, XAUTO_A_PID));
    info.handle = u32_of(a, XAUTO_A_HANDLE);
    info.suspended = a[XAUTO_A_SUSPENDED] != nullptr && nla_get_u8(a[XAUTO_A_SUSPENDED]) != 0;
    info.votes = u32_of(a, XAUTO_A_VOTES);
    info.timeslice_us = u32_of(a, XAUTO_A_TIMESLICE_US);
    info.suspends = u64_of(a, XAUTO_A_SUSPENDS);
    info.resumes = u64_of(a, XAUTO_A_RESUMES);
    info.errors = u64_of(a, XAUTO_A_ERRORS);
    info.suspended_ns = u64_of(a, XAUTO_A_SUSPENDED_NS);
    info.cost_ns = u64_of(a, XAUTO_A_COST_NS);
    info.cost_max_ns = u64_of(a, XAUTO_A_COST_MAX_NS);
    info.escapes = u64_of(a, XAUTO_A_ESCAPES);
    info.stuck_ms = u32_of(a, XAUTO_A_STUCK_MS);
    info.gated = a[XAUTO_A_GATED] != nullptr && nla_get_u8(a[XAUTO_A_GATED]) != 0;
    infos.push_back(info);
  } else if (generic->cmd == XAUTO_CMD_CONTROL && a[XAUTO_A_RESULTS] != nullptr) {
    nlattr* nest = nullptr;
    int rest = 0;
    nla_for_each_nested(nest, a[XAUTO_A_RESULTS], rest) {
      Attributes inner{};
      if (nla_parse_nested(inner.data(), XAUTO_A_MAX, nest, nullptr) == 0)
        costs.push_back(u64_of(inner, XAUTO_A_COST_NS));
    }
  }
}

void QueueControl::Socket::take_error(const nlmsgerr& answer, const nlmsghdr& header) {
  error = -answer.error;
  if ((header.nlmsg_flags & NLM_F_ACK_TLVS) == 0) return;
  // With NETLINK_CAP_ACK only the request's header is echoed; the attributes follow it.
  const std::size_t echoed =
      (header.nlmsg_flags & NLM_F_CAPPED) != 0 ? sizeof(nlmsghdr) : answer.msg.nlmsg_len;
  const std::size_t skip = NLMSG_HDRLEN + NLMSG_ALIGN(sizeof(int) + echoed);
  if (skip >= header.nlmsg_len) return;
  auto* first =
      reinterpret_cast<nlattr*>(const_cast<char*>(reinterpret_cast<const char*>(&header)) + skip);
  std::array<nlattr*, NLMSGERR_ATTR_MAX + 1> a{};
  nla_parse(a.data(), NLMSGERR_ATTR_MAX, first, static_cast<int>(header.nlmsg_len - skip), nullptr);
  if (a[NLMSGERR_ATTR_MSG] != nullptr) error_text = nla_get_string(a[NLMSGERR_ATTR_MSG]);
  if (a[NLMSGERR_ATTR_OFFS] != nullptr) error_offset = nla_get_u32(a[NLMSGERR_ATTR_OFFS]);
}

// One request, its replies and its acknowledgement.
Status QueueControl::Socket::exchange(nl_msg* message, const std::string& where) {
  error = 0;
  error_text.clear();
  error_offset = 0;
  interrupted = false;
  bool done = false;
  struct Context {
    Socket* self;
    bool* done;
  } context{this, &done};
  nl_socket_modify_cb(
      socket.get(), NL_CB_VALID, NL_CB_CUSTOM,
      [](nl_msg* reply, void* argument) -> int {
        static_cast<Context*>(argument)->self->take_reply(nlmsg_hdr(reply));
        return NL_OK;
      },
      &context);
  // Read on to the end, so that nothing of this dump is left for the next one.
  nl_socket_modify_cb(
      socket.get(), NL_CB_DUMP_INTR, NL_CB_CUSTOM,
      [](nl_msg*, void* argument) -> int {
        static_cast<Context*>(argument)->self->interrupted = true;
        return NL_OK;
      },
      &context);
  const auto finish = [](nl_msg*, void* argument) -> int {
    *static_cast<Context*>(argument)->done = true;
    return NL_STOP;
  };
  nl_socket_modify_cb(socket.get(), NL_CB_ACK, NL_CB_CUSTOM, finish, &context);
  nl_socket_modify_cb(socket.get(), NL_CB_FINISH, NL_CB_CUSTOM, finish, &context);
  nl_socket_modify_err_cb(
      socket.get(), NL_CB_CUSTOM,
      [](sockaddr_nl*, nlmsgerr* answer, void* argument) -> int {
        auto* c = static_cast<Context*>(argument);
        // libnl hands over the payload; its header lies right before it.
        const auto* header =
            reinterpret_cast<const nlmsghdr*>(reinterpret_cast<const char*>(answer) - NLMSG_HDRLEN);
        c->self->take_error(*answer, *header);
        *c->done = true;
        return NL_STOP;
      },
      &context);

  int status = nl_send_auto(socket.get(), message);
  while (status >= 0 && !done) {
    pollfd ready{nl_socket_get_fd(socket.get()), POLLIN, 0};
    const int polled = poll(&ready, 1, kReplyTimeoutS * 1000);
    if (polled == 0)
      return fail(ErrorCode::kTimeout, "the module did not answer within 10 s", where,
                  "the driver hangs: see dmesg");
    if (polled < 0 && errno == EINTR) continue;
    status = nl_recvmsgs_default(socket.get());
    if (error != 0) break;
  }
  if (error == 0 && status >= 0) return {};
  if (error == 0) return fail(ErrorCode::kIo, nl_geterror(status), where);
  return fail(code_of(error), error_text.empty() ? std::strerror(error) : error_text, where,
              hint_of(error));
}

QueueControl::QueueControl(std::unique_ptr<Socket> socket) : socket_(std::move(socket)) {}
QueueControl::QueueControl(QueueControl&&) noexcept = default;
QueueControl& QueueControl::operator=(QueueControl&&) noexcept = default;
QueueControl::~QueueControl() = default;

int QueueControl::descriptor() const {
  return nl_socket_get_fd(socket_->socket.get());
}
int QueueControl::family() const {
  return socket_->family;
}

Result<QueueControl> QueueControl::open() {
  auto own = std::make_unique<Socket>();
  nl_sock* socket = own->socket.get();
  if (socket == nullptr || genl_connect(socket) != 0)
    return fail(ErrorCode::kIo, "no generic netlink here", "xauto.ko");
  const int yes = 1;
  for (const int option : {NETLINK_EXT_ACK, NETLINK_CAP_ACK})
    (void)setsockopt(nl_socket_get_fd(socket), SOL_NETLINK, option, &yes, sizeof yes);
  own->family = genl_ctrl_resolve(socket, XAUTO_FAMILY_NAME);
  if (own->family < 0)
    return fail(ErrorCode::kUnavailable, "the kernel module is not loaded", "xauto.ko",
                "as root: modprobe xauto");
  return QueueControl(std::move(own));
}

Result<RegisteredQueue> QueueControl::register_queue(QueueType type, int fd, pid_t pid) {
  const NlMessage message = socket_->message(XAUTO_CMD_REGISTER, NLM_F_ACK);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  nla_put_u32(message.get(), XAUTO_A_TYPE, static_cast<std::uint32_t>(type));
  nla_put_s32(message.get(), XAUTO_A_FD, fd);
  if (pid != 0) nla_put_u32(message.get(), XAUTO_A_PID, static_cast<std::uint32_t>(pid));
  XAUTO_TRY(socket_->exchange(message.get(), "registering descriptor " + std::to_string(fd)));
  return socket_->registered;
}

Status QueueControl::unregister(std::uint32_t handle) {
  const NlMessage message = socket_->message(XAUTO_CMD_UNREGISTER, NLM_F_ACK);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  nla_put_u32(message.get(), XAUTO_A_HANDLE, handle);
  return socket_->exchange(message.get(), "queue " + std::to_string(handle));
}

Status QueueControl::suspend(std::uint32_t handle) {
  const QueueOp op{XAUTO_ACTION_SUSPEND, handle};
  return control({&op, 1});
}

Status QueueControl::resume(std::uint32_t handle) {
  const QueueOp op{XAUTO_ACTION_RESUME, handle};
  return control({&op, 1});
}

namespace {

void put_ops(nl_msg* message, std::span<const QueueOp> ops) {
  nlattr* list = nla_nest_start(message, XAUTO_A_OPS);
  int index = 1;
  for (const QueueOp& op : ops) {
    nlattr* nest = nla_nest_start(message, index++);
    nla_put_u32(message, XAUTO_OP_ACTION, op.action);
    nla_put_u32(message, XAUTO_OP_HANDLE, op.handle);
    if (op.value != 0 || op.action == XAUTO_ACTION_SET_INTERLEAVE)
      nla_put_u32(message, XAUTO_OP_VALUE, op.value);
    nla_nest_end(message, nest);
  }
  nla_nest_end(message, list);
}

/// Which operation an error's offset points at.
std::string operation_at(nl_msg* message, std::uint32_t offset, std::span<const QueueOp> ops) {
  nlattr* list = genlmsg_attrdata(static_cast<genlmsghdr*>(nlmsg_data(nlmsg_hdr(message))), 0);
  nlattr* nest = nullptr;
  int rest = 0;
  std::size_t index = 0;
  nla_for_each_nested(nest, list, rest) {
    const auto at = static_cast<std::uint32_t>(reinterpret_cast<char*>(nest) -
                                               reinterpret_cast<char*>(nlmsg_hdr(message)));
    if (offset >= at && offset < at + static_cast<std::uint32_t>(nla_total_size(nla_len(nest))) &&
        index < ops.size())
      return "operation " + std::to_string(index + 1) + " of " + std::to_string(ops.size()) +
             ", queue " + std::to_string(ops[index].handle);
    ++index;
  }
  return "control";
}

}  // namespace

Status QueueControl::send_ops(std::span<const QueueOp> ops, int flags) {
  const NlMessage message = socket_->message(XAUTO_CMD_CONTROL, NLM_F_ACK | flags);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  put_ops(message.get(), ops);
  Status done = socket_->exchange(message.get(), "control");
  if (!done) done.error().where = operation_at(message.get(), socket_->error_offset, ops);
  return done;
}

Status QueueControl::control(std::span<const QueueOp> ops) {
  return send_ops(ops, 0);
}

Result<std::vector<std::uint64_t>> QueueControl::control_timed(std::span<const QueueOp> ops) {
  socket_->costs.clear();
  XAUTO_TRY(send_ops(ops, NLM_F_ECHO));
  return socket_->costs;
}

Status QueueControl::set_watchdog(std::uint32_t timeout_ms) {
  const NlMessage message = socket_->message(XAUTO_CMD_WATCHDOG, NLM_F_ACK);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  nla_put_u32(message.get(), XAUTO_A_TIMEOUT_MS, timeout_ms);
  return socket_->exchange(message.get(), "watchdog");
}

Status QueueControl::feed_watchdog() {
  const NlMessage message = socket_->message(XAUTO_CMD_WATCHDOG, NLM_F_ACK);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  return socket_->exchange(message.get(), "watchdog");
}

Result<QueueInfo> QueueControl::query(std::uint32_t handle) {
  const NlMessage message = socket_->message(XAUTO_CMD_GET, NLM_F_ACK);
  if (!message) return fail(ErrorCode::kIo, "out of memory");
  nla_put_u32(message.get(), XAUTO_A_HANDLE, handle);
  socket_->infos.clear();
  XAUTO_TRY(socket_->exchange(message.get(), "queue " + std::to_string(handle)));
  if (socket_->infos.empty()) return fail(ErrorCode::kInternal, "the module answered with nothing");
  return socket_->infos.front();
}

Result<std::vector<QueueInfo>> QueueControl::list(int tries) {
  for (int i = 0; i < tries; ++i) {
    const NlMessage message = socket_->message(XAUTO_CMD_GET, NLM_F_DUMP);
    if (!message) return fail(ErrorCode::kIo, "out of memory");
    socket_->infos.clear();
    XAUTO_TRY(socket_->exchange(message.get(), "list"));
    if (!socket_->interrupted) return socket_->infos;
  }
  return fail(ErrorCode::kUnavailable,
              "queues came or went each time that it was read, " + std::to_string(tries) + " times",
              "list");
}

}  // namespace xauto::kernel
