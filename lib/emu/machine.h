// SPDX-License-Identifier: Apache-2.0
// The emulated XPUs as a pure state machine: no clock, no I/O. Time is a parameter, in nanoseconds.
//
// The rules are the simulator's (solver/simulate.h): what is predicted and what is emulated agree.
//
//  * Time-sliced device (timeslice_us > 0: a GPU, a DLA). One context at a time. Enabled contexts
//    with work take turns in order of arrival, a time slice each. A context that is switched out
//    with work left costs switch_us before the next one runs. After the end of a job the next one
//    starts free.
//    Contexts may have levels: only those of the highest level that has work take turns. A context of
//    a higher level that is given work takes the device from the one that is on it, which blocks the
//    device for preempt_us; that one goes on, for free, when nobody above has work.
//  * Shared device (timeslice_us = 0: a CPU core, or the pool of all of them). All enabled contexts
//    with work progress at once, each at rate min(1, cores / contexts).
//  * Suspending a context that is on the device blocks the device for preempt_us, then the next one
//    starts free; the acknowledgement comes when that time is over. Suspending any other context is
//    acknowledged at once, and so is resuming, which is free.
//  * A device that is not preemptive refuses suspension and runs each job to its end, in order of
//    arrival.
//
// A script (model/emulation_script.h) changes how fast work progresses, from the first submission on:
//
//  * Work progresses at rate speed_pct / (100 + contention_pct * others). `others`: how many XPUs of
//    types with contention have work that may run, itself and those that are stopped not counted.
//    The rate is a whole number of millionths, rounded down, and at least one. By that number all is
//    exact, whatever changes in the middle of a job.
//  * Time slices, switches and preemptions take as long as ever.
//  * On a device that is stopped no work progresses. A switch or a preemption that is under way ends.
//    A job that is on it cannot be taken off: who asks is refused after kStuckNs, and it stays; if the
//    device goes on earlier, it is taken off then. All else is answered as ever.
//  * A stopped CPU is missing in the pool of all of them.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "model/emulation_script.h"
#include "model/platform.h"

namespace xauto::emu {

using ContextId = std::uint32_t;
using Nanos = std::int64_t;

inline constexpr std::size_t kMaxContexts = 4096;
inline constexpr Nanos kMaxWorkNs = 3'600'000'000'000;  ///< an hour
/// Of work, in a nanosecond at nominal speed: an hour of it fits into 64 bits.
inline constexpr Nanos kUnits = 1'000'000;
/// nvgpu gives an engine so long to be left (its context switch timeout), then PREEMPT fails.
inline constexpr Nanos kStuckNs = 100'000'000;

struct Event {
  /// kStuck: a suspension that was refused; kScript: the script has gone on.
  enum class Kind : std::uint8_t { kDone, kSuspended, kResumed, kStuck, kScript } kind;
  ContextId context;  ///< 0: of none
  std::uint64_t tag;  ///< the job of kDone, the request of the others; kScript: steps taken so far
  Nanos time;
  bool operator==(const Event&) const = default;
};

struct DeviceStats {
  std::string name;
  Nanos busy_ns = 0;      ///< time in which work progressed, of each context
  Nanos overhead_ns = 0;  ///< switches and preemptions
  std::uint64_t switches = 0, preemptions = 0, jobs = 0;
};

class Device;
class ScriptPlay;
struct Snapshot;

/// What a context knows of a job.
enum class Progress : std::uint8_t { kUnknown, kUnderWay, kDone };

/// Threads: one. `now` never goes back; calls bring the machine up to `now` first.
class Machine {
 public:
  /// Devices: every XPU by its id, and for each CPU type the pool of its instances by the type's
  /// name.
  [[nodiscard]] static Result<Machine> create(const Platform& platform,
                                              const EmulationScript& script = {});
  Machine(Machine&&) noexcept;
  Machine& operator=(Machine&&) noexcept;
  ~Machine();

  [[nodiscard]] Result<ContextId> open(const std::string& device, Nanos now);
  /// Its work, done or not, is gone.
  void close(ContextId context, Nanos now);
  /// One job at a time per context.
  [[nodiscard]] Status submit(ContextId context, std::uint64_t tag, Nanos work_ns, Nanos now);
  [[nodiscard]] Status suspend(ContextId context, std::uint64_t tag, Nanos now);
  [[nodiscard]] Status resume(ContextId context, std::uint64_t tag, Nanos now);
  /// Of the jobs that it is given from now on. kInvalid: it has one; kUnavailable: the device has no
  /// such level.
  [[nodiscard]] Status level(ContextId context, int level, Nanos now);

  /// How long work has progressed on the device until `now`.
  [[nodiscard]] Result<Nanos> busy(const std::string& device, Nanos now);

  /// Of the job `tag`; only the last one of a context is remembered.
  [[nodiscard]] Result<Progress> progress(ContextId context, std::uint64_t tag);

  /// Everything but the acknowledgements that are still due and events that nobody has fetched:
  /// who waits for one asks again, and a suspension that is asked for again is acknowledged when
  /// it is over, as if it had been asked for once. Nothing else tells the machine that went on
  /// from the one that was restored.
  void save(Snapshot& snapshot) const;
  /// Of a machine of the same platform and script; `snapshot` is checked in full. Its times must be
  /// past.
  [[nodiscard]] static Result<Machine> restore(const Platform& platform, const Snapshot& snapshot,
                                               Nanos now, const EmulationScript& script = {});

  /// When something will happen by itself; INT64_MAX: nothing.
  [[nodiscard]] Nanos next_event() const;
  /// Brings everything up to `now` and appends what happened, by time, then by device.
  void advance(Nanos now, std::vector<Event>& events);

  [[nodiscard]] std::vector<DeviceStats> stats() const;
  /// The next call may come from another thread, the one of all calls from then on.
  void give_away() { thread_.give_away(); }
  [[nodiscard]] std::size_t num_contexts() const { return device_of_.size(); }

 private:
  Machine();
  [[nodiscard]] Result<Device*> device_of(ContextId context);
  [[nodiscard]] Nanos next_change() const;
  void take_steps(std::vector<Event>& events);
  void tune(std::vector<Event>& events, bool advance = true);

  /// What the script says of a device.
  struct ScriptedDevice {
    std::string type;
    std::vector<std::string> xpus;
    Nanos speed_pct = 100, contention_pct = 0;
    Nanos cores = 1;  ///< that are not stopped
  };

  std::vector<std::unique_ptr<Device>> devices_;
  std::vector<ScriptedDevice> parts_;  ///< [device]
  std::unique_ptr<ScriptPlay> script_;
  Nanos script_begin_ = -1;       ///< the first submission; -1: there has been none
  std::size_t steps_ = SIZE_MAX;  ///< of the script, taken; SIZE_MAX: it has not begun
  Nanos time_ = 0;                ///< up to which everything is brought
  OneThread thread_;
  std::map<ContextId, Device*> device_of_;
  std::vector<Event> pending_;  ///< happened in a call, not yet reported
  ContextId next_id_ = 1;
};

}  // namespace xauto::emu
