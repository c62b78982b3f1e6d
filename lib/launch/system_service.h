// SPDX-License-Identifier: Apache-2.0
// One coordinator per XPU instance of the machine, for all runs that ask: `xauto-coordinator --system`. A run joins
// with what its policy demands of each XPU, and is admitted if that and the demands of all who are there fit; who is
// there keeps every claim (docs/keys.md, "Apps compose"). The run leaves by closing its connection, or by dying. What it
// had of an XPU is free once that has been idle since: until then its last jobs may still be in others' way.
// Coordinators are children as those of a run are (daemons.h), each from the first run that uses its XPU to the last.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <poll.h>

#include <xauto/result.h>

#include "base/log.h"
#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "coord/door.h"
#include "coord/record.h"
#include "launch/daemons.h"
#include "launch/foreign_work.h"
#include "launch/regulated.h"
#include "launch/system_protocol.h"
#include "model/demand.h"
#include "model/json_value.h"

namespace xauto::launch {

/// Whether the last of these may come to the others; the error says why not. Their XPUs are called as the machine's
/// are. Throws nothing; takes seconds at most.
using Admission = std::function<Status(const std::vector<Demand>& demands)>;

/// What these, each of that one XPU, leave of it, in percent (solver/keys/check.h); an error: nobody can say.
using Slack = std::function<Result<int>(const std::vector<Demand>& demands)>;

struct SystemOptions {
  std::string bin;    ///< folder with xauto-coordinator
  UniqueFd listener;  ///< listens
  std::string path;   ///< where: what of the service itself comes over its socket asks there
  Admission admission;
  Slack slack = {};
  Trust trust = {};
  /// On a Jetson's GPU and DLAs, work of processes that know nothing of XAuto is suspended while a job has the XPU
  /// (foreign_work.h).
  bool suspend_foreign = false;
};

/// Threads: one, which must live as long as the service.
class SystemService {
 public:
  explicit SystemService(SystemOptions options);
  ~SystemService();
  SystemService(const SystemService&) = delete;
  SystemService& operator=(const SystemService&) = delete;

  /// Serves until `stop_fd` becomes readable.
  void run(int stop_fd);

  /// A connection that was accepted elsewhere, and what comes over it; for the fuzzer. -1: it was closed.
  int adopt(UniqueFd socket, uid_t uid);
  bool hear(int connection);  ///< false: likewise

 private:
  /// Who has connected, and has not said all.
  struct Guest {
    UniqueFd socket;
    uid_t uid = 0;
    std::int64_t until_ns = 0;  ///< then it is closed
    std::optional<Join> join;
    std::string demand;  ///< what has come of it
  };
  struct Leased {
    UniqueFd socket;
    uid_t uid = 0;
    std::uint64_t secret = 0;
    std::uint32_t first_xnode = 0, num_xnodes = 0;
    std::string app;
    Demand demand;                         ///< of each XPU that it has
    std::vector<LeaseTask> tasks;          ///< of a run that is not trusted
    std::vector<RunProcess> processes;     ///< that have come for it
    std::set<std::string> beside_foreign;  ///< XPUs where work of others is suspended
    [[nodiscard]] bool regulated() const { return !tasks.empty(); }
  };
  /// A run that has left, with those XPUs of it that have not been idle since.
  struct Departed {
    Demand demand;
    bool regulated = false;
    std::int64_t look_ns = 0;  ///< not before: its processes need a moment to die
  };
  struct Shared {
    Discipline discipline = Discipline::kGate;
    int levels = 0;
    UniqueFd control, record_fd;
    coord::Record record;
    coord::Lease foreign_lease = {};            ///< of the work of others, ...
    std::unique_ptr<ForeignWork> foreign = {};  ///< ... where that is suspended
    std::optional<Result<int>> slack;  ///< none: nobody has asked since somebody came or left
  };

  void accept_guests();
  void close_late_guests(std::int64_t now_ns);
  [[nodiscard]] bool hear_guest(Guest& guest);
  [[nodiscard]] bool take_piece(Guest& guest, const std::string& piece);
  [[nodiscard]] Status fault_of(const Join& join, uid_t uid) const;
  [[nodiscard]] Status fault_of_tasks(const Join& join, uid_t uid) const;
  [[nodiscard]] Result<std::uint32_t> admit(Guest& guest, bool& later);
  [[nodiscard]] Status test(const Leased& newcomer, bool with_regulated, bool with_departed) const;
  [[nodiscard]] Status share(const Join& join);
  void regulate(std::uint32_t lease, const Join& join);
  [[nodiscard]] std::optional<std::uint32_t> room_for(std::uint32_t num_xnodes) const;
  [[nodiscard]] bool may_suspend_foreign(const JoinXpu& xpu) const;
  void suspend_foreign(const JoinXpu& xpu);
  void hand_on_foreign(UniqueFd worker, const coord::Attach& attach, const Shared& shared);
  void tell_who_joined();
  void hand_on(UniqueFd worker, uid_t uid, const coord::Attach& attach);
  void end(std::uint32_t lease);
  void end_regulated();
  void stop_unused();
  void forget_departed();
  [[nodiscard]] bool used(const std::string& hardware) const;
  [[nodiscard]] std::string status(uid_t uid);
  [[nodiscard]] Json status_of(std::uint32_t number, const Leased& lease) const;
  [[nodiscard]] Result<int> slack_of(const std::string& hardware) const;
  void forget_slack();
  void show_records(int socket, uid_t uid) const;

  OneThread thread_;
  SystemOptions options_;
  std::vector<std::string> notes_;
  Daemons daemons_;
  std::map<int, Guest> guests_;             ///< by descriptor
  std::map<std::uint32_t, Leased> leases_;  ///< by number
  std::map<std::string, Shared> shared_;    ///< by hardware
  std::vector<Departed> departed_;
  std::uint32_t last_lease_ = 0;
  std::uint64_t deaths_ = 0;  ///< of coordinators, so far
  log::Refusals refusals_;
};

}  // namespace xauto::launch
