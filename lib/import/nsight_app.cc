// SPDX-License-Identifier: Apache-2.0
// NVTX ranges as XNodes.
//
// An outermost range is a module. Directly inside it are always the same ranges, in the same order: then these are its
// XNodes, and what is between them belongs to the next (the last one has what is behind it too):
//
//      frame |-------------------------------------|        module "frame"
//              |detect------|      |track------|            XNodes "frame.detect", "frame.track"
//      XNodes |<- detect -->|<-- track ----------->|
//
// Else the range is one XNode. An XNode's time is from its begin until it has ended and the last kernel, copy or DLA task
// has ended that was asked for in it. Not counted is the wait for others: while it was in a call that waits for the GPU,
// or had ended on its thread, and only others' work ran on its GPU.
#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "base/quantile.h"
#include "model/components.h"
#include "model/periodic.h"

#include "import/arrivals.h"
#include "import/intervals.h"
#include "import/nsight.h"
#include "import/questions.h"

namespace xauto::import {
namespace {

constexpr std::size_t kFewest = 3;  ///< times that a range comes, to be looked at
constexpr std::size_t kMaxStagesOfRange = 64;

std::string without_numbers(const std::string& name) {
  std::string made;
  for (const char c : name)
    if (c < '0' || c > '9')
      made += c;
    else if (made.empty() || made.back() != '#')
      made += '#';
  return made;
}

/// A stage of a range, once.
struct Piece {
  std::int64_t begin = 0, end = 0;  ///< on its thread
  std::vector<std::size_t> work;    ///< indices into NsightTrace::work
};

struct Instance {
  std::int64_t start = 0, end = 0, thread = 0;
  std::vector<std::pair<int, std::int64_t>> children;  ///< name and end, in their order
  std::vector<Piece> pieces;
};

class NsightImporter {
 public:
  NsightImporter(const NsightTrace& trace, const NsightOptions& options,
                 std::vector<std::string>& lines)
      : trace_(trace), options_(options), lines_(lines) {}

  Result<ImportedApp> run() {
    app().name = options_.name;
    out_.seen.from = options_.from;
    nest();
    find_stages();
    make_xnodes();
    if (app().xnodes.empty())
      return fail(ErrorCode::kInvalid, "no NVTX range came three times", options_.from,
                  "record while the program does its work");
    find_work();
    find_sources();
    settle_periods(app());
    complete_modules(app());
    measure();
    complete_chains(app());
    XAUTO_TRY(is_app(app(), "what was recorded", options_.from));
    ask();
    tell();
    return std::move(out_);
  }

 private:
  AppSpec& app() { return out_.app; }
  [[nodiscard]] const std::string& name_of(int name) const { return names_[at(name)]; }

  // ---- ranges -------------------------------------------------------------------------------------

  /// [range] its name as a number, with '#' for numbers where only that makes it come often; -1: it does not.
  std::vector<int> number_names() {
    std::map<std::string, std::size_t> as_it_is, plain;
    for (const NsightRange& r : trace_.ranges) {
      ++as_it_is[r.name];
      ++plain[without_numbers(r.name)];
    }
    std::map<std::string, int> numbers;
    std::set<std::string> rare;
    std::vector<int> of;
    for (const NsightRange& r : trace_.ranges) {
      std::string name = r.name;
      if (as_it_is[name] < kFewest) name = without_numbers(name);
      if (as_it_is[r.name] < kFewest && plain[name] < kFewest) {
        ++rare_;
        of.push_back(-1);
        continue;
      }
      const auto number = numbers.try_emplace(name, static_cast<int>(names_.size()));
      if (number.second) names_.push_back(name);
      of.push_back(number.first->second);
    }
    return of;
  }

  void nest() {
    const std::vector<int> name = number_names();
    std::map<std::int64_t, std::vector<std::size_t>> by_thread;
    for (std::size_t r = 0; r < name.size(); ++r)
      if (name[r] >= 0) by_thread[trace_.ranges[r].thread].push_back(r);
    for (auto& [thread, ranges] : by_thread) {
      std::ranges::stable_sort(ranges, {}, [&](std::size_t r) {
        return std::pair(trace_.ranges[r].start_ns, -trace_.ranges[r].end_ns);
      });
      nest_thread(ranges, name);
    }
  }

  void nest_thread(const std::vector<std::size_t>& ranges, const std::vector<int>& name) {
    std::vector<std::int64_t> open;  // ends, each at most the one before it
    for (const std::size_t r : ranges) {
      const NsightRange& range = trace_.ranges[r];
      while (!open.empty() && open.back() <= range.start_ns) open.pop_back();
      if (!open.empty() && range.end_ns > open.back()) {
        ++crossing_;
        continue;
      }
      open.push_back(range.end_ns);
      std::vector<std::pair<int, Instance>>& all = on_thread_[range.thread];
      if (open.size() == 1)
        all.push_back({name[r], {range.start_ns, range.end_ns, range.thread, {}, {}}});
      else if (open.size() == 2)
        all.back().second.children.emplace_back(name[r], range.end_ns);
      else
        ++deeper_;
    }
    for (auto& [outer, instance] : on_thread_[trace_.ranges[ranges.front()].thread])
      instances_[outer].push_back(&instance);
  }

  /// A range that is outermost fewer than three times is left out; of the others the stages.
  void find_stages() {
    for (auto& [name, all] : instances_) {
      std::ranges::stable_sort(all, {}, &Instance::start);
      std::vector<int> stages;
      for (const auto& [child, end] : all.front()->children) stages.push_back(child);
      const bool distinct = std::set<int>(stages.begin(), stages.end()).size() == stages.size();
      const bool same = std::ranges::all_of(all, [&](const Instance* one) {
        return std::ranges::equal(one->children, stages, {}, &std::pair<int, std::int64_t>::first);
      });
      const bool any =
          std::ranges::any_of(all, [](const Instance* i) { return !i->children.empty(); });
      if (!same || !distinct || stages.size() > kMaxStagesOfRange) {
        stages.clear();
        if (any) one_.insert(name);
      }
      for (Instance* one : all) {
        std::int64_t begin = one->start;
        for (std::size_t s = 0; s + 1 < stages.size(); ++s)
          one->pieces.push_back({std::exchange(begin, one->children[s].second), begin, {}});
        one->pieces.push_back({begin, one->end, {}});
      }
      stages_[name] = std::move(stages);
    }
  }

  // ---- what the XPUs did ----------------------------------------------------------------------------

  /// The piece during which a thread asked for something; null: none.
  Piece* piece_at(std::int64_t thread, std::int64_t when) {
    const auto on = on_thread_.find(thread);
    if (on == on_thread_.end()) return nullptr;
    auto after = std::ranges::upper_bound(on->second, when, {},
                                          [](const auto& one) { return one.second.start; });
    if (after == on->second.begin()) return nullptr;
    Instance& instance = (--after)->second;
    if (when > instance.end) return nullptr;
    for (Piece& piece : instance.pieces)
      if (when <= piece.end) return &piece;
    return nullptr;
  }

  void find_work() {
    // By process and correlation; a kernel whose table has no process is looked for in all of them.
    std::map<std::pair<std::int64_t, std::int64_t>, std::size_t> by_correlation;
    std::map<std::int64_t, std::size_t> of_any;
    for (std::size_t c = 0; c < trace_.calls.size(); ++c) {
      const NsightCall& call = trace_.calls[c];
      if (call.waits) waits_[call.thread].emplace_back(call.start_ns, call.end_ns);
      if (call.correlation == 0) continue;
      by_correlation.try_emplace({process_of(call.thread), call.correlation}, c);
      of_any.try_emplace(call.correlation, c);
    }
    std::map<std::int64_t, std::vector<Interval>> busy;
    for (std::size_t w = 0; w < trace_.work.size(); ++w) {
      const NsightWork& work = trace_.work[w];
      if (!work.dla) busy[work.device].emplace_back(work.start_ns, work.end_ns);
      Piece* piece = nullptr;
      const auto call = by_correlation.find({work.process, work.correlation});
      const auto any = of_any.find(work.correlation);
      if (call != by_correlation.end())
        piece = piece_at(trace_.calls[call->second].thread, trace_.calls[call->second].start_ns);
      else if (work.process < 0 && any != of_any.end())
        piece = piece_at(trace_.calls[any->second].thread, trace_.calls[any->second].start_ns);
      else if (work.correlation == 0 && work.thread != 0)
        piece = piece_at(work.thread, work.start_ns);
      if (piece != nullptr)
        piece->work.push_back(w);
      else
        outside_.at(work.dla ? 1 : 0).emplace_back(work.start_ns, work.end_ns);
    }
    for (auto& [device, intervals] : busy) busy_[device] = Intervals(std::move(intervals));
    for (auto& [thread, waits] : waits_) waits = Intervals(std::move(waits)).parts();
  }

  struct Timed {
    std::int64_t us = 0, busy_ns = 0;
    bool gpu = false, dla = false;
  };

  [[nodiscard]] Timed time_of(const Piece& piece, std::int64_t thread) const {
    Timed timed;
    std::int64_t end = piece.end;
    std::set<std::int64_t> devices;
    std::vector<Interval> own;
    for (const std::size_t w : piece.work) {
      const NsightWork& work = trace_.work[w];
      end = std::max(end, work.end_ns);
      own.emplace_back(work.start_ns, work.end_ns);
      (work.dla ? timed.dla : timed.gpu) = true;
      if (!work.dla) devices.insert(work.device);
    }
    const Intervals mine(std::move(own));
    timed.busy_ns = mine.length();
    std::int64_t waited = 0;
    // Of one that uses no GPU, or several, nothing is known of whom it waits for.
    if (devices.size() == 1) {
      const Intervals& all = busy_.at(*devices.begin());
      const auto others = [&](std::int64_t from, std::int64_t to) {
        return std::max<std::int64_t>(0, all.within(from, to) - mine.within(from, to));
      };
      const auto waits = waits_.find(thread);
      if (waits != waits_.end())
        for (auto w = std::ranges::upper_bound(waits->second, piece.begin, {}, &Interval::second);
             w != waits->second.end() && w->first < piece.end; ++w)
          waited += others(std::max(w->first, piece.begin), std::min(w->second, piece.end));
      waited += others(piece.end, end);
    }
    timed.us = std::clamp<std::int64_t>(up_to_us(end - piece.begin - waited), 1, kMaxTimeUs);
    return timed;
  }

  // ---- the app --------------------------------------------------------------------------------------

  std::string unique(const std::string& wanted) {
    std::string name = wanted;
    for (int n = 2; !used_.insert(name).second; ++n) name = wanted + "-" + std::to_string(n);
    return name;
  }

  void make_xnodes() {
    std::vector<int> by_start;
    for (const auto& [name, all] : instances_)
      if (all.size() >= kFewest)
        by_start.push_back(name);
      else
        rare_ += all.size();
    std::ranges::stable_sort(by_start, {},
                             [&](int name) { return instances_.at(name).front()->start; });
    for (const int name : by_start) {
      const std::vector<int>& stages = stages_.at(name);
      const std::size_t count = std::max<std::size_t>(1, stages.size());
      if (app().xnodes.size() + count > kMaxXNodes) break;
      const std::string module = unique(name_of(name));
      first_of_[name] = static_cast<int>(app().xnodes.size());
      for (std::size_t s = 0; s < count; ++s) {
        const std::string xnode =
            stages.empty() ? module : unique(bare(module + "." + name_of(stages[s])));
        if (s > 0)
          app().edges.emplace_back(static_cast<int>(app().xnodes.size()) - 1,
                                   static_cast<int>(app().xnodes.size()));
        app().xnodes.push_back({xnode, module, {{"cpu", 1}}});
        range_of_.emplace_back(name, s);
      }
      last_of_[name] = static_cast<int>(app().xnodes.size()) - 1;
    }
  }

  /// Ranges that their thread runs one after the other, again and again, fire each other.
  void find_followers() {
    std::map<int, std::set<std::int64_t>> threads;
    for (const auto& [thread, all] : on_thread_)
      for (const auto& [name, instance] : all) threads[name].insert(thread);
    for (const auto& [thread, all] : on_thread_) {
      std::vector<int> round, sequence;
      for (const auto& [name, instance] : all)
        if (first_of_.contains(name)) {
          sequence.push_back(name);
          if (std::ranges::find(round, name) == round.end()) round.push_back(name);
        }
      bool again = round.size() > 1;
      for (std::size_t n = 0; n < sequence.size() && again; ++n)
        again = sequence[n] == round[n % round.size()] && threads.at(sequence[n]).size() == 1;
      if (!again) continue;
      for (std::size_t n = 1; n < round.size(); ++n) {
        follows_[round[n]] = round[n - 1];
        app().edges.emplace_back(last_of_.at(round[n - 1]), first_of_.at(round[n]));
      }
    }
  }

  void find_sources() {
    find_followers();
    std::map<int, Grid> grids;
    std::vector<int> heads;
    for (const auto& [name, first] : first_of_) {
      if (follows_.contains(name)) continue;
      heads.push_back(name);
      std::vector<std::int64_t> starts;
      for (const Instance* one : instances_.at(name)) starts.push_back(one->start);
      if (auto grid = seen_grid(starts)) grids[name] = std::move(*grid);
    }
    app().one_at_a_time = grids.size() < heads.size();
    for (const int name : heads) {
      const int first = first_of_.at(name);
      const std::string source = app().xnodes[at(first)].module;
      app().xnodes[at(first)].sources = {static_cast<int>(app().sources.size())};
      SourceSpec made{source, kNoRate};
      if (!app().one_at_a_time) {
        const Grid& grid = grids.at(name);
        made.period = grid.period;
        made.clock = static_cast<int>(app().clocks.size());
        app().clocks.push_back({source, kDefaultPpm});
        std::int64_t latest = 0;
        const std::vector<Instance*>& all = instances_.at(name);
        for (std::size_t n = 0; n < all.size(); ++n)
          latest = std::max(
              latest, all[n]->start - grid.nominal_ns[static_cast<std::size_t>(grid.release[n])]);
        made.jitter_us = std::min(up_to_us(latest), kMaxPeriodUs);
      }
      app().sources.push_back(std::move(made));
    }
  }

  void measure() {
    std::int64_t first = INT64_MAX, last = INT64_MIN;
    out_.seen.xnodes.resize(app().xnodes.size());
    for (std::size_t x = 0; x < app().xnodes.size(); ++x) {
      const auto& [name, stage] = range_of_[x];
      std::vector<std::int64_t> times;
      double busy = 0, all = 0;
      std::size_t gpu = 0, dla = 0;
      for (const Instance* one : instances_.at(name)) {
        const Timed timed = time_of(one->pieces[stage], one->thread);
        times.push_back(timed.us);
        busy += static_cast<double>(timed.busy_ns) / 1000;
        all += static_cast<double>(timed.us);
        gpu += timed.gpu ? 1 : 0;
        dla += timed.dla ? 1 : 0;
        first = std::min(first, one->start);
        last = std::max(last, one->end);
      }
      put_times(x, std::move(times), gpu, dla, busy / all);
    }
    out_.seen.duration_us = std::clamp<std::int64_t>(up_to_us(last - first), 1, kMaxTimeUs);
    out_.seen.cores = std::clamp(static_cast<int>(on_thread_.size()), 1, kMaxSeenThreads);
  }

  void put_times(std::size_t x, std::vector<std::int64_t> times, std::size_t gpu, std::size_t dla,
                 double busy) {
    XNodeSpec& xnode = app().xnodes[x];
    const std::size_t count = times.size();
    const std::string type = dla > 0 ? "dla" : gpu > 0 ? "gpu" : "cpu";
    out_.seen.xnodes[x].times_us.assign(
        times.begin(), times.begin() + static_cast<std::ptrdiff_t>(std::min(count, kMaxSeenTimes)));
    load_.push_back(0);
    for (const std::int64_t us : times) load_.back() += static_cast<double>(us);
    std::ranges::sort(times);
    xnode.wcet_us = {{type, with_margin(times.back(), options_.margin_pct)}};
    xnode.typical_us = {{type, quantile_of_sorted(times, 0.5)}};
    lines_.push_back(fmt::format(
        "{} on {}: p50 {}, {}max {} us of {} ranges{}", xnode.name, type,
        quantile_of_sorted(times, 0.5),
        count < kLeastOfP99 ? "" : fmt::format("p99 {}, ", quantile_of_sorted(times, 0.99)),
        times.back(), count,
        type == "cpu"
            ? ""
            : fmt::format("; its work kept the {} busy for {:.0f} % of it", type, 100 * busy)));
    if (dla > 0 && gpu > 0)
      todo(out_, "",
           "'" + xnode.name + "' uses the GPU and a DLA: an XNode has one XPU; give each a range");
    else if (type != "cpu" && std::max(gpu, dla) < count)
      todo(out_, "",
           "'" + xnode.name + "' used the " + type + " in " + std::to_string(std::max(gpu, dla)) +
               " of " + counted(count, "range") + " only");
  }

  // ---- what is not known ----------------------------------------------------------------------------

  void ask() {
    std::size_t fewest = SIZE_MAX;
    for (const auto& [name, first] : first_of_)
      fewest = std::min(fewest, instances_.at(name).size());
    todo(out_, "",
         "WCETs are the longest times that were seen, of " + counted(fewest, "range") +
             " or more, beside all that ran: longer ones may come (--margin-pct)");
    if (app().one_at_a_time)
      for (std::size_t s = 0; s < std::min(app().sources.size(), kMostAsked); ++s)
        todo(out_, "/sources/" + std::to_string(s) + "/rate_hz",
             "how often does '" + app().sources[s].name + "' come, in Hz? its ranges show no rate");
    ask_deadlines(out_);
    ask_jitters(out_);
    if (app().sources.size() > 1)
      todo(out_, "",
           "which range fires which other one, or uses what it left? NVTX does not tell: see "
           "edges and samples");
    for (const auto& [name, before] : follows_)
      todo(out_, "",
           "'" + name_of(name) + "' comes behind '" + name_of(before) +
               "' on its thread each time: taken for an edge; does it need it?");
    for (const int name : one_)
      if (first_of_.contains(name))
        todo(out_, "",
             "'" + name_of(name) + "' has not the same ranges in it each time: it is one XNode");
    ask_other_xpus(out_, load_);
  }

  void tell() {
    lines_.push_back(counted(app().xnodes.size(), "XNode") + " of " +
                     counted(trace_.ranges.size(), "range") + ", " +
                     counted(app().sources.size(), "source") + ", " +
                     counted(app().edges.size(), "edge"));
    const auto left_out = [&](std::size_t count, const char* why) {
      if (count > 0) lines_.push_back("left out: " + counted(count, "range") + why);
    };
    left_out(rare_, " that came fewer than three times; what is inside them counts");
    left_out(crossing_, " that overlap another one of their thread, and are not inside it");
    left_out(deeper_, " that are further inside; their work is that of the XNode around them");
    for (const bool dla : {false, true})
      if (auto& outside = outside_.at(dla ? 1 : 0); !outside.empty()) {
        const std::size_t count = outside.size();
        lines_.push_back(std::string("left out: ") + (dla ? "DLA" : "GPU") + " work of no range, " +
                         counted(count, "time") + ", " +
                         std::to_string(up_to_us(Intervals(std::move(outside)).length())) + " us");
      }
    for (const std::string& note : trace_.notes) lines_.push_back(note);
  }

  const NsightTrace& trace_;
  const NsightOptions& options_;
  std::vector<std::string>& lines_;
  ImportedApp out_;
  std::vector<std::string> names_;
  /// Outermost ranges of a thread with their names, by start.
  std::map<std::int64_t, std::vector<std::pair<int, Instance>>> on_thread_;
  std::map<int, std::vector<Instance*>> instances_;    ///< [name]
  std::map<int, std::vector<int>> stages_;             ///< [name] names of what is inside each time
  std::set<int> one_;                                  ///< names of which that differs
  std::map<int, int> first_of_, last_of_;              ///< [name] XNode
  std::map<int, int> follows_;                         ///< [name] which one before it
  std::vector<std::pair<int, std::size_t>> range_of_;  ///< [xnode] name and stage
  std::map<std::int64_t, std::vector<Interval>> waits_;  ///< [thread] calls that wait, apart
  std::map<std::int64_t, Intervals> busy_;               ///< [device]
  std::array<std::vector<Interval>, 2> outside_;         ///< GPU, DLA: work of no range
  std::set<std::string> used_;
  std::vector<double> load_;  ///< [xnode] us
  std::size_t rare_ = 0, crossing_ = 0, deeper_ = 0;
};

}  // namespace

Result<ImportedApp> nsight_app(const NsightTrace& trace, const NsightOptions& options,
                               std::vector<std::string>& lines) {
  return NsightImporter(trace, options, lines).run();
}

}  // namespace xauto::import
