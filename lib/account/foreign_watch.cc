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

#include "base/clock.h"
#include "base/utf8.h"
#include "processes/address.h"

namespace xauto::runtime {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kRunsNs = 1'000'000'000, kSilentNs = 60'000'000'000;
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

Runners runners_on(int core, const std::vector<pid_t>& known, const std::string& proc) {
  Runners found;
  int left = kMostThreads;
  each_number(proc, [&](pid_t process) {
    if (std::ranges::find(known, process) != known.end()) return;
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

ForeignWatch::ForeignWatch(const Session& session, Board& board, bool leads, Ask ask)
    : board_(board),
      leads_(leads),
      own_(session.own_sockets),
      xpus_(real_xpus_of(session)),
      seen_(xpus_.size(), 0),
      looks_(xpus_.size(), 0),
      ask_(std::move(ask)) {}

void ForeignWatch::look(std::int64_t now_ns) {
  look_for_runners();
  if (!leads_ || now_ns - looked_ns_ < kRunsNs) return;
  looked_ns_ = now_ns;
  look_for_runs();
  look_for_foreign_work();
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
    if (xpus_[x].shared) {
      look_for_strangers(x);
      continue;
    }
    const std::uint64_t crowded = line.crowded.load();
    if (crowded == seen_[x] || line.crowd_told.load() != 0 || xpus_[x].core < 0) continue;
    seen_[x] = crowded;
    const Runners there = runners_on(xpus_[x].core, {getpid()});
    if (!there.names.empty() && (there.realtime || ++looks_[x] >= kLooksForRealtime))
      line.tell_crowd(fmt::format("{}", fmt::join(there.names, ", ")));
  }
}

/// A service that hangs would hold up whoever watches the jobs.
ForeignWatch::Neighbours ForeignWatch::neighbours() {
  const std::int64_t now = now_ns();
  if (now < silent_until_ns_) return {};
  Neighbours told = ask_();
  if (told.processes.empty()) silent_until_ns_ = now + kSilentNs;
  return told;
}

/// A service that suspends nothing is asked once.
void ForeignWatch::look_for_foreign_work() {
  const auto shared = [](const RealXpu& xpu) { return xpu.shared && xpu.core < 0; };
  if (!ask_ || !suspends_ || std::ranges::none_of(xpus_, shared)) return;
  const Neighbours told = neighbours();
  if (told.processes.empty()) return;
  suspends_ = !told.not_kept_off.empty();
  for (std::size_t x = 0; x < xpus_.size() && x < board_.shape().xpus; ++x) {
    const auto now = told.not_kept_off.find(xpus_[x].hardware);
    if (!shared(xpus_[x]) || now == told.not_kept_off.end()) continue;
    if (now->second > not_kept_off_.emplace(*now).first->second)
      board_.xpu(x).tell_shared("work of others, which was not suspended in time,");
  }
}

/// Where others are admitted. The service says who these are; of strangers only real-time threads are named, for nobody
/// else takes a core from jobs that have such a priority.
void ForeignWatch::look_for_strangers(std::size_t xpu) {
  XpuLine& line = board_.xpu(xpu);
  const bool first = asked_ns_ == 0;
  const std::uint64_t suspected = line.suspected.load();
  const std::int64_t now = now_ns();
  if (xpus_[xpu].core < 0 || !ask_ || line.crowd_told.load() != 0 ||
      (!first && (suspected == seen_[xpu] || now - asked_ns_ < kRunsNs)))
    return;
  asked_ns_ = now;
  const std::vector<pid_t> joined = neighbours().processes;
  // As this process calls itself: else it runs in a container, and the numbers are others'.
  blind_ = std::ranges::find(joined, getpid()) == joined.end();
  if (blind_ || suspected == seen_[xpu]) return;
  seen_[xpu] = suspected;
  const Runners there = runners_on(xpus_[xpu].core, joined);
  if (!there.realtime) return;
  line.crowd(line.suspected_ns.load(), false);
  line.tell_crowd(fmt::format("{}", fmt::join(there.names, ", ")));
}

}  // namespace xauto::runtime
