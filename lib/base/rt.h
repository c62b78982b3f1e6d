// SPDX-License-Identifier: Apache-2.0
// Real-time properties of the calling thread. What was set is read back: a policy that is silently
// ignored is worse than an error.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

namespace xauto::rt {

/// SCHED_FIFO at `priority`, 1..99. kPermission with fifo_hint() when the kernel refuses.
[[nodiscard]] Status set_fifo(int priority);
[[nodiscard]] Status set_other();
/// Of the calling thread alone, and of threads that it makes: -20, the most, to 19. kPermission.
[[nodiscard]] Status set_nice(int nice);
/// Whether set_fifo(priority) would succeed for a thread of this process; changes nothing.
[[nodiscard]] bool may_use_fifo(int priority);
/// The highest priority for which that holds; 0: none.
[[nodiscard]] int highest_fifo();
/// As far as it may: `priority`, or the highest below it.
[[nodiscard]] Status set_fifo_up_to(int priority);
/// One line: how far the right to real-time priorities goes, and way_to_fifo().
[[nodiscard]] std::string fifo_hint();
/// How to get it, for root or for somebody else.
[[nodiscard]] std::string way_to_fifo(bool root);

[[nodiscard]] Status pin_to_core(int core);
/// To any of these; `thread`: the kernel's number of another one than the calling thread.
[[nodiscard]] Status pin_to_cores(const std::vector<int>& cores, pid_t thread = 0);
/// Where a thread may run, and by what policy; without CPUs: it is gone.
struct Placement {
  std::vector<int> cpus;
  int policy = 0;
  friend bool operator==(const Placement&, const Placement&) = default;
};
[[nodiscard]] Placement placement_of(pid_t thread);
/// The cores that this process may use, ascending.
[[nodiscard]] std::vector<int> allowed_cores();

/// The default slack of 50 us would be added to every timed wake-up.
void set_timer_slack_1ns();
/// The kernel's khugepaged locks a process's memory while it puts pages together: whoever touches a
/// new page waits, for tens of milliseconds. From now on it leaves this process alone. The price: no
/// transparent huge pages for what is mapped from now on.
void leave_huge_pages();
/// Best effort; false where the memlock limit forbids it.
bool lock_memory();
/// For how long the calling thread could have run so far, and had no core: all else of its time it ran,
/// or slept. nullopt: this kernel does not count it, or /proc is not there.
[[nodiscard]] std::optional<std::int64_t> without_core_ns();
/// The same of another thread of this process; nullopt, too, where that one has or wants a core now.
[[nodiscard]] std::optional<std::int64_t> without_core_ns(pid_t asleep);
/// A thread's times, of a file /proc/.../schedstat.
struct ThreadTimes {
  std::int64_t ran_ns = 0, waited_ns = 0;
};
[[nodiscard]] std::optional<ThreadTimes> times_of(int schedstat);
/// Cut to the kernel's 15 characters.
void set_thread_name(const std::string& name);

}  // namespace xauto::rt
