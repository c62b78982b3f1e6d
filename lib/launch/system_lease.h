// SPDX-License-Identifier: Apache-2.0
// A run's place beside others on the machine's coordinators (system_service.h). It has it until the object, or the
// process, ends.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/door.h"
#include "coord/record.h"
#include "launch/system_protocol.h"
#include "model/json_value.h"
#include "session/session.h"

namespace xauto::launch {

inline constexpr std::int64_t kGiveBackNs = 5'000'000'000;

struct LeaseRequest {
  std::string path = kSystemSocket;
  std::string app;
  std::uint32_t num_xnodes = 0;  ///< of all tables together
  std::vector<JoinXpu> xpus;     ///< those that it uses and others may share
  std::string demand;            ///< text of a demand file; or
  std::vector<LeaseTask> tasks;  ///< of a run that is not trusted
};

/// The real XPUs that the session's policy uses and coordinators schedule: the kernel's own scheduler of CPUs (--cpu-sched
/// ext) is none. After decide_cpu_by_keys().
[[nodiscard]] std::vector<JoinXpu> shareable_xpus(const runtime::Session& session);

/// Who is there, as the service says (docs/monitoring.md has what). Errors as below.
[[nodiscard]] Result<Json> ask_who_is_there(const std::string& path);
/// By XPU of the machine, who has it and when: of all who have joined. Errors as below; kPermission also where runs of
/// this user are not trusted.
[[nodiscard]] Result<std::map<std::string, coord::Record>> watch_machine(const std::string& path);
/// Runs of this user are not trusted there: each gets a page of its own, and has its XPUs for what it asks for, and no
/// longer. False also where nobody answers.
[[nodiscard]] bool is_regulated(const std::string& path);

class SystemLease {
 public:
  /// kNotFound: nobody serves there; kPermission: this user may not ask; kInfeasible: it does not fit to those who are
  /// there, and how.
  /// What somebody has left and not given back yet is waited for, kGiveBackNs at most.
  [[nodiscard]] static Result<SystemLease> ask(const LeaseRequest& request);

  /// Address of the coordinator of `hardware`, for Session::coordinators.
  [[nodiscard]] std::string address(const std::string& hardware) const;
  /// Readable once the service has gone, and with it the lease.
  [[nodiscard]] int fd() const { return socket_.get(); }

 private:
  [[nodiscard]] static Result<SystemLease> ask_once(const LeaseRequest& request, bool& later);

  UniqueFd socket_;
  std::string path_;
  coord::Lease lease_;
};

}  // namespace xauto::launch
