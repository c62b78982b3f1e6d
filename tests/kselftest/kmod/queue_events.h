// SPDX-License-Identifier: Apache-2.0
// What xauto.ko does, as its multicast group tells it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <netlink/attr.h>
#include <netlink/errno.h>
#include <netlink/genl/ctrl.h>
#include <netlink/genl/genl.h>
#include <netlink/msg.h>
#include <netlink/socket.h>
#include <poll.h>
#include <uapi/xauto/netlink.h>

#include <xauto/result.h>

namespace guest {

struct QueueEvent {
  xauto_kevent kind = XAUTO_KEV_REGISTER;
  std::uint32_t queue = 0;  ///< 0 for an owner's events
  pid_t pid = 0;
  std::uint32_t port = 0;
  std::uint64_t time_ns = 0;  ///< CLOCK_MONOTONIC
  std::uint64_t cost_ns = 0;
  int error = 0;              ///< a positive errno
  std::uint64_t escapes = 0;  ///< with XAUTO_KEV_ESCAPED
};

class QueueEvents {
 public:
  /// kPermission without CAP_NET_ADMIN.
  [[nodiscard]] static xauto::Result<QueueEvents> subscribe() {
    QueueEvents events;
    nl_sock* s = events.socket_.get();
    if (s == nullptr || genl_connect(s) != 0)
      return xauto::fail(xauto::ErrorCode::kIo, "no generic netlink here", "xauto.ko");
    const int group = genl_ctrl_resolve_grp(s, XAUTO_FAMILY_NAME, XAUTO_MCGRP_EVENTS);
    if (group < 0 || nl_socket_add_membership(s, group) != 0)
      return xauto::fail(xauto::ErrorCode::kPermission, "the kernel does not let this user listen",
                         "xauto.ko");
    nl_socket_disable_seq_check(s);
    nl_socket_set_nonblocking(s);
    (void)nl_socket_set_buffer_size(s, 1 << 20, 0);
    nl_socket_modify_cb(s, NL_CB_VALID, NL_CB_CUSTOM, take, events.event_.get());
    return events;
  }

  /// The next one, or nothing within the time. kIo with "lost" in it when the kernel had to drop
  /// some.
  [[nodiscard]] xauto::Result<std::optional<QueueEvent>> next(int timeout_ms) {
    nl_sock* s = socket_.get();
    event_->reset();
    pollfd ready{nl_socket_get_fd(s), POLLIN, 0};
    if (poll(&ready, 1, timeout_ms) <= 0) return std::optional<QueueEvent>();
    const int status = nl_recvmsgs_default(s);
    if (status == -NLE_NOMEM)
      return xauto::fail(xauto::ErrorCode::kIo,
                         "events were lost: they came faster than they were read", "xauto.ko");
    if (status < 0 && status != -NLE_AGAIN)
      return xauto::fail(xauto::ErrorCode::kIo, nl_geterror(status), "xauto.ko");
    return *event_;
  }

 private:
  static int take(nl_msg* message, void* argument) {
    std::array<nlattr*, XAUTO_A_MAX + 1> a{};
    if (genlmsg_parse(nlmsg_hdr(message), 0, a.data(), XAUTO_A_MAX, nullptr) < 0) return NL_SKIP;
    const auto u32 = [&](int type) {
      nlattr* of = a[static_cast<std::size_t>(type)];
      return of != nullptr ? nla_get_u32(of) : 0;
    };
    const auto u64 = [&](int type) {
      nlattr* of = a[static_cast<std::size_t>(type)];
      return of != nullptr ? nla_get_u64(of) : 0;
    };
    *static_cast<std::optional<QueueEvent>*>(argument) = {
        static_cast<xauto_kevent>(u32(XAUTO_A_EVENT)),
        u32(XAUTO_A_QUEUE),
        static_cast<pid_t>(u32(XAUTO_A_PID)),
        u32(XAUTO_A_PORTID),
        u64(XAUTO_A_TIME_NS),
        u64(XAUTO_A_COST_NS),
        static_cast<int>(u32(XAUTO_A_ERRNO)),
        u64(XAUTO_A_ESCAPES)};
    return NL_OK;
  }

  std::unique_ptr<nl_sock, decltype(&nl_socket_free)> socket_{nl_socket_alloc(), nl_socket_free};
  std::unique_ptr<std::optional<QueueEvent>> event_ = std::make_unique<std::optional<QueueEvent>>();
};

}  // namespace guest
