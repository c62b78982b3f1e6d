// SPDX-License-Identifier: Apache-2.0
#include "launch/sockets.h"

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstring>

#include <fmt/format.h>
#include <sys/random.h>
#include <unistd.h>

#include "base/socket.h"
#include "processes/marks.h"

namespace xauto::launch {
namespace {

constexpr int kTries = 100;

Result<std::string> new_secret() {
  std::uint64_t number = 0;
  if (getrandom(&number, sizeof number, 0) != sizeof number)
    return fail(ErrorCode::kIo, std::string("getrandom: ") + strerror(errno));
  return fmt::format("{:016x}", number);
}

}  // namespace

Result<Sockets> Sockets::open(const std::vector<std::string>& names) {
  static std::atomic<int> runs{0};
  Sockets all;
  all.run_ = std::to_string(getpid()) + "-" + std::to_string(runs.fetch_add(1));
  for (int left = kTries;;) {
    XAUTO_ASSIGN(const std::string secret, new_secret());
    all.sockets_.clear();
    all.stem_ = kSocketPrefix + all.run_ + "/" + secret + "/";
    Status status;
    for (const std::string& name : names) {
      Socket& socket = all.sockets_[name];
      socket.address = all.stem_ + name;
      auto listener = name.starts_with(runtime::kMark) ? hold_abstract(socket.address)
                                                       : listen_abstract(socket.address);
      if (!listener) {
        status = tl::unexpected<Error>(std::move(listener).error());
        break;
      }
      socket.listener = std::move(*listener);
    }
    if (status) return all;
    if (status.error().code != ErrorCode::kUnavailable || --left == 0)
      return tl::unexpected<Error>(std::move(status).error());
  }
}

const std::string& Sockets::address(const std::string& name) const {
  return sockets_.at(name).address;
}

UniqueFd Sockets::take(const std::string& name) {
  return std::move(sockets_.at(name).listener);
}

}  // namespace xauto::launch
