// SPDX-License-Identifier: Apache-2.0
// Runs that the machine's service does not trust: what their XNodes may have, as others have to count it (docs/keys.md,
// "Enforcement").
#pragma once

#include <set>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "launch/system_protocol.h"
#include "model/demand.h"

namespace xauto::launch {

/// Of whose runs the service believes that they keep what they state. Of all; of nobody; or of root, of the service's
/// own user and of these.
struct Trust {
  bool all = true, nobody = false;
  std::set<uid_t> users;

  /// "all", "nobody", or names and numbers of users with commas between them. kInvalid: there is no such user.
  [[nodiscard]] static Result<Trust> parse(const std::string& text);
  [[nodiscard]] bool trusts(uid_t uid) const;
};

/// Not root, nor our own user: he may do with his threads what he likes, and we need permission for what we do to them.
[[nodiscard]] bool is_stranger(uid_t uid);

/// What others count of a run that asks for these: each XNode by itself, in any phase. kInvalid: it asks for what cannot
/// be, or cannot be taken from it.
[[nodiscard]] Result<Demand> demand_of_tasks(const Join& join, const std::vector<LeaseTask>& tasks);
/// Beside one who is cut: each job pays for a preemption.
void charge_all(Demand& demand, const std::set<std::string>& hardware);

/// A process of a run that has come to a coordinator.
class RunProcess {
 public:
  /// Who is behind this connection.
  RunProcess(int socket, pid_t pid);
  [[nodiscard]] bool lives() const;
  /// Its threads, which a coordinator may have raised, unless it has ended.
  void lower() const;
  [[nodiscard]] pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = 0;
  UniqueFd fd_;
};

}  // namespace xauto::launch
