// SPDX-License-Identifier: Apache-2.0
#include "account/thread_watch.h"

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/short_file.h"

namespace xauto::runtime {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kStillNs = 1'000'000;     ///< below, it is the kernel's timer
constexpr std::int64_t kFindNs = 1'000'000'000;  ///< between two looks for further threads

std::int64_t ns_of_ticks(std::int64_t ticks) {
  return ticks * (1'000'000'000 / std::max(1L, sysconf(_SC_CLK_TCK)));
}

std::vector<pid_t> threads_of_process(const std::string& proc) {
  std::vector<pid_t> found;
  std::error_code error;
  for (fs::directory_iterator at(proc + "/self/task", error), end; !error && at != end;
       at.increment(error)) {
    const std::string name = at->path().filename().string();
    pid_t id = 0;
    if (std::from_chars(name.data(), name.data() + name.size(), id).ec == std::errc())
      found.push_back(id);
  }
  return found;
}

/// User and system time, of /proc/PID/stat; 0: it is gone.
std::int64_t cpu_ns_of_process(const std::string& proc, pid_t process) {
  std::ifstream file(fmt::format("{}/{}/stat", proc, process));
  std::string text;
  std::getline(file, text);
  const std::size_t behind_name = text.rfind(')');  // which may have any bytes
  if (behind_name == std::string::npos) return 0;
  std::istringstream fields(text.substr(behind_name + 1));
  std::string skipped;
  for (int field = 3; field < 14; ++field) fields >> skipped;
  std::int64_t user = 0, system = 0, of_user = 0,
               of_system = 0;  // of_: of its children that have ended
  fields >> user >> system >> of_user >> of_system;
  return ns_of_ticks(user + system + of_user + of_system);
}

/// Of those that have ended and were waited for, and of those that run.
std::int64_t cpu_ns_of_children(const std::string& proc) {
  rusage used{};
  getrusage(RUSAGE_CHILDREN, &used);
  const auto ns = [](const timeval& t) { return t.tv_sec * 1'000'000'000 + t.tv_usec * 1000; };
  std::int64_t sum = ns(used.ru_utime) + ns(used.ru_stime);
  for (const pid_t thread : threads_of_process(proc)) {
    std::ifstream children(fmt::format("{}/self/task/{}/children", proc, thread));
    for (pid_t child = 0; children >> child;) sum += cpu_ns_of_process(proc, child);
  }
  return sum;
}

/// What a hypervisor gave to others while a CPU of ours had work (proc(5), /proc/stat).
std::int64_t stolen_ns(const std::string& proc) {
  std::ifstream file(proc + "/stat");
  std::string cpu;
  std::int64_t user = 0, nice = 0, system = 0, idle = 0, io = 0, irq = 0, soft = 0, stolen = 0;
  file >> cpu >> user >> nice >> system >> idle >> io >> irq >> soft >> stolen;
  return file ? ns_of_ticks(stolen) : 0;
}

}  // namespace

ThreadWatch::ThreadWatch(std::vector<pid_t> xnodes_on_cores, std::string proc)
    : proc_(std::move(proc)),
      xnodes_(std::move(xnodes_on_cores)),
      found_ns_(now_ns()),
      process_ns_(clock_ns(CLOCK_PROCESS_CPUTIME_ID)),
      children_ns_(cpu_ns_of_children(proc_)),
      children_now_ns_(children_ns_),
      stolen_ns_(stolen_ns(proc_)),
      stolen_now_ns_(stolen_ns_) {
  find_threads(true);
  const bool counted = std::any_of(threads_.begin(), threads_.end(),
                                   [](const auto& t) { return t.second.last.ran_ns > 0; });
  if (!counted) not_watched_ = proc_ + "/self/task/*/schedstat does not tell";
}

void ThreadWatch::find_threads(bool ours) {
  for (const pid_t id : threads_of_process(proc_)) {
    if (threads_.contains(id)) continue;
    const std::string folder = fmt::format("{}/self/task/{}", proc_, id);
    Seen seen;
    seen.name = read_short_file(folder + "/comm").value_or("");
    seen.schedstat = UniqueFd(open((folder + "/schedstat").c_str(), O_RDONLY | O_CLOEXEC));
    const auto times = rt::times_of(seen.schedstat.get());
    const bool named = seen.name.starts_with("xauto/");
    seen.ours = ours || named;
    // Of an XNode on a core its worker knows for whom it waited. Nobody waits for a watch, or a stranger.
    seen.waits_count = seen.ours && seen.name != "xauto/watch" &&
                       std::find(xnodes_.begin(), xnodes_.end(), id) == xnodes_.end();
    if (times) seen.last = *times;
    if (ours) seen.first = seen.last;  // of one that came later all counts
    threads_.emplace(id, std::move(seen));
  }
}

void ThreadWatch::finish() {
  // A child that ended and nobody waited for is in neither sum: what was seen before counts.
  children_now_ns_ = std::max(children_now_ns_, cpu_ns_of_children(proc_));
  stolen_now_ns_ = stolen_ns(proc_);
}

void ThreadWatch::woke(std::int64_t late_ns) {
  if (!not_watched_.empty()) return;  // who tells a queue from it?
  const std::int64_t waited_ns = rt::without_core_ns().value_or(waited_ns_);
  const std::int64_t by_queue_ns = waited_ns - std::exchange(waited_ns_, waited_ns);
  still_ns_ = std::max(still_ns_, late_ns - by_queue_ns);
}

void ThreadWatch::look(std::int64_t now_ns) {
  const bool finds = now_ns - found_ns_ >= kFindNs;
  if (finds) {
    found_ns_ = now_ns;
    find_threads(false);
    finish();
  }
  const std::int64_t process_ns =
      clock_ns(CLOCK_PROCESS_CPUTIME_ID);  // before its threads: no less
  std::int64_t ours_ns = 0;
  for (auto& [id, seen] : threads_) {
    if (const auto times = rt::times_of(seen.schedstat.get())) {
      if (seen.waits_count)
        seen.longest_ns = std::max(seen.longest_ns, times->waited_ns - seen.last.waited_ns);
      seen.last = *times;
    }
    if (seen.ours) ours_ns += seen.last.ran_ns - seen.first.ran_ns;
  }
  if (finds) others_ns_ = std::max(others_ns_, process_ns - process_ns_ - ours_ns);
}

std::vector<TakenReport> ThreadWatch::taken() const {
  std::vector<TakenReport> list;
  const auto add = [&](std::string what, std::int64_t ns) {
    if (ns > 0) list.push_back({std::move(what), ns / 1000});
  };
  if (still_ns_ >= kStillNs)
    add(fmt::format(
            "a thread that only slept woke up to {:.2f} ms late, and had not waited for a core: "
            "the machine stood still",
            static_cast<double>(still_ns_) * 1e-6),
        still_ns_);
  for (const auto& [id, seen] : threads_)
    add(fmt::format("the thread '{}' waited up to {:.2f} ms in a run queue, within {} ms",
                    seen.name, static_cast<double>(seen.longest_ns) * 1e-6, kLookNs / 1'000'000),
        seen.longest_ns);
  if (not_watched_.empty())
    add(fmt::format("threads of the program beside its XNodes' used {:.0f} ms of CPU time, in all",
                    static_cast<double>(others_ns_) * 1e-6),
        others_ns_);
  add(fmt::format("child processes of the program used {:.0f} ms of CPU time, in all",
                  static_cast<double>(children_now_ns_ - children_ns_) * 1e-6),
      children_now_ns_ - children_ns_);
  add(fmt::format("other machines on this hardware had its CPUs for {:.0f} ms, in all (steal)",
                  static_cast<double>(stolen_now_ns_ - stolen_ns_) * 1e-6),
      stolen_now_ns_ - stolen_ns_);
  return list;
}

}  // namespace xauto::runtime
