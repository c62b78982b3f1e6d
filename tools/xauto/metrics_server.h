// SPDX-License-Identifier: Apache-2.0
// GET /metrics over HTTP/1.1, for one scraper or a few: nothing that waits. It answers with
// the text that it was given last. Whoever asks too much, too slowly or does not read is sent away.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <poll.h>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"

namespace xauto::cli {

/// The whole answer to a request's head, up to and with its empty line. Pure.
[[nodiscard]] std::string http_answer(std::string_view head, const std::string& metrics);

/// Threads: one.
class MetricsServer {
 public:
  static constexpr std::size_t kMaxClients = 8;               ///< then the oldest is sent away
  static constexpr std::size_t kMaxHeadBytes = 8192;          ///< of a request
  static constexpr std::int64_t kPatienceNs = 5'000'000'000;  ///< from connecting to the last byte

  /// `address`: IPv4 or IPv6, in numbers. Port 0: any that is free, see port().
  [[nodiscard]] static Result<std::unique_ptr<MetricsServer>> open(const std::string& address,
                                                                   int port);
  [[nodiscard]] int port() const { return port_; }
  void show(std::string metrics);
  /// What to wait for.
  void add_to(std::vector<pollfd>& fds) const;
  /// Lets in who has come, reads, answers.
  void serve(std::int64_t now_ns);

 private:
  struct Client {
    UniqueFd socket;
    std::int64_t since_ns = 0;
    std::string head, answer;
    std::size_t sent = 0;
  };
  MetricsServer(UniqueFd listener, int port) : listener_(std::move(listener)), port_(port) {}
  void let_in(std::int64_t now_ns);
  [[nodiscard]] bool is_done(Client& client) const;
  OneThread thread_;
  UniqueFd listener_;
  int port_;
  std::string metrics_;
  std::vector<Client> clients_;
};

}  // namespace xauto::cli
