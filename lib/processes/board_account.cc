// SPDX-License-Identifier: Apache-2.0
#include "processes/board_account.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>

namespace xauto::runtime {
namespace {

double in_ms(std::int64_t us) {
  return static_cast<double>(us) / 1000;
}

/// What every kind is added by, so that those that did not happen are known, too.
class Watched {
 public:
  Watched(const Board& board, Account& account) : board_(board), account_(account) {}

  void set_up() {
    const std::string unkept = board_.unkept();
    add("set_up", unkept.empty() ? 0 : 1, unkept);
    if (const std::string line = board_.contexts().not_complete();
        account_.goes_on && !line.empty())
      add("context_not_complete", board_.contexts().incomplete.load(), line);
  }

  void releases() {
    const BoardHeader& header = board_.header();
    const std::uint64_t late = board_.late(), early = header.early.load();
    add("release_off_grid", late,
        fmt::format("{} releases were not where app.json's period and jitter have them, by up to "
                    "{} us{}",
                    late, (board_.latest_ns() + 999) / 1000,
                    early > 0 ? fmt::format("; {} of them came too soon", early) : ""));
    const std::uint64_t overlapping = header.overlapping.load();
    add("release_overlap", overlapping,
        fmt::format("{} of {} releases came while an earlier one was in flight", overlapping,
                    board_.released()));
  }

  void suspensions() {
    std::vector<std::string> slow;
    std::uint64_t suspends = 0, resumes = 0;
    for (std::uint32_t x = 0; x < board_.shape().xpus; ++x)
      if (std::string line = board_.xpu(x).slow_suspensions(); !line.empty())
        slow.push_back(std::move(line));
    const std::uint64_t num_slow = slow.size();
    account_.add("slow_suspension", num_slow, std::move(slow));
    std::vector<std::string> not_suspended, not_resumed;
    for (std::uint32_t n = 0; n < board_.shape().nodes; ++n) {
      const XNodeLine& line = board_.xnode(n);
      const std::uint32_t on = line.failed_on.load();
      const std::string xpu = on < board_.shape().xpus ? line_name(board_.xpu(on).name) : "",
                        name = line_name(line.name);
      const auto words = [&](std::uint64_t times, const char* what) {
        return fmt::format("preemption failed {} time{} on {}: the work of XNode '{}' was not {}",
                           times, times == 1 ? "" : "s", xpu, name, what);
      };
      if (const std::uint64_t times = line.failed_suspends.load(); times > 0) {
        suspends += times;
        not_suspended.push_back(words(times, "suspended"));
      }
      if (const std::uint64_t times = line.failed_resumes.load(); times > 0) {
        resumes += times;
        not_resumed.push_back(words(times, "resumed"));
      }
    }
    account_.add("failed_suspension", suspends, std::move(not_suspended));
    account_.add("failed_resumption", resumes, std::move(not_resumed));
    board_.contexts().each([&](const char* kind, std::uint32_t count, const char* what) {
      add(kind, count, fmt::format("{} {}", count, what));
    });
  }

  void others() {
    std::vector<std::string> sharing, crowds;
    std::uint64_t shared = 0, crowded = 0;
    for (std::uint32_t x = 0; x < board_.shape().xpus; ++x) {
      const XpuLine& line = board_.xpu(x);
      if (std::string words = line.words_of_sharing(); !words.empty()) {
        ++shared;
        sharing.push_back(std::move(words));
      }
      if (std::string words = line.words_of_crowd(); !words.empty()) {
        crowded += line.crowded.load();
        crowds.push_back(std::move(words));
      }
    }
    account_.add("xpu_shared", shared, std::move(sharing));
    account_.add("core_taken", crowded, std::move(crowds));
  }

  void scenarios() {
    const BoardHeader& header = board_.header();
    const std::uint64_t jobs = header.outside_jobs.load(), clocks = header.outside_clocks.load();
    add("job_outside_scenarios", jobs,
        fmt::format("jobs were outside of every scenario, {} times", jobs));
    add("clock_outside_scenarios", clocks,
        fmt::format("the machine's clocks and modes were those of no scenario, {} times", clocks));
    const std::uint64_t unproven = header.unproven_switches.load(),
                        unsettled = header.unsettled.load();
    add("change_without_claim", unproven,
        fmt::format("{} changes of the table have no worst case for some chains, of which nothing "
                    "is claimed since: an XPU was lost, or a job had been too long for more than "
                    "tables.json's notice_us",
                    unproven));
    add("change_too_soon", unsettled,
        fmt::format(
            "{} releases kept a table that no longer fits: the change before had not settled",
            unsettled));
  }

  void jobs() {
    std::uint64_t jobs = 0, over = 0, overruns = 0, unended = 0, hangs = 0, moved = 0;
    const XNodeLine* worst = nullptr;
    std::vector<std::string> of_wcets, of_hangs, of_moved, of_asked;
    std::uint64_t asked = 0;
    for (std::uint32_t n = 0; n < board_.shape().nodes; ++n) {
      const XNodeLine& line = board_.xnode(n);
      jobs += line.jobs.load();
      overruns += line.overruns.load();
      if (const std::uint64_t longer = line.over_wcet.load(); longer > 0) {
        over += longer;
        if (worst == nullptr || line.over_ns.load() > worst->over_ns.load()) worst = &line;
      }
      if (std::string text = line.words_of_moved(); !text.empty()) {
        ++moved;
        of_moved.push_back(std::move(text));
      }
      if (std::string text = line.words_of_asked(); !text.empty()) {
        asked += line.asked_times.load();
        of_asked.push_back(std::move(text));
      }
      if (const std::uint64_t count = line.hangs.load(); count > 0) {
        hangs += count;
        of_hangs.push_back(words_of_hangs(line, count));
      }
      if (const std::uint32_t count = line.unended.load(); count > 0) {
        unended += count;
        of_wcets.push_back(words_of_unended(line, count));
      }
    }
    if (worst != nullptr)
      of_wcets.insert(of_wcets.begin(),
                      fmt::format("{} of {} jobs outran {}, {} by {:.3f} ms{}", over, jobs,
                                  tables() ? "the WCET of their scenario" : "their WCET",
                                  line_name(worst->name), in_ms(worst->over_ns.load() / 1000),
                                  words_of_apart(*worst)));
    // Where nothing is claimed nobody looks.
    if (account_.claims() || tables())
      account_.add("wcet_overrun", over + unended, std::move(of_wcets));
    // By tables its XPU counts as lost, and they say what is claimed then.
    if (tables()) of_hangs.clear();
    account_.add("hang", hangs, std::move(of_hangs));
    account_.add("moved_thread", moved, std::move(of_moved));
    account_.add("changed_urgency", asked, std::move(of_asked));
    account_.add("budget_overrun", overruns, std::string());
  }

  void processes() {
    std::uint64_t lost = 0, deaths = 0;
    for (std::uint32_t m = 0; m < board_.shape().modules; ++m) {
      const ModuleLine& line = board_.module(static_cast<int>(m));
      lost += line.failed.load() + line.dropped.load();
      deaths += line.deaths.load();
    }
    add("lost_activation", lost, fmt::format("{} activations were lost", lost));
    add("process_death", deaths, "processes of the run died");
    crossings();
    // When it is over, who looked after them names each.
    const std::uint64_t daemons = board_.header().daemon_deaths.load();
    if (account_.goes_on)
      add("daemon_death", daemons, "coordinators of the run, or its emulator, died");
  }

 private:
  void crossings() {
    std::uint64_t lost = 0;
    std::vector<std::string> words;
    for (std::uint32_t c = 0; c < board_.shape().crossings; ++c) {
      const CrossingLine& line = board_.crossing(c);
      lost += line.lost.load();
      if (const std::string text = line.words_of_lost(); !text.empty()) words.push_back(text);
    }
    account_.add("crossing_lost", lost, std::move(words));
  }
  [[nodiscard]] bool tables() const { return board_.shape().scenarios > 0; }
  void add(std::string_view kind, std::uint64_t count, std::string words) {
    account_.add(kind, count, count > 0 ? std::move(words) : std::string());
  }
  static std::string of_module(const XNodeLine& line) {
    return "XNode '" + line_name(line.name) + "' of XModule '" + line_name(line.module) + "'";
  }
  static std::string words_of_unended(const XNodeLine& line, std::uint32_t jobs) {
    return fmt::format("{}{} {} run for {:.2f} ms and {} not ended; its WCET is {:.2f} ms{}",
                       jobs > 1 ? fmt::format("{} jobs of ", jobs) : "", of_module(line),
                       jobs > 1 ? "have" : "has", in_ms(line.unended_ns.load() / 1000),
                       jobs > 1 ? "have" : "has", in_ms(line.unended_wcet_ns.load() / 1000),
                       words_of_apart(line));
  }
  static const char* words_of_apart(const XNodeLine& line) {
    return line.kept_apart
               ? "; that counts on it that the plan keeps it apart from jobs on other XPUs"
               : "";
  }
  static std::string words_of_hangs(const XNodeLine& line, std::uint64_t jobs) {
    return fmt::format("{} job{} of {} ran past {} hang limit", jobs, jobs > 1 ? "s" : "",
                       of_module(line), jobs > 1 ? "their" : "its");
  }

  const Board& board_;
  Account& account_;
};

}  // namespace

ChainAccount chain_of(const FlowLine& line) {
  ChainAccount chain;
  chain.name = line_name(line.name);
  chain.deadline_us = line.deadline_us;
  chain.max_age_us = line.age_limit_us;
  chain.worst_case_us = line.worst_case_us;
  chain.lower_bound_us = line.lower_bound_us;
  chain.urgent_worst_case_us = line.urgent_worst_case_us;
  chain.longest_us = line.longest_us.load();
  chain.longest_urgent_us = line.longest_urgent_us.load();
  chain.deadline_misses = line.late.load();
  chain.age_misses = line.old.load();
  chain.lost = line.lost.load();
  chain.over_claim = line.over.load();
  chain.over_us = line.over_us.load();
  chain.over_claimed_us = line.over_claimed_us.load();
  chain.urgent_exceeded =
      line.urgent_worst_case_us > 0 && chain.longest_urgent_us > line.urgent_allowed_us;
  std::map<std::uint32_t, std::uint64_t> buckets;
  for (std::uint32_t b = 0; b < FlowLine::kBuckets; ++b)
    if (const std::uint32_t count = line.latency_us[b].load(std::memory_order_relaxed); count > 0)
      buckets[b] = count;
  // A result may come between two of these reads: the buckets are the count.
  static_cast<void>(Distribution::restore({}, buckets, line.sum_us.load(),
                                          std::max<std::int64_t>(0, chain.longest_us),
                                          chain.latency_us));
  return chain;
}

void add_assumptions(const Board& board, Account& account) {
  Watched watched(board, account);
  watched.set_up();
  watched.suspensions();
  watched.releases();
  watched.others();
  watched.scenarios();
  watched.jobs();
  watched.processes();
}

Account account_of(const Board& board) {
  Account account;
  account.goes_on = true;
  claim_on(account, static_cast<Claimed>(std::min(board.header().claimed.load(), 3U)));
  for (std::uint32_t f = 1; f < board.shape().flows; ++f) {
    ChainAccount& chain = account.chains.emplace_back(chain_of(board.flow(f)));
    if (const std::uint32_t m = board.flow(f).module; m < board.shape().modules) {
      const ModuleLine& end = board.module(static_cast<int>(m));
      chain.lost = end.failed.load() + end.dropped.load();
    }
  }
  const auto spanned = board.header().spanned.read();
  account.change_exceeded = spanned && spanned->exceeds();
  add_assumptions(board, account);
  return account;
}

}  // namespace xauto::runtime
