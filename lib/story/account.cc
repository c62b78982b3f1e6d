// SPDX-License-Identifier: Apache-2.0
// Every boundary is rounded to a microsecond once, and the parts are differences of boundaries: so
// they add up to the latency whatever a damaged trace says.
#include "story/account.h"

#include <algorithm>
#include <map>
#include <set>

#include <fmt/format.h>

namespace xauto::story {
namespace {

constexpr std::size_t kMostNames = 3;

class Accountant {
 public:
  /// `chain`: null with one rate.
  Accountant(const ReadTrace& trace, const TraceRelease& release, const TraceChain* chain)
      : trace_(trace), release_(release), chain_(chain) {}

  Result<Account> settle() {
    const TraceSlice* output = collect();
    if (output == nullptr)
      return fail(ErrorCode::kInfeasible, "no output of it is in the trace", where(), kLost);
    const auto chain = follow(*output);
    if (chain.empty())
      return fail(ErrorCode::kInfeasible, "no arrow leads to its output", where(), kLost);
    for (const auto* pieces : chain) own_.insert(key_of(*pieces->front()));
    Account account;
    if (chain_ != nullptr) account.chain = chain_->name;
    account.release = release_.number;
    account.latency_us = release_.latency_us;
    for (const auto* pieces : chain) account.steps.push_back(step_of(*pieces));
    account.publish_us = account.latency_us - cursor_;
    for (const auto& [name, planned] : planned_)
      account.planned_us = std::max(account.planned_us, planned.end);
    std::vector<std::int64_t> all;
    for (const TraceRelease& other : chain_ != nullptr ? chain_->results : trace_.releases)
      if (other.latency_us >= 0) {
        all.push_back(other.latency_us);
        account.rank += other.latency_us > account.latency_us ? 1 : 0;
      }
    account.of = static_cast<std::int64_t>(all.size());
    std::sort(all.begin(), all.end());
    account.median_us = all[(all.size() - 1) / 2];
    return account;
  }

 private:
  using Pieces = std::vector<const TraceSlice*>;
  struct Planned {
    std::int64_t work = 0, end = 0;
  };
  static constexpr const char* kLost = "was the trace cut short? its beginning says so then";

  /// What belongs to one job, or one release.
  using Key = std::pair<std::int64_t, std::string>;
  Key key_of(const TraceSlice& s) const {
    if (chain_ == nullptr || s.activation < 0) return {s.release, ""};
    return {s.activation, "activation"};
  }
  bool is_own(const TraceSlice& s) const {
    return chain_ == nullptr ? s.release == release_.number : own_.contains(key_of(s));
  }

  std::string where() const { return "release " + std::to_string(release_.number); }
  std::int64_t us(std::int64_t ns) const {
    return std::clamp<std::int64_t>((ns - release_.begin_ns) / 1000, 0, release_.latency_us);
  }

  /// The release's jobs and its last output.
  const TraceSlice* collect() {
    const TraceSlice* last = nullptr;
    for (const TraceSlice& slice : trace_.run) {
      if (chain_ == nullptr && slice.release != release_.number) continue;
      if (slice.category == "run") pieces_[{key_of(slice), slice.name}].push_back(&slice);
      if (slice.category == "switch") switches_.push_back(&slice);
      if (chain_ != nullptr) continue;
      if (slice.category == "done" && (last == nullptr || slice.begin_ns >= last->begin_ns))
        last = &slice;
    }
    if (chain_ != nullptr)  // there is no plan for releases that overlap as they please
      return &trace_.run[static_cast<std::size_t>(release_.output)];
    for (const TraceSlice& slice : trace_.plan) {
      if (slice.release != release_.number || slice.name.rfind("switch: ", 0) == 0) continue;
      Planned& planned = planned_[slice.name];
      planned.work += (slice.end_ns - slice.begin_ns) / 1000;
      planned.end = std::max(planned.end, (slice.end_ns - release_.begin_ns) / 1000);
    }
    return last;
  }

  std::vector<const Pieces*> follow(const TraceSlice& output) const {
    std::vector<const Pieces*> chain;
    const TraceSlice* last = &output;
    // Each job once: a damaged file may hold a circle.
    while (chain.size() <= pieces_.size()) {
      const TraceSlice* before = nullptr;
      for (const int i : last->from) {
        const TraceSlice& source = trace_.run[static_cast<std::size_t>(i)];
        if (source.category == "run" && (chain_ != nullptr || source.release == release_.number) &&
            (before == nullptr || source.end_ns > before->end_ns))
          before = &source;
      }
      if (before == nullptr) break;
      chain.push_back(&pieces_.at({key_of(*before), before->name}));
      last = chain.back()->front();
    }
    std::reverse(chain.begin(), chain.end());
    return chain;
  }

  ChainStep step_of(const Pieces& pieces) {
    const TraceSlice& first = *pieces.front();
    ChainStep step;
    step.xnode = first.name;
    step.xpu = first.row < 0 ? "" : trace_.rows[static_cast<std::size_t>(first.row)];
    const std::int64_t since = cursor_;
    const std::int64_t begin = std::max(since, us(first.begin_ns));
    const std::int64_t ready = std::clamp(begin - first.waited_us, since, begin);
    step.begin_us = begin;
    step.handover_us = ready - since;
    step.waited_us = begin - ready;
    if (first.released_ns > release_.begin_ns && chain_ != nullptr)
      step.sensor_us = std::max<std::int64_t>(0, std::min(ready, us(first.released_ns)) - since);
    if (step.handover_us > 0) step.busy_with = same_module(first, since, ready);
    step.held_us = std::clamp<std::int64_t>(first.held_us, 0, step.waited_us);
    if (step.waited_us > step.held_us)
      step.waited_for = others_on(first, ready + step.held_us, begin);
    cursor_ = begin;
    for (const TraceSlice* piece : pieces) {
      const std::int64_t from = std::max(cursor_, us(piece->begin_ns));
      if (from > cursor_) {
        const std::int64_t switched = switching(first, cursor_, from);
        step.switched_us += switched;
        step.suspended_us += from - cursor_ - switched;
        for (Blocker& by : others_on(first, cursor_, from)) add(step.preempted_by, by.who, by.us);
      }
      const std::int64_t to = std::max(from, us(piece->end_ns));
      step.ran_us += to - from;
      for (const Blocker& other : others_on(first, from, to)) add(step.beside, other.who, other.us);
      cursor_ = to;
    }
    step.end_us = cursor_;
    if (const auto plan = planned_.find(step.xnode); plan != planned_.end()) {
      step.planned_us = plan->second.work;
      step.planned_end_us = plan->second.end;
    }
    return step;
  }

  static void add(std::vector<Blocker>& list, const std::string& who, std::int64_t us) {
    const auto at =
        std::find_if(list.begin(), list.end(), [&](const Blocker& b) { return b.who == who; });
    if (at != list.end())
      at->us += us;
    else if (us > 0)
      list.push_back({who, us});
  }

  std::string called(const TraceSlice& slice) const {
    return is_own(slice) || (chain_ != nullptr && !of_own_module(slice))
               ? slice.name
               : fmt::format("{} of release {}", slice.name, slice.release);
  }

  template <class Wanted>
  std::vector<Blocker> meanwhile(std::int64_t from, std::int64_t to, Wanted wanted) const {
    const auto origin = release_.begin_ns;
    std::vector<Blocker> list;
    for (const TraceSlice& slice : trace_.run) {
      if (slice.begin_ns >= origin + to * 1000) break;  // they come by begin
      if (slice.category != "run" || slice.end_ns <= origin + from * 1000 || !wanted(slice))
        continue;
      add(list, called(slice), std::min(to, us(slice.end_ns)) - std::max(from, us(slice.begin_ns)));
    }
    std::stable_sort(list.begin(), list.end(),
                     [](const Blocker& a, const Blocker& b) { return a.us > b.us; });
    return list;
  }
  std::vector<Blocker> others_on(const TraceSlice& job, std::int64_t from, std::int64_t to) const {
    return meanwhile(from, to, [&](const TraceSlice& s) {
      return s.row == job.row && (s.name != job.name || key_of(s) != key_of(job));
    });
  }
  std::vector<Blocker> same_module(const TraceSlice& job, std::int64_t from,
                                   std::int64_t to) const {
    return meanwhile(from, to, [&](const TraceSlice& s) {
      return s.module == job.module && key_of(s) != key_of(job);
    });
  }
  /// Several rates: of a module of the chain, whose releases a number can tell apart.
  bool of_own_module(const TraceSlice& slice) const {
    return std::any_of(pieces_.begin(), pieces_.end(), [&](const auto& job) {
      return own_.contains(job.first.first) && job.second.front()->module == slice.module;
    });
  }

  /// How much of a job's absence it was being switched.
  std::int64_t switching(const TraceSlice& job, std::int64_t from, std::int64_t to) const {
    std::int64_t total = 0, until = from;
    for (const TraceSlice* slice : switches_) {
      if (slice->name != "switch: " + job.name || key_of(*slice) != key_of(job)) continue;
      const std::int64_t begin = std::max(until, us(slice->begin_ns));
      const std::int64_t end = std::min(to, us(slice->end_ns));
      if (end <= begin) continue;
      total += end - begin;
      until = end;
    }
    return total;
  }

  const ReadTrace& trace_;
  const TraceRelease& release_;
  const TraceChain* chain_;
  std::map<std::pair<Key, std::string>, Pieces> pieces_;  ///< of each job, by time
  std::set<Key> own_;                                     ///< of the jobs on the way
  Pieces switches_;
  std::map<std::string, Planned> planned_;
  std::int64_t cursor_ = 0;  ///< how far the latency is accounted for
};

std::vector<const TraceRelease*> by_latency(const std::vector<TraceRelease>& releases) {
  std::vector<const TraceRelease*> list;
  for (const TraceRelease& release : releases)
    if (release.latency_us >= 0) list.push_back(&release);
  std::stable_sort(list.begin(), list.end(), [](const TraceRelease* a, const TraceRelease* b) {
    return a->latency_us > b->latency_us;
  });
  return list;
}

/// With their shares, unless one alone had the whole time.
std::string names_of(const std::vector<Blocker>& list, std::int64_t whole) {
  std::string out;
  for (std::size_t i = 0; i < std::min(kMostNames, list.size()); ++i) {
    const Blocker& b = list[i];
    const bool all = list.size() == 1 && b.us >= whole - whole / 10;
    out += (out.empty() ? "" : ", ") + b.who + (all ? "" : " (" + in_ms(b.us) + ")");
  }
  if (list.size() > kMostNames) out += fmt::format(" and {} others", list.size() - kMostNames);
  return out;
}

}  // namespace

std::string in_ms(std::int64_t us) {
  return fmt::format("{:.3f}", static_cast<double>(us) / 1000);
}

const TraceRelease* worst_of(const std::vector<TraceRelease>& releases) {
  const auto list = by_latency(releases);
  return list.empty() ? nullptr : list.front();
}

const TraceRelease* median_of(const std::vector<TraceRelease>& releases) {
  const auto list = by_latency(releases);
  return list.empty() ? nullptr : list[list.size() / 2];
}

Result<Account> account_of(const ReadTrace& trace, std::int64_t release) {
  const std::string where = "release " + std::to_string(release);
  const auto at = std::find_if(trace.releases.begin(), trace.releases.end(),
                               [&](const TraceRelease& r) { return r.number == release; });
  if (at == trace.releases.end())
    return fail(ErrorCode::kNotFound, "is not in the trace", where,
                trace.releases.empty()
                    ? "there is no release in it"
                    : fmt::format("it has {} to {}", trace.releases.front().number,
                                  trace.releases.back().number));
  if (at->latency_us < 0)
    return fail(ErrorCode::kInfeasible,
                "has no latency: it was dropped, or its end is not in the trace", where);
  return Accountant(trace, *at, nullptr).settle();
}

Result<Account> account_of(const ReadTrace& trace, const TraceChain& chain,
                           const TraceRelease& result) {
  return Accountant(trace, result, &chain).settle();
}

std::string reasons_of(const ChainStep& step, std::int64_t least_us) {
  std::string out;
  const auto say = [&](const std::string& text) { out += (out.empty() ? "" : "; ") + text; };
  if (step.sensor_us >= least_us)
    say("needed a message that was released " + in_ms(step.sensor_us) + " ms later");
  else if (step.handover_us >= least_us)
    say(step.busy_with.empty() ? "ready " + in_ms(step.handover_us) + " ms after what it follows"
                               : "its module was busy for " + in_ms(step.handover_us) +
                                     " ms with " + names_of(step.busy_with, step.handover_us));
  if (step.held_us >= least_us) say("held for " + in_ms(step.held_us) + " ms by its policy");
  if (step.waited_us - step.held_us >= least_us)
    say(waited_text(step.waited_us - step.held_us, step.waited_for));
  if (step.suspended_us + step.switched_us >= least_us)
    say("off the XPU for " + in_ms(step.suspended_us + step.switched_us) + " ms" +
        (step.preempted_by.empty()
             ? ""
             : ", preempted by " + names_of(step.preempted_by, step.suspended_us)) +
        (step.switched_us >= least_us ? ", switching " + in_ms(step.switched_us) : ""));
  if (step.planned_us >= 0 && step.ran_us >= step.planned_us + least_us)
    say("ran " + in_ms(step.ran_us - step.planned_us) + " ms longer than planned" +
        (step.beside.empty() ? "" : ", beside " + names_of(step.beside, step.ran_us)));
  return out;
}

std::string waited_text(std::int64_t us, const std::vector<Blocker>& waited_for) {
  std::string text = "waited " + in_ms(us) + " ms";
  if (waited_for.empty()) return text + ", nobody had the XPU";
  std::int64_t had_us = 0;
  for (const Blocker& one : waited_for) had_us += one.us;
  text += " for " + names_of(waited_for, us);
  if (us - had_us >= kWorthSayingUs)
    text += "; for " + in_ms(us - had_us) + " ms of it nobody had the XPU";
  return text;
}

std::string account_text(const Account& account) {
  std::string out =
      fmt::format("{}release {} took {} ms, ", account.chain.empty() ? "" : account.chain + ": ",
                  account.release, in_ms(account.latency_us));
  if (account.rank == 1)
    out += fmt::format("the longest of {}", account.of);
  else
    out += fmt::format("number {} from the longest of {}", account.rank, account.of);
  out += fmt::format("; the median is {}{}.\n\n", in_ms(account.median_us),
                     account.planned_us < 0 ? "" : ", the plan " + in_ms(account.planned_us));
  std::size_t width = 12;
  for (const ChainStep& step : account.steps) width = std::max(width, step.xnode.size());
  out += fmt::format("  {:>9} {:>9} {:>9}   {:<{}} {:<8} why\n", "took ms", "ends at", "planned",
                     "step", width, "on");
  ChainStep sum;
  const ChainStep* latest = nullptr;
  std::int64_t late_before = 0, most = 0;
  for (const ChainStep& step : account.steps) {
    std::string why = reasons_of(step, kWorthSayingUs);
    if (why.empty()) why = "nothing but its work";
    out +=
        fmt::format("  {:>9} {:>9} {:>9}   {:<{}} {:<8} {}\n", in_ms(step.took_us()),
                    in_ms(step.end_us), step.planned_end_us < 0 ? "-" : in_ms(step.planned_end_us),
                    step.xnode, width, step.xpu, why);
    sum.handover_us += step.handover_us;
    sum.waited_us += step.waited_us;
    sum.ran_us += step.ran_us;
    sum.switched_us += step.switched_us;
    sum.suspended_us += step.suspended_us;
    if (step.planned_end_us < 0) continue;
    const std::int64_t late = step.end_us - step.planned_end_us;
    if (late - late_before > most) {
      most = late - late_before;
      latest = &step;
    }
    late_before = late;
  }
  out += fmt::format("  {:>9} {:>9} {:>9}   published\n  {:>9}   in all\n\n",
                     in_ms(account.publish_us), in_ms(account.latency_us), "",
                     in_ms(account.latency_us));
  out += fmt::format(
      "  Of it {} ms is work, {} waiting for an XPU, {} suspended, {} switching, {} handing "
      "over.\n",
      in_ms(sum.ran_us), in_ms(sum.waited_us), in_ms(sum.suspended_us), in_ms(sum.switched_us),
      in_ms(sum.handover_us + account.publish_us));
  if (latest != nullptr && most >= kWorthSayingUs)
    out += fmt::format("  It fell behind the plan most at {}: by {} ms.\n", latest->xnode,
                       in_ms(most));
  return out;
}

}  // namespace xauto::story
