// SPDX-License-Identifier: Apache-2.0
// The sockets of one run: PREFIX<run>/<secret>/<name>, with the run's name, which begins with the pid of who
// listens, and what nobody can know before. Anybody may listen at any abstract name, and so take one that can
// be foreseen. Who looks for runs finds them in /proc/net/unix, and asks the kernel whether the pid is true.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "processes/address.h"

namespace xauto::launch {

using runtime::kSocketPrefix;

class Sockets {
 public:
  /// Listens at all of `names`, and begins again elsewhere while somebody has one of them: once the first is
  /// there, all can see how the others will be called.
  [[nodiscard]] static Result<Sockets> open(const std::vector<std::string>& names);

  /// "<pid>-<n>".
  [[nodiscard]] const std::string& run() const { return run_; }
  /// What all of their addresses begin with (stem_of).
  [[nodiscard]] const std::string& stem() const { return stem_; }
  /// Whether it was one of `names`.
  [[nodiscard]] bool has(const std::string& name) const { return sockets_.count(name) != 0; }
  /// Of one of `names`.
  [[nodiscard]] const std::string& address(const std::string& name) const;
  /// Its listening socket, once.
  [[nodiscard]] UniqueFd take(const std::string& name);

 private:
  struct Socket {
    std::string address;
    UniqueFd listener;
  };
  std::string run_, stem_;
  std::map<std::string, Socket> sockets_;
};

}  // namespace xauto::launch
