// SPDX-License-Identifier: Apache-2.0
// The daemons of one run: the emulator and a coordinator per XPU, as child processes. Whoever runs
// an app, in a process of its own (supervisor.h) or in this one (keeper.h), starts them, looks after
// them several times a second, and stops them. supervisor.h says what becomes of one that dies.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <vector>

#include <poll.h>

#include <xauto/result.h>

#include "base/process.h"
#include "base/thread_safety.h"
#include "launch/pulse.h"
#include "launch/sockets.h"
#include "model/emulation_script.h"
#include "session/session.h"

namespace xauto::launch {

/// Between SIGTERM and SIGKILL.
inline constexpr int kGraceMs = 2'000;

inline constexpr int kMaxRestarts =
    100;  ///< of one daemon of a run; then it stays dead, see supervisor.h

/// Names of sockets that are no coordinator's; those have their XPUs'.
inline constexpr const char* kHubName = "hub";
inline constexpr const char* kEmudName = "emud";

/// Of the sockets that the daemons of this session listen at.
[[nodiscard]] std::vector<std::string> socket_names(const runtime::Session& session);

/// Threads: one, which must live as long as the daemons: its end kills them.
class Daemons {
 public:
  /// `bin`: the folder with xauto-coordinator and xauto-emud. `notes`: told there what died; for
  /// people.
  Daemons(std::string bin, std::vector<std::string>& notes) : bin_(std::move(bin)), notes_(notes) {}

  /// If the session emulates something. `script` without steps: there is none.
  [[nodiscard]] Status start_emulator(const runtime::Session& session, Sockets& sockets,
                                      const EmulationScript& script = {});
  /// Empty: there is none.
  [[nodiscard]] const std::string& emulator() const { return emulator_; }
  /// One for each of the session's coordinators. `session_fd`: the session, to be read by them.
  [[nodiscard]] Status start_coordinators(const runtime::Session& session, Sockets& sockets,
                                          int session_fd);

  /// One that several runs share: the socket by which it is told who comes (coord/protocol.h). `record_fd`: memory that
  /// outlives it (coord/record.h).
  [[nodiscard]] Result<UniqueFd> start_shared(const std::string& hardware, Discipline discipline,
                                              int levels, int record_fd);
  void end_shared(const std::string& hardware);
  /// Of that shared one; 0: there is none.
  [[nodiscard]] pid_t pid_of(const std::string& hardware) const;
  /// No job has that XPU, or wants it, but for one of the slot `but`.
  [[nodiscard]] bool idle(const std::string& hardware, int but) const;

  /// Their ends show here.
  void add_to(std::vector<pollfd>& fds) const;
  /// Starts again what has died, kills what hangs. False: the emulator is gone for good, once.
  [[nodiscard]] bool look_after(std::int64_t now_ns);
  void stop(int grace_ms);

  [[nodiscard]] bool emulator_died() const { return emulator_died_; }
  [[nodiscard]] std::uint64_t deaths() const { return deaths_; }
  /// Of which daemons these were, a line each: "xauto-emud died and was restarted, 2 times".
  [[nodiscard]] std::vector<std::string> who_died() const;
  /// CPU time that all coordinators together have used so far.
  [[nodiscard]] std::int64_t coordinators_cpu_us() const;

 private:
  struct Daemon {
    std::string name;
    Child child;
    bool coordinator = false;
    bool noticed = false;
    SpawnOptions options;  ///< to start it again
    UniqueFd kept[3];      ///< what outlives it: see coord::ServerOptions, emu::ServerOptions
    int starts = 1;
    int most_restarts = kMaxRestarts;
    int deaths = 0;            ///< after which it was started again
    std::size_t note = 0;      ///< where the notes say so
    Pulse pulse;               ///< a coordinator's
    std::optional<Ping> ping;  ///< the emulator's

    void hand_over(std::initializer_list<const char*> flags);
  };
  [[nodiscard]] Status start_coordinator(Daemon daemon, const std::string& xpu, UniqueFd door);
  [[nodiscard]] bool restart(Daemon& daemon, const Exit& exit);

  OneThread thread_;
  const std::string bin_;
  std::vector<std::string>& notes_;
  UniqueFd platform_, script_;
  std::string emulator_;
  std::vector<Daemon> daemons_;
  std::int64_t next_look_ns_ = 0;
  bool emulator_died_ = false;
  std::uint64_t deaths_ = 0;
  std::int64_t ended_cpu_us_ = 0;  ///< of coordinators that have ended
};

}  // namespace xauto::launch
