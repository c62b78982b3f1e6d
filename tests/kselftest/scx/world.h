// SPDX-License-Identifier: Apache-2.0
// What the scheduler's tests share: a run with its maps, the loader as a process, XNode threads
// that spin or wait, and a controller that no XNode can starve.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "kernel/run_maps.h"
#include "kernel/scx_process.h"
#include "kernel/thread_slots.h"

#ifndef SCHED_EXT
#define SCHED_EXT 7
#endif

namespace xauto::test {

using Clock = std::chrono::steady_clock;

inline double seconds(Clock::duration d) {
  return std::chrono::duration<double>(d).count();
}
[[nodiscard]] std::string slurp(const std::string& path);
/// CPU time of the calling thread.
[[nodiscard]] double cpu_seconds();
void pin(int cpu);
/// Whether `make check-full` runs: the guest's init has it from the kernel's command line.
[[nodiscard]] bool full();
/// Burns that much CPU time of the calling thread.
void burn_us(std::int64_t us);
/// Waits until `done` says so; false after `limit_s`.
bool wait_for(const std::function<bool()>& done, double limit_s = 10);

/// A run with `xnodes` XNodes; priorities are 10 * (index + 1) on `cpu` until a test says
/// otherwise.
class World {
 public:
  World(std::uint32_t xnodes, int cpu, std::uint32_t slots = 16);

  /// Loads the scheduler; bails out of the test if it cannot be loaded.
  void load(const std::vector<std::string>& arguments = {});
  /// Ends it in order.
  void unload();
  [[nodiscard]] Result<kernel::ScxProcess> try_load(
      const std::vector<std::string>& arguments = {}) const;

  std::vector<kernel::TableRow> rows;
  void put_rows();
  /// Since the load, or since loaded_world() gave it to this test.
  [[nodiscard]] std::uint64_t stat(int which) const;

  kernel::RunMaps maps;
  kernel::ThreadSlots slots;
  std::optional<kernel::ScxProcess> loader;
  int cpu;

 private:
  friend World& loaded_world(const std::vector<std::string>& arguments);
  void renew();
  xauto_bpf_counts before_{};
};

/// One with 16 XNodes on CPU 1 and the scheduler of these arguments, shared by tests that follow one another:
/// the kernel proves the program at each load, which takes an emulated machine seconds. Rows and counts
/// are as in a new one. It ends when another world loads, and with end_loaded_world().
[[nodiscard]] World& loaded_world(const std::vector<std::string>& arguments = {});
void end_loaded_world();

/// A thread of one slot, told to run XNode `xnode`. `body` gets the slot.
class XNodeThread {
 public:
  XNodeThread(World& world, std::uint32_t xnode,
              std::function<void(const kernel::ThreadSlot&)> body, bool ext = false);
  ~XNodeThread() { join(); }
  void join();
  [[nodiscard]] double cpu() const { return cpu_s_; }  ///< after join
  [[nodiscard]] std::uint32_t index() const { return index_; }
  [[nodiscard]] const kernel::ThreadSlot& slot() const { return slot_; }  ///< entered

 private:
  const kernel::ThreadSlot slot_;
  std::uint32_t index_;
  double cpu_s_ = 0;
  std::thread thread_;
};

/// The controller: real-time, on the other CPU.
void become_controller();

[[nodiscard]] std::string scx_state();
[[nodiscard]] std::string program_folder();

}  // namespace xauto::test
