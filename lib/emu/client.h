// SPDX-License-Identifier: Apache-2.0
// The runtime's side of an emulated device: suspending and resuming contexts, on a connection of
// its own. The user's side is xauto/emu.h; both are in client.cc.
#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>

#include <xauto/emu.h>
#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto::emu {

struct Packet;

/// Where the contexts that a thread opens find their emulator.
struct Site {
  std::string address;            ///< abstract socket; empty: there is no emulator
  std::set<std::string> real;     ///< XPUs that are not emulated
  std::set<std::string> drivers;  ///< XPUs that kmod/emu/ emulates
  bool cpu_pool = false;          ///< the CPUs are one device
  /// Not null: there is no emulator, work on a context just adds its duration here.
  std::shared_ptr<std::int64_t> virtual_ns = nullptr;
};
/// The calling thread's; of a thread that was given none: what the tool that started this process
/// has put into the environment.
[[nodiscard]] std::shared_ptr<const Site> this_threads_site();
/// For all that this thread opens from now on; null: as the environment says.
void set_this_threads_site(std::shared_ptr<const Site> site);

/// How long a call waits for another emulator in the place of one that died, and a request for an
/// answer of one that hangs: the tool kills it after a few seconds (runtime/pulse.h). It keeps the
/// socket meanwhile; once it gives up, every call ends at once.
inline constexpr std::int64_t kComeBackNs = 15'000'000'000;

/// Threads: one at a time.
class Control {
 public:
  /// The calling thread's emulator.
  [[nodiscard]] static Result<Control> connect();

  /// Return once the emulator has done it: after suspend, the context makes no progress. An
  /// emulator that dies or hangs meanwhile is waited for, as Context::run does. kTimeout after
  /// kComeBackNs: then it will not have been suspended. kUnavailable when the emulator is gone.
  [[nodiscard]] Status suspend(std::uint32_t context);
  [[nodiscard]] Status resume(std::uint32_t context);
  /// Of the work that the context is given from now on.
  [[nodiscard]] Status level(std::uint32_t context, int level);
  /// How long work has progressed on an XPU, whoever's; of several contexts at once each counts. An
  /// emulator in the place of one that died counts on.
  [[nodiscard]] Result<std::int64_t> busy_ns(const std::string& xpu);

 private:
  Control(std::string address, UniqueFd socket)
      : address_(std::move(address)), socket_(std::move(socket)) {}
  [[nodiscard]] Status request(std::uint32_t op, std::uint32_t answer, std::uint32_t context,
                               std::int64_t value = 0);
  [[nodiscard]] Result<std::int64_t> ask(const Packet& packet, std::uint32_t answer);
  std::string address_;
  UniqueFd socket_;
  std::uint64_t tag_ = 0;
};

}  // namespace xauto::emu
