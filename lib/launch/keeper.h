// SPDX-License-Identifier: Apache-2.0
// The daemons of a run that is inside somebody else's process: a thread of their own starts them,
// looks after them and stops them, since they die with the thread that started them. Signals of the
// process are left alone, and blocked on that thread.
#pragma once

#include <functional>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "launch/daemons.h"
#include "session/session.h"

namespace xauto::launch {

/// The folder with xauto-coordinator and xauto-emud: `given`, else XAUTO_PROGRAMS of the
/// environment, else where they are installed or built in relation to this library. kNotFound.
[[nodiscard]] Result<std::string> find_programs(const std::string& given);

/// Threads: one, apart from its own.
class Keeper {
 public:
  /// Starts what `session` needs, and says in it where that is: `coordinators`. `lost`: called on
  /// the keeper's thread when the emulator is gone for good.
  [[nodiscard]] static Result<std::unique_ptr<Keeper>> start(runtime::Session& session,
                                                             const std::string& bin,
                                                             std::function<void()> lost);
  ~Keeper();
  Keeper(const Keeper&) = delete;
  Keeper& operator=(const Keeper&) = delete;

  /// Abstract socket; empty: nothing is emulated.
  [[nodiscard]] const std::string& emulator() const { return emulator_; }
  /// Stops them, and returns what happened to them, for people. Idempotent.
  const std::vector<std::string>& stop();
  /// After `stop`: Daemons::who_died().
  [[nodiscard]] const std::vector<std::string>& who_died() const;

 private:
  Keeper() = default;
  void keep(runtime::Session& session, const std::string& bin, std::promise<Status> started);

  OneThread owner_;
  std::function<void()> lost_;
  std::string emulator_;
  UniqueFd quit_;  ///< eventfd
  std::vector<std::string> notes_, died_;
  std::thread thread_;
};

}  // namespace xauto::launch
