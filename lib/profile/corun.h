// SPDX-License-Identifier: Apache-2.0
// Co-runs: what the profiler has work on the other XPUs while it times an XNode, because all XPUs of an
// SoC share its memory. A co-run class is a type of XPU, and all XPUs of that type but the XNode's own
// are loaded at once; or all types together (kEveryType), of a stage that two or more can be loaded beside:
//
//   emulated     jobs without a pause on each, which load the memory as far as the emulation script says
//   real cores   a thread on each core, which reads and writes more than the caches hold
//   other real   the app's own XNodes there, in turn, in a process of their own: its closures and
//                contexts are not those that are measured
//
// A stand-in's time does not depend on real memory, and real memory is not loaded by a stand-in: so
// emulated stages are measured beside emulated XPUs, real ones beside real ones.
//
// What it does not cover: another access pattern than the load's, which may
// hit the XNode's cache lines or memory banks harder; the moment of an app's own XNode that loads the
// memory most, unless it coincides with a repetition; engines that are no XPU (video, display, DMA).
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <xauto/result.h>
#include <xauto/xpu.h>

#include "base/thread_safety.h"
#include "session/session.h"

namespace xauto::runtime {

/// Keeps one XPU, or one core, busy while it is on. Threads: that of its Corun.
class Load {
 public:
  virtual ~Load() = default;
  /// Returns when it is in full swing. `not_on`: the core of the stage's thread, which would keep a
  /// thread of less priority from its work there.
  [[nodiscard]] virtual Status on(int not_on) = 0;
  /// Returns when nothing of it runs any more.
  virtual void off() = 0;
};

/// Between the profiler and a process that it has load an XPU, in a memfd. Who writes: the profiler
/// `wanted`, the process the others.
struct LoadWords {
  enum Wanted : std::uint32_t { kOff, kOn, kEnd };
  std::atomic<std::uint32_t> wanted;
  std::atomic<std::uint32_t> steps;  ///< taken, a counter
  std::atomic<std::uint32_t> idle;   ///< 1: none is under way, and none begins while not wanted
};
static_assert(sizeof(LoadWords) == 12 && std::atomic<std::uint32_t>::is_always_lock_free);

/// Takes steps while they are wanted, until kEnd, an error of a step or, at the next kOff, `stop`.
[[nodiscard]] Status serve(LoadWords& words, const std::function<Status()>& step,
                           const std::atomic<bool>& stop);
/// The words behind a memfd; kept until the process ends.
[[nodiscard]] Result<LoadWords*> map_load_words(int fd);

/// `cores`: where its threads may run.
[[nodiscard]] Result<std::unique_ptr<Load>> load_of_emulated(const XpuId& xpu,
                                                             const std::vector<int>& cores);
/// The app once more, as a process that runs its XNodes on `xpu`.
[[nodiscard]] Result<std::unique_ptr<Load>> load_by_the_app(const Session& session, int xpu,
                                                            const std::vector<int>& cores);
/// `streams`: how many cores are loaded like that at once. They share the last level cache.
[[nodiscard]] Result<std::unique_ptr<Load>> load_of_core(int core, std::size_t streams);

/// Threads: one, that of the profiler.
class Corun {
 public:
  /// `session` outlives it. `cores`: of this process.
  Corun(const Session& session, std::vector<int> cores)
      : session_(session), cores_(std::move(cores)) {}

  struct Stage {
    int xpu = -1;
    bool emulated = false;
    int core = -1;  ///< on which its thread is: that one is not loaded
  };
  /// XPUs on which the app computes itself: it can load them.
  void set_real(std::set<int> xpus) { real_ = std::move(xpus); }
  /// Whether there is anything that it could load beside the stage; why_not() else.
  [[nodiscard]] bool can_load(const std::string& type, const Stage& stage) {
    return !loaded_by(type, stage).empty();
  }
  /// Has all XPUs of a type loaded that the stage does not use, and nothing else. False: there is none
  /// that it could load; then nothing is.
  /// A load that fails is told by failure(), and ends nothing but the stages' times beside it.
  [[nodiscard]] bool beside(const std::string& type, const Stage& stage);
  void rest();

  /// Of a class: what loads it, for people; and why there was nothing, the last time. Empty: it never
  /// came to that.
  [[nodiscard]] std::string what(const std::string& type) const;
  [[nodiscard]] std::string why_not(const std::string& type) const;
  [[nodiscard]] std::string failure(const std::string& type) const;

 private:
  struct Loaded {
    enum class Kind : std::uint8_t { kEmulated, kCore, kApp } kind;
    int number;  ///< of the XPU, of the core
    bool operator<(const Loaded& other) const {
      return std::tie(kind, number) < std::tie(other.kind, other.number);
    }
  };
  /// Has these on and no others. False: one of them has failed.
  bool only(const std::set<Loaded>& wanted, int not_on);
  [[nodiscard]] Result<std::unique_ptr<Load>> make(const Loaded& one) const;
  [[nodiscard]] std::set<Loaded> loaded_by(const std::string& type, const Stage& stage);

  OneThread thread_;
  const Session& session_;
  const std::vector<int> cores_;
  std::map<Loaded, std::unique_ptr<Load>> loads_;
  std::set<Loaded> on_;
  std::set<int> real_;
  std::map<Loaded, std::string> failed_;  ///< and why
  std::map<std::string, std::set<Loaded::Kind>> what_;
  std::map<std::string, std::string> why_not_;
};

}  // namespace xauto::runtime
