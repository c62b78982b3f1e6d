// SPDX-License-Identifier: Apache-2.0
#include "account/foreign_watch.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

#include "base/utf8.h"
#include "processes/address.h"

namespace xauto::runtime {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kRunsNs = 1'000'000'000;
constexpr std::size_t kMostNames = 3;
/// Of a fork bomb not all are looked at.
constexpr int kMostThreads = 8192;
/// Who takes a core from real-time threads is one itself, and may sleep just now.
constexpr int kLooksForRealtime = 10;
constexpr int kDeadline = 6, kExt = 7;  // linux/sched.h

const char* policy_name(int policy) {
  switch (policy) {
    case SCHED_FIFO:
      return "SCHED_FIFO";
    case SCHED_RR:
      return "SCHED_RR";
    case kDeadline:
      return "SCHED_DEADLINE";
    case kExt:
      return "SCHED_EXT";
    default:
      return "SCHED_OTHER";
  }
}

struct Runner {
  std::string name;  ///< empty: it does not run there
  bool realtime = false;
};

Runner runner(const std::string& stat, pid_t process, int core) {
  std::ifstream file(stat);
  std::string text;
  std::getline(file, text);
  const std::size_t from = text.find('('), to = text.rfind(')');  // a name may have any bytes
  if (from == std::string::npos || to == std::string::npos || to < from) return {};
  std::istringstream fields(text.substr(to + 1));
  std::vector<std::string> of;  // from field 3 on, proc(5)
  for (std::string field; fields >> field;) of.push_back(field);
  constexpr std::size_t kState = 0, kProcessor = 36, kPriority = 37, kPolicy = 38;
  if (of.size() <= kPolicy || of[kState] != "R" || of[kProcessor] != std::to_string(core))
    return {};
  int policy = 0;
  std::from_chars(of[kPolicy].data(), of[kPolicy].data() + of[kPolicy].size(), policy);
  const bool fixed = policy == SCHED_FIFO || policy == SCHED_RR;
  return {
      fmt::format("{} (pid {}, {}{})", for_terminal(text.substr(from + 1, to - from - 1), false),
                  process, policy_name(policy), fixed ? " " + of[kPriority] : ""),
      fixed || policy == kDeadline};
}

template <class Visit>
void each_number(const std::string& folder, Visit visit) {
  std::error_code error;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    const std::string name = at->path().filename().string();
    pid_t id = 0;
    const auto [rest, wrong] = std::from_chars(name.data(), name.data() + name.size(), id);
    if (wrong == std::errc() && rest == name.data() + name.size()) visit(id);
  }
}

}  // namespace

Runners runners_on(int core, pid_t own, const std::string& proc) {
  Runners found;
  int left = kMostThreads;
  each_number(proc, [&](pid_t process) {
    if (process == own) return;
    const std::string tasks = fmt::format("{}/{}/task", proc, process);
    each_number(tasks, [&](pid_t thread) {
      if (left-- <= 0) return;
      Runner one = runner(fmt::format("{}/{}/stat", tasks, thread), process, core);
      if (one.name.empty() || (found.realtime && !one.realtime)) return;
      if (one.realtime && !found.realtime) found = {{}, true};
      if (found.names.size() < kMostNames) found.names.push_back(std::move(one.name));
    });
  });
  return found;
}

ForeignWatch::ForeignWatch(const Session& session, Board& board, bool leads)
    : board_(board),
      leads_(leads),
      own_(session.own_sockets),
      xpus_(real_xpus_of(session)),
      seen_(xpus_.size(), 0),
      looks_(xpus_.size(), 0) {}

void ForeignWatch::look(std::int64_t now_ns) {
  look_for_runners();
  if (!leads_ || now_ns - looked_ns_ < kRunsNs) return;
  looked_ns_ = now_ns;
  look_for_runs();
}

void ForeignWatch::look_for_runs() {
  for (const Holder& holder : holders(own_))
    for (std::size_t x = 0; x < xpus_.size() && x < board_.shape().xpus; ++x)
      if (xpus_[x].hardware == holder.hardware && !(xpus_[x].shared && holder.shared))
        board_.xpu(x).tell_shared(holder.words());
}

/// Nobody knows who had the core then. Whoever is there now was probably there before.
void ForeignWatch::look_for_runners() {
  for (std::size_t x = 0; x < xpus_.size() && x < board_.shape().xpus; ++x) {
    XpuLine& line = board_.xpu(x);
    const std::uint64_t crowded = line.crowded.load();
    if (crowded == seen_[x] || line.crowd_told.load() != 0 || xpus_[x].core < 0) continue;
    seen_[x] = crowded;
    const Runners there = runners_on(xpus_[x].core, getpid());
    if (!there.names.empty() && (there.realtime || ++looks_[x] >= kLooksForRealtime))
      line.tell_crowd(fmt::format("{}", fmt::join(there.names, ", ")));
  }
}

}  // namespace xauto::runtime
