// SPDX-License-Identifier: Apache-2.0
#include "account/foreign_watch.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>

#include <fcntl.h>
#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/rt.h"
#include "base/unique_fd.h"
#include "base/utf8.h"
#include "processes/address.h"

namespace xauto::runtime {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kRunsNs = 1'000'000'000, kSilentNs = 60'000'000'000;
constexpr std::size_t kMostNames = 3;
/// Of a fork bomb not all are looked at.
constexpr int kMostThreads = 8192;
/// Who takes a core from real-time threads is one itself.
constexpr int kLooksForRealtime = 10;
/// Who has less of the time between two looks takes no core: the kernel's own threads run for microseconds.
constexpr std::int64_t kTakesNs = 1'000'000, kPartOfLook = 100;
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

struct Thread {
  std::string name;  ///< empty: the kernel ran it elsewhere
  bool realtime = false;
  std::int64_t ran_ns = 0;
};

Thread thread_of(const std::string& folder, pid_t process, int core) {
  std::ifstream file(folder + "/stat");
  std::string text;
  std::getline(file, text);
  const std::size_t from = text.find('('), to = text.rfind(')');  // a name may have any bytes
  if (from == std::string::npos || to == std::string::npos || to < from) return {};
  std::istringstream fields(text.substr(to + 1));
  std::vector<std::string> of;  // from field 3 on, proc(5)
  for (std::string field; fields >> field;) of.push_back(field);
  constexpr std::size_t kProcessor = 36, kPriority = 37, kPolicy = 38;
  if (of.size() <= kPolicy || of[kProcessor] != std::to_string(core)) return {};
  const UniqueFd schedstat(open((folder + "/schedstat").c_str(), O_RDONLY | O_CLOEXEC));
  const auto times = rt::times_of(schedstat.get());
  if (!times) return {};
  int policy = 0;
  std::from_chars(of[kPolicy].data(), of[kPolicy].data() + of[kPolicy].size(), policy);
  const bool fixed = policy == SCHED_FIFO || policy == SCHED_RR;
  return {
      fmt::format("{} (pid {}, {}{})", for_terminal(text.substr(from + 1, to - from - 1), false),
                  process, policy_name(policy), fixed ? " " + of[kPriority] : ""),
      fixed || policy == kDeadline, times->ran_ns};
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

CoreWatch::Seen CoreWatch::look(std::int64_t now_ns, const std::vector<pid_t>& known) {
  const std::int64_t least_ns = std::min((now_ns - looked_ns_) / kPartOfLook, kTakesNs);
  std::map<pid_t, std::int64_t> ran_ns;
  std::vector<Thread> found;
  int left = kMostThreads;
  each_number(proc_, [&](pid_t process) {
    if (std::ranges::find(known, process) != known.end()) return;
    const std::string tasks = fmt::format("{}/{}/task", proc_, process);
    each_number(tasks, [&](pid_t thread) {
      if (left-- <= 0) return;
      Thread one = thread_of(fmt::format("{}/{}", tasks, thread), process, core_);
      if (one.name.empty()) return;
      ran_ns[thread] = one.ran_ns;
      const auto before = ran_ns_.find(thread);
      if (before == ran_ns_.end()) return;
      one.ran_ns -= before->second;
      if (one.ran_ns >= least_ns) found.push_back(std::move(one));
    });
  });
  Seen seen;
  seen.realtime = std::ranges::any_of(found, &Thread::realtime);
  if (seen.realtime) std::erase_if(found, [](const Thread& one) { return !one.realtime; });
  std::ranges::stable_sort(found, std::greater(), &Thread::ran_ns);
  for (Thread& one : found)
    if (seen.names.size() < kMostNames) seen.names.push_back(std::move(one.name));
  ran_ns_ = std::move(ran_ns);
  looked_ns_ = now_ns;
  return seen;
}

ForeignWatch::ForeignWatch(const Session& session, Board& board, bool leads, Ask ask)
    : board_(board),
      leads_(leads),
      own_(session.own_sockets),
      xpus_(real_xpus_of(session)),
      seen_(xpus_.size(), 0),
      looks_(xpus_.size(), 0),
      ask_(std::move(ask)) {
  for (const RealXpu& xpu : xpus_) cores_.emplace_back(xpu.core);
}

void ForeignWatch::look(std::int64_t now_ns) {
  look_for_runners(now_ns);
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

/// Nobody knows who had the core when a job waited for it: whoever has it between this look and the next probably had it
/// then.
void ForeignWatch::look_for_runners(std::int64_t now_ns) {
  for (std::size_t x = 0; x < xpus_.size() && x < board_.shape().xpus; ++x) {
    XpuLine& line = board_.xpu(x);
    if (xpus_[x].shared) {
      look_for_strangers(x, now_ns);
      continue;
    }
    const std::uint64_t crowded = line.crowded.load();
    if (line.crowd_told.load() != 0 || xpus_[x].core < 0 ||
        (crowded == seen_[x] && !cores_[x].has_looked()))
      continue;
    const CoreWatch::Seen there = cores_[x].look(now_ns, {getpid()});
    if (crowded == seen_[x]) cores_[x].forget();
    seen_[x] = crowded;
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
void ForeignWatch::look_for_strangers(std::size_t xpu, std::int64_t now_ns) {
  XpuLine& line = board_.xpu(xpu);
  const bool first = asked_ns_ == 0, again = cores_[xpu].has_looked();
  const std::uint64_t suspected = line.suspected.load();
  if (xpus_[xpu].core < 0 || !ask_ || line.crowd_told.load() != 0 ||
      (!first && !again && (suspected == seen_[xpu] || now_ns - asked_ns_ < kRunsNs)))
    return;
  asked_ns_ = now_ns;
  const std::vector<pid_t> joined = neighbours().processes;
  // As this process calls itself: else it runs in a container, and the numbers are others'.
  blind_ = std::ranges::find(joined, getpid()) == joined.end();
  if (blind_ || (suspected == seen_[xpu] && !again)) return;
  const CoreWatch::Seen there = cores_[xpu].look(now_ns, joined);
  if (again) cores_[xpu].forget();  // the service is not asked all the time
  seen_[xpu] = suspected;
  if (!there.realtime) return;
  line.crowd(line.suspected_ns.load(), false);
  line.tell_crowd(fmt::format("{}", fmt::join(there.names, ", ")));
}

}  // namespace xauto::runtime
