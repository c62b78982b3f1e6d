// SPDX-License-Identifier: Apache-2.0
// An XNode's input is what the XNodes before it left, so the profiler runs the app as a whole: for
// each message of the input, every module in topological order, on one thread. In pass p each XNode
// runs on the p-th of its XPU instances; there are as many passes as the XNode with most instances
// has, and each pass replays the input from its start with fresh module states. Passes of the variants
// come after those: an XNode that is not timed runs its own implementation. Nothing else runs
// meanwhile; but on XPUs with levels all passes come again with less urgent XNodes beside each (below.h). With
// --contended all passes come again for each co-run class, beside its load (corun.h);
// with --audit each exec is followed by as long a time in which nothing runs (audit.h). The thread
// that asked for the profile watches: when it is told to stop, or when an exec takes too long, it
// answers with what there is, and the other thread is left behind.
#include "profile/profiler.h"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <future>
#include <map>
#include <memory>
#include <set>
#include <thread>
#include <tuple>

#include <malloc.h>
#include <sys/utsname.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/pi_mutex.h"
#include "base/rt.h"
#include "base/short_file.h"
#include "base/thread.h"
#include "graph/inlet.h"
#include "graph/input_access.h"
#include "model/fifo_range.h"
#include "model/json.h"
#include "processes/parameters.h"
#include "xpu/backend.h"
#include "xpu/callbacks.h"
#include "xpu/kind.h"
#include "xpu/levels.h"
#include "xpu/presence.h"

#include "profile/audit.h"
#include "profile/below.h"
#include "profile/corun.h"
#include "profile/lateness.h"
#include "profile/machine_readings.h"
#include "profile/profile_input.h"

namespace xauto::runtime {
namespace {

constexpr int kFifoProfile = 40;
constexpr auto kLookEvery = std::chrono::milliseconds(20);
constexpr int kLooksAfterStop = 10;  ///< for an exec that is about to return
/// With --stable: a time above twice the median that has not come back in so many rounds of
/// repetitions is an outlier.
constexpr std::uint64_t kSettledRounds = 3;

ProfileConditions conditions(const Session& session) {
  ProfileConditions c;
  utsname name{};
  uname(&name);
  c.machine = std::string(name.nodename) + " " + name.machine + " " + name.release;
  c.platform = session.platform.name;
  c.input = session.releases.input;
  c.warmup = static_cast<std::int64_t>(session.profile.warmup);
  c.repetitions = static_cast<std::int64_t>(session.profile.repetitions);
  std::ifstream(session.profile.machine_root +
                "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") >>
      c.governor;
  return c;
}

std::map<std::string, std::int64_t> in_flight_of(const Graph& graph) {
  std::map<std::string, std::int64_t> several;
  for (const Graph::Module& module : graph.modules)
    if (module.spec->in_flight > 1) several[module.name] = module.spec->in_flight;
  return several;
}

std::vector<std::string> optional_of(const Graph& graph) {
  std::vector<std::string> optional;
  for (const Graph::Module& module : graph.modules)
    if (module.spec->optional) optional.push_back(module.name);
  return optional;
}

/// The profile of nothing measured yet, without XNodes.
Profile graph_part(const Graph& graph) {
  Profile p;
  p.app = graph.name;
  p.sources = graph.sources;
  p.edges = graph.edges;
  p.sampled = graph.samples;
  p.in_flight = in_flight_of(graph);
  p.optional = optional_of(graph);
  p.asks = graph.asks;
  return p;
}

Profile skeleton_of(const Graph& graph) {
  Profile p = graph_part(graph);
  for (const Graph::Node& node : graph.nodes)
    p.xnodes.push_back(
        {node.name, graph.modules[static_cast<std::size_t>(node.module)].name, {}, node.sources});
  return p;
}

/// An XPU instance, and what an XNode has for its type.
struct Alternative {
  int xpu = -1;
  const detail::ImplSpec* impl = nullptr;
  bool operator<(const Alternative& other) const {
    return std::tie(xpu, impl) < std::tie(other.xpu, other.impl);
  }
};
using Alternatives = std::vector<Alternative>;

VariantProfile* find_variant(XNodeProfile& x, const std::string& name) {
  const auto at = std::find_if(x.variants.begin(), x.variants.end(),
                               [&](const VariantProfile& v) { return v.name == name; });
  return at == x.variants.end() ? nullptr : &*at;
}

class Run {
 public:
  Run(const detail::AppSpecErased& app, const Session& session, const Graph& graph)
      : app_(app),
        session_(session),
        graph_(graph),
        samples_(graph.nodes.size()),
        memory_kb_(graph.nodes.size()),
        machine_(session.profile.machine_root) {
    for (const Graph::Node& node : graph.nodes) {
      alternatives_.emplace_back();
      variants_.emplace_back();
      for (const detail::ImplSpec& impl : node.spec->impls)
        for (const int x : session.platform.instances_of(impl.xpu.type()))
          if (session.presence_of(x) != Presence::kAbsent)
            (impl.variant.empty() ? alternatives_ : variants_).back().push_back({x, &impl});
      // By XPU, whatever the order in which the app has added them.
      const auto by_xpu = [](const Alternative& a, const Alternative& b) { return a.xpu < b.xpu; };
      std::stable_sort(alternatives_.back().begin(), alternatives_.back().end(), by_xpu);
    }
  }

  Status run() {
    for (std::size_t n = 0; n < graph_.nodes.size(); ++n)
      if (alternatives_[n].empty())
        return fail(ErrorCode::kInfeasible,
                    "has no implementation for any XPU of platform '" + session_.platform.name +
                        "' that is here or emulated",
                    "XNode '" + graph_.nodes[n].name + "'");
    using Keep = detail::Inlet::Keep;
    inlets_.emplace(app_, session_.releases.input.empty() ? Keep::kNewest : Keep::kNone);
    XAUTO_TRY(detail::call(app_.on_start, "on_start", app_.name));
    cores_ = rt::allowed_cores();
    rt::set_timer_slack_1ns();
    if (!rt::set_fifo_up_to(kFifoProfile))
      log::warn("no permission for SCHED_FIFO: neighbours' work shows in the times; {}",
                rt::fifo_hint());
    XAUTO_TRY(leave_out_missing_cores());
    if (session_.profile.audit) XAUTO_TRY(prepare_audit());
    if (session_.profile.contended) corun_.emplace(session_, cores_);
    for (const std::string& beside : classes()) {
      if (!beside.empty() && !can_be_loaded(beside)) {
        note_class(beside);
        continue;
      }
      XAUTO_TRY(run_passes(alternatives_, beside));
      XAUTO_TRY(run_passes(variants_, beside));
      for (std::uint64_t round = 0; round < session_.profile.stable_rounds; ++round) {
        std::vector<Alternatives> again(alternatives_.size());
        if (!not_yet_stable(again, beside)) break;
        XAUTO_TRY(run_passes(again, beside));
      }
      if (!beside.empty()) note_class(beside);
    }
    return level_passes();
  }

  /// One release, then the XNodes on session.load.xpu again and again, as the words want it.
  Status load(const std::atomic<bool>& stop) {
    XAUTO_ASSIGN(LoadWords * words, map_load_words(session_.load.fd));
    inlets_.emplace(app_, session_.releases.input.empty() ? detail::Inlet::Keep::kNewest
                                                          : detail::Inlet::Keep::kNone);
    XAUTO_TRY(detail::call(app_.on_start, "on_start", app_.name));
    // The profiler has a priority and a core, which its children inherit.
    XAUTO_TRY(rt::set_other());
    cores_ = session_.load.cores;
    Placing placing;
    for (const Alternatives& all : alternatives_) {
      const auto there = std::find_if(all.begin(), all.end(), [&](const Alternative& one) {
        return one.xpu == session_.load.xpu;
      });
      placing.on.push_back(there != all.end() ? *there : all.front());
    }
    placing.counts.resize(alternatives_.size());
    XAUTO_ASSIGN(ProfileInput feed, ProfileInput::open(app_, graph_, session_, *inlets_));
    newest_.assign(graph_.topics.size(), nullptr);
    Messages messages(graph_.topics.size());
    XAUTO_ASSIGN(const bool any, feed.next(messages));
    if (!any) return fail(ErrorCode::kInvalid, "has no release", session_.releases.input);
    make_states();
    const auto run_one = [&](int m) { return run_module(m, placing, 0, messages); };
    for (const int m : graph_.module_order) XAUTO_TRY(run_one(m));
    placing.only = session_.load.xpu;
    std::vector<int> modules = graph_.module_order;
    std::erase_if(modules, [&](int m) {
      const std::vector<int>& nodes = graph_.modules[static_cast<std::size_t>(m)].nodes;
      return std::none_of(nodes.begin(), nodes.end(), [&](int n) {
        return placing.on[static_cast<std::size_t>(n)].xpu == placing.only;
      });
    });
    if (modules.empty())
      return fail(ErrorCode::kInternal, "the app has no XNode for " + xpu(placing.only).id);
    // From now on wherever nobody is in the way; prepare() has no further say in it.
    XAUTO_TRY(rt::pin_to_cores(cores_));
    core_now_ = cores_.front();
    return serve(
        *words,
        [&, next = std::size_t{0}]() mutable { return run_one(modules[next++ % modules.size()]); },
        stop);
  }

  /// Which alternatives have times that are not stable yet, into `again`. False: none.
  bool not_yet_stable(std::vector<Alternatives>& again, const std::string& beside) {
    bool any = false;
    const Guard lock(mutex_);
    for (std::size_t n = 0; n < again.size(); ++n)
      for (const auto& [where, taken] : samples_[n]) {
        const Samples s = summarise(taken.us, settled_after());
        if (where.beside != beside || !s.spread() || s.outlier) continue;
        again[n].push_back(where.at);
        any = true;
      }
    return any;
  }

  /// Before `run`.
  void set_parameters(std::vector<std::vector<ParameterValue>> values) {
    for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
      parameters_.push_back(detail::initial_of(graph_.modules[m].parameters));
      for (std::size_t p = 0; p < values[m].size(); ++p) parameters_[m][p].set(values[m][p]);
    }
  }

  /// Destroys what the inits have made, takes no message any more; on the thread of `run`.
  [[nodiscard]] Status release() {
    const bool started = inlets_.has_value();
    inlets_.reset();
    corun_.reset();
    active_.clear();
    return started ? detail::call(app_.on_stop, "on_stop", app_.name) : Status();
  }

  /// How late sources are released here. Any thread, before result().
  void set_jitter_us(std::int64_t us) {
    const Guard lock(mutex_);
    jitter_us_ = us;
  }

  /// `incomplete`: why it ended early. Any thread.
  Profile result(const std::string& incomplete) {
    const Guard lock(mutex_);
    closed_ = true;
    Profile p = graph_part(graph_);
    p.conditions = conditions(session_);
    p.conditions.readings = readings_;
    p.conditions.beside = beside_;
    p.conditions.not_beside = not_beside_;
    p.margin_pct = session_.profile.margin_pct;
    for (SourceSpec& source : p.sources)
      if (!source.pushed) source.jitter_us = jitter_us_;
    p.incomplete = incomplete;
    for (std::size_t n = 0; n < graph_.nodes.size(); ++n) {
      const Graph::Node& node = graph_.nodes[n];
      XNodeProfile x{
          node.name, graph_.modules[static_cast<std::size_t>(node.module)].name, {}, node.sources};
      for (const detail::ImplSpec& impl : node.spec->impls)
        if (!impl.variant.empty() && find_variant(x, impl.variant) == nullptr)
          x.variants.push_back({impl.variant, impl.quality_pct});
      for (const auto& [where, taken] : samples_[n]) {
        const std::string& variant = where.at.impl->variant;
        VariantProfile* of = variant.empty() ? nullptr : find_variant(x, variant);
        SamplesByXpu& on = where.beside.empty() ? (of == nullptr ? x.on : of->on)
                           : of == nullptr      ? x.beside[where.beside]
                                                : of->beside[where.beside];
        Samples& s = on[xpu(where.at.xpu).id];
        s = summarise(taken.us, settled_after());
        s.emulated = taken.emulated;
        p.conditions.emulated = p.conditions.emulated || s.emulated;
        if (const auto kb = memory_kb_[n].find(where.at);
            where.beside.empty() && kb != memory_kb_[n].end())
          s.memory_kb = kb->second;
        for (const auto& [other, pairs] : taken.others)
          s.others[xpu(other).id] = judged(taken, other);
      }
      for (const Alternative& at : alternatives_[n])
        if (!samples_[n].contains({"", at})) x.missing.push_back(xpu(at.xpu).id);
      p.xnodes.push_back(std::move(x));
    }
    return p;
  }

  /// "exec of XNode 'x' on gpu0", if that has taken longer than `limit_ns`. Any thread.
  [[nodiscard]] std::string takes_too_long(std::int64_t limit_ns) {
    const Guard lock(mutex_);
    return exec_since_ns_ != 0 && now_ns() - exec_since_ns_ > limit_ns ? exec_of_ : "";
  }

 private:
  /// Where an XNode is timed.
  struct Where {
    std::string beside;  ///< co-run class; "": alone
    Alternative at;
    bool operator<(const Where& other) const {
      return std::tie(beside, at) < std::tie(other.beside, other.at);
    }
  };
  /// What the XNodes of a release run on.
  struct Placing {
    Alternatives on;           ///< [node]
    std::vector<bool> counts;  ///< [node] whether it is timed, once it is warm
    std::string beside = {};   ///< as in Where
    bool above = false;        ///< each on the highest level, above another one
    int only = -1;  ///< only those on this XPU, on what the release before has left; -1: all
  };
  struct Taken {
    std::vector<std::int64_t> us;
    bool emulated = false;
    std::map<int, std::vector<BusyPair>> others = {};  ///< of an audit: XPU -> per repetition
  };

  [[nodiscard]] const Xpu& xpu(int x) const {
    return session_.platform.xpus[static_cast<std::size_t>(x)];
  }
  [[nodiscard]] std::int64_t settled_after() const {
    return session_.profile.stable_rounds == 0
               ? 0
               : static_cast<std::int64_t>(kSettledRounds * session_.profile.repetitions);
  }

  /// Whether anything of the class can be loaded beside any of the times taken alone.
  [[nodiscard]] bool can_be_loaded(const std::string& type) {
    std::set<int> real;
    std::vector<Corun::Stage> stages;
    {
      const Guard lock(mutex_);
      for (const auto& of_node : samples_)
        for (const auto& [where, taken] : of_node) {
          if (!taken.emulated) real.insert(where.at.xpu);
          stages.push_back({where.at.xpu, taken.emulated, cores_.front()});
        }
    }
    corun_->set_real(std::move(real));
    return std::any_of(stages.begin(), stages.end(),
                       [&](const Corun::Stage& stage) { return corun_->can_load(type, stage); });
  }

  [[nodiscard]] std::vector<std::string> classes() const {
    std::vector<std::string> classes = {""};
    if (!session_.profile.contended) return classes;
    for (const Xpu& x : session_.platform.xpus)
      if (std::find(classes.begin(), classes.end(), x.type) == classes.end())
        classes.push_back(x.type);
    if (classes.size() > 2) classes.emplace_back(kEveryType);
    return classes;
  }

  /// What was loaded in a class, or why nothing was.
  void note_class(const std::string& beside) {
    corun_->rest();
    const std::string what = corun_->what(beside), failure = corun_->failure(beside);
    const Guard lock(mutex_);
    if (!what.empty()) beside_[beside] = what;
    if (!failure.empty())
      not_beside_[beside] = failure;
    else if (what.empty())
      not_beside_[beside] = corun_->why_not(beside);
  }

  /// How many questions the audit asks, and so how many repetitions it takes. CPUs are shown and not
  /// judged: whoever waits for another XPU may keep a core busy.
  Status prepare_audit() {
    audit_.emplace(session_.platform, session_.presence, session_.profile.machine_root, cores_);
    bool any = false;
    std::size_t questions = 0;
    for (const std::vector<Alternatives>* all : {&alternatives_, &variants_})
      for (std::size_t n = 0; n < all->size(); ++n)
        for (const Alternative& at : (*all)[n]) {
          XAUTO_TRY(prepare(static_cast<int>(n), at));
          for (const int other : audit_->others(at.xpu, active_[static_cast<int>(n)].emulated)) {
            any = true;
            if (xpu(other).type != "cpu") ++questions;
          }
        }
    if (!any)
      return fail(ErrorCode::kUnavailable, "nothing tells how busy the XPUs are", "--audit",
                  "docs/modes.md says what is asked of drivers");
    if (const std::size_t needed = repetitions_needed(questions);
        session_.profile.repetitions < needed)
      return fail(ErrorCode::kInvalid,
                  std::to_string(session_.profile.repetitions) +
                      " repetitions cannot tell use from chance in " + std::to_string(questions) +
                      " pairs of an XNode and another XPU",
                  "--audit", "use --repetitions " + std::to_string(needed) + " or more");
    const Guard lock(mutex_);
    questions_ = questions;
    return {};
  }

  [[nodiscard]] OtherXpu judged(const Taken& taken, int other) const XAUTO_REQUIRES(mutex_) {
    std::int64_t sum_us = 0;
    for (const std::int64_t us : taken.us) sum_us += us;
    const auto mean_ns = sum_us * 1000 / static_cast<std::int64_t>(taken.us.size());
    OtherXpu judged = judge(taken.others.at(other), mean_ns, questions_);
    judged.used = judged.used && xpu(other).type != "cpu";
    return judged;
  }

  void look_at_machine() {
    machine_.look();
    std::vector<Reading> readings = machine_.taken();
    const Guard lock(mutex_);
    readings_ = std::move(readings);
  }

  /// Cores that this machine lacks are emulated, for stand-ins. An XNode that computes itself was
  /// not measured on the others to be measured on what is not there.
  Status leave_out_missing_cores() {
    const xpu::Hardware machine = xpu::Hardware::here();
    for (std::size_t n = 0; n < alternatives_.size(); ++n) {
      Alternatives& all = alternatives_[n];
      const auto either = std::find_if(all.begin(), all.end(), [&](const Alternative& at) {
        return xpu(at.xpu).type == "cpu" && session_.presence_of(at.xpu) == Presence::kEither;
      });
      if (either == all.end()) continue;
      XAUTO_TRY(prepare(static_cast<int>(n), *either));
      if (active_[static_cast<int>(n)].emulated) continue;
      const Guard lock(mutex_);
      for (Alternatives* of : {&all, &variants_[n]})
        std::erase_if(*of, [&](const Alternative& at) {
          return xpu(at.xpu).type == "cpu" &&
                 !machine.has(session_.platform, static_cast<std::size_t>(at.xpu));
        });
    }
    return {};
  }

  /// Each XNode as each of `all[node]`, one per pass; where that is none, as one of its own, for those
  /// behind it. `beside`: a co-run class; "": alone.
  Status run_passes(const std::vector<Alternatives>& all, const std::string& beside,
                    bool above = false) {
    std::size_t passes = 0;
    for (const Alternatives& of_node : all) passes = std::max(passes, of_node.size());
    const std::uint64_t repetitions = session_.profile.warmup + session_.profile.repetitions;
    const std::uint64_t total = passes * repetitions;
    std::uint64_t done = 0;
    std::int64_t told = now_ns();
    for (std::size_t pass = 0; pass < passes; ++pass) {
      look_at_machine();
      XAUTO_ASSIGN(ProfileInput feed, ProfileInput::open(app_, graph_, session_, *inlets_));
      newest_.assign(graph_.topics.size(), nullptr);
      make_states();
      Placing placing{{}, {}, beside, above};
      bound_.clear();
      bound_.resize(graph_.modules.size());
      for (std::size_t n = 0; n < all.size(); ++n) {
        // Each once: a later pass that comes round to it again adds nothing new.
        placing.counts.push_back(pass < all[n].size());
        placing.on.push_back(placing.counts[n] ? all[n][pass]
                                               : alternatives_[n][pass % alternatives_[n].size()]);
      }
      most_sets_ = 0;
      const auto enough = [&](std::uint64_t k) {  // also that each has met each of its sets
        return k >= repetitions && k >= session_.profile.warmup + most_sets_;
      };
      for (std::uint64_t k = 0; !enough(k); ++k, ++done) {
        Messages messages(graph_.topics.size());
        XAUTO_ASSIGN(const bool more, feed.next(messages));
        if (!more) {
          if (k > session_.profile.warmup)
            break;  // fewer repetitions than asked for; the profile says how many
          return fail(ErrorCode::kInvalid,
                      "ends after " + std::to_string(k) + " releases, within the warm-up",
                      session_.releases.input, "record more, or use fewer --warmup");
        }
        for (const int m : graph_.module_order) XAUTO_TRY(run_module(m, placing, k, messages));
        newest_ = std::move(messages);
        if (now_ns() - told > 1'000'000'000) {
          log::info("profile: {} of {} releases{}", done, total,
                    beside.empty()         ? ""
                    : beside == kEveryType ? ", beside all"
                                           : ", beside " + beside);
          look_at_machine();
          told = now_ns();
        }
      }
      look_at_machine();
    }
    return {};
  }

  /// For each type of XPU with levels, once more.
  Status level_passes() {
    std::set<std::string> types;
    for (const auto& [n, active] : active_)
      if (active.made.handle.kind() == SchedHandle::Kind::kLevels)
        types.insert(xpu(active.xpu).type);
    // What is measured is on the first core, and both wait for the XPU by looking again and again.
    std::vector<int> elsewhere(cores_.begin() + (cores_.size() > 1 ? 1 : 0), cores_.end());
    for (const std::string& type : types) {
      below_ = Below::on(elsewhere);
      XAUTO_TRY(run_passes(alternatives_, type, true));
      XAUTO_TRY(run_passes(variants_, type, true));
      below_.reset();
      const Guard lock(mutex_);
      std::string& what = beside_[type];
      what += std::string(what.empty() ? "" : "; ") +
              "XNodes of other modules on lower levels, each alone and several at a time";
    }
    return {};
  }

  /// What an XNode of a module hears.
  struct Bound {
    std::vector<detail::TopicSpec> topics;
    Input input = InputAccess::make();
  };

  /// What may run below `n`, on this XPU: XNodes of other modules, whose modules have heard something.
  [[nodiscard]] std::vector<std::vector<int>> sets_of(int n, int at) {
    const auto active = active_.find(n);
    if (active == active_.end() || active->second.made.handle.kind() != SchedHandle::Kind::kLevels)
      return {};
    const auto module_of = [&](int node) {
      return graph_.nodes[static_cast<std::size_t>(node)].module;
    };
    std::map<int, std::vector<int>> by_module;
    for (const auto& [other, there] : active_)
      if (module_of(other) != module_of(n) && there.xpu == at &&
          there.made.handle.kind() == SchedHandle::Kind::kLevels &&
          bound_[static_cast<std::size_t>(module_of(other))] != nullptr)
        by_module[module_of(other)].push_back(other);
    std::vector<std::vector<int>> others;
    for (auto& [module, nodes] : by_module) others.push_back(std::move(nodes));
    return sets_below(others, xpu::levels_of(xpu(at), false));
  }

  /// Has others run below `n`, on what their modules heard last, again and again: which. None: there are none.
  Result<std::vector<int>> begin_below(int n, const Alternative& as, std::uint64_t k) {
    const std::vector<std::vector<int>> sets = sets_of(n, as.xpu);
    most_sets_ = std::max(most_sets_, sets.size());
    if (sets.empty()) return std::vector<int>();
    XAUTO_TRY(active_[n].made.handle.callbacks()->take(xpu::levels_of(xpu(as.xpu), false) - 1));
    const std::vector<int>& set = sets[k % sets.size()];
    std::vector<std::function<Status()>> jobs;
    std::int64_t longest_ns = 0;
    for (const int other : set) {
      jobs.emplace_back(
          [this, other, level = static_cast<int>(jobs.size())] { return run_below(other, level); });
      longest_ns = std::max(longest_ns, usual_ns(other));
    }
    XAUTO_TRY(below_->begin(std::move(jobs)));
    // At several phases of theirs.
    sleep_until_ns(now_ns() + longest_ns * static_cast<std::int64_t>(k / sets.size() % 4) / 4);
    return set;
  }

  Status end_below(int n, const std::vector<int>& set) {
    XAUTO_TRY(below_->end());
    for (const int other : set) XAUTO_TRY(active_[other].made.handle.callbacks()->take(0));
    return active_[n].made.handle.callbacks()->take(0);
  }

  /// On a thread of below_'s.
  Status run_below(int n, int level) {
    const Graph::Node& node = graph_.nodes[static_cast<std::size_t>(n)];
    const auto module = static_cast<std::size_t>(node.module);
    const Active& active = active_.at(n);
    const std::string where =
        "exec of XNode '" + node.name + "' on " + xpu(active.xpu).id + ", below another one";
    XAUTO_TRY(active.made.handle.callbacks()->take(level));
    return exec_here(*active.impl, active, states_[module].get(), bound_[module]->input, where);
  }

  /// For a person.
  [[nodiscard]] std::string or_below(const std::vector<int>& set) const {
    std::string names;
    for (const int other : set)
      names += (names.empty() ? ", or of '" : " or '") +
               graph_.nodes[static_cast<std::size_t>(other)].name + "'";
    return names.empty() ? names : names + " below it,";
  }

  /// How long it takes; 0: it was not timed.
  [[nodiscard]] std::int64_t usual_ns(int n) {
    const Active& active = active_.at(n);
    const Guard lock(mutex_);
    const auto& of_node = samples_[static_cast<std::size_t>(n)];
    const auto at = of_node.find({"", {active.xpu, active.impl}});
    return at == of_node.end() || at->second.us.empty() ? 0 : at->second.us.back() * 1000;
  }

  void make_states() {
    states_.clear();
    for (const Graph::Module& module : graph_.modules) states_.push_back(module.spec->make_state());
  }

  Status run_module(int m, const Placing& placing, std::uint64_t k, Messages& messages) {
    const Graph::Module& module = graph_.modules[static_cast<std::size_t>(m)];
    void* const state = states_[static_cast<std::size_t>(m)].get();
    if (bound_.empty()) bound_.resize(graph_.modules.size());
    Bound& bound = *(bound_[static_cast<std::size_t>(m)] = std::make_unique<Bound>());
    bound.topics = module.spec->inputs;
    for (const detail::SampleSpec& sample : module.spec->samples)
      bound.topics.push_back(sample.topic);
    Input& input = bound.input;
    InputAccess::bind(input, &bound.topics, module.inputs.size());
    InputAccess::parameters(input) = parameters_[static_cast<std::size_t>(m)];
    InputAccess::stamp(input, now_ns(), k);
    InputAccess::begin(input, now_ns());
    for (std::size_t i = 0; i < module.inputs.size(); ++i) {
      const auto& message = messages[static_cast<std::size_t>(module.inputs[i])];
      InputAccess::messages(input)[i] = {message, now_ns(), k};
    }
    for (std::size_t i = 0; i < module.samples.size(); ++i) {
      const auto t = static_cast<std::size_t>(module.samples[i]);
      InputAccess::messages(input)[module.inputs.size() + i] = {
          messages[t] != nullptr ? messages[t] : newest_[t], now_ns(), k};
    }
    for (const int n : module.nodes) {
      const auto index = static_cast<std::size_t>(n);
      const Alternative& as = placing.on[index];
      const int at = as.xpu;
      if (placing.only >= 0 && at != placing.only) continue;
      XAUTO_TRY(prepare(n, as));
      const std::string where = "exec of XNode '" + graph_.nodes[index].name + "' on " + xpu(at).id;
      bool count = placing.counts[index];
      const bool emulated = active_[n].emulated;
      std::vector<int> below;
      if (count && placing.above) {
        XAUTO_ASSIGN(below, begin_below(n, as, k));
        count = !below.empty();
      } else if (count && !placing.beside.empty()) {
        count = corun_->beside(placing.beside, {at, emulated, core_now_});
      } else if (corun_) {
        corun_->rest();
      }
      if (audit_) XAUTO_TRY(audit_->begin(at, emulated));
      {
        const Guard lock(mutex_);
        exec_of_ = where + or_below(below);
        exec_since_ns_ = now_ns();
      }
      const std::int64_t before = now_ns();
      const Status ran = exec_here(*as.impl, active_[n], state, input, where);
      const std::int64_t us = (now_ns() - before + 999) / 1000;
      if (!below.empty()) XAUTO_TRY(end_below(n, below));
      XAUTO_TRY(ran);
      {
        const Guard lock(mutex_);
        exec_since_ns_ = 0;
      }
      std::map<int, BusyPair> others;
      if (audit_) {
        XAUTO_ASSIGN(others, audit_->end());
      }
      const Guard lock(mutex_);
      if (closed_) return fail(ErrorCode::kUnavailable, "stopped");
      if (k < session_.profile.warmup || !count) continue;
      Taken& taken = samples_[index][{placing.beside, as}];
      taken.us.push_back(us);
      taken.emulated = emulated;
      for (const auto& [other, pair] : others) taken.others[other].push_back(pair);
    }
    if (placing.only >= 0) return {};
    for (std::size_t i = 0; i < module.outputs.size(); ++i)
      messages[static_cast<std::size_t>(module.outputs[i])] =
          module.spec->outputs[i].take(state, nullptr);
    return {};
  }

  struct Active;
  /// What it throws is an error, too.
  static Status exec_here(const detail::ImplSpec& impl, const Active& active, void* state,
                          const Input& input, const std::string& where) {
    try {
      Status status = impl.exec(active.made.object.get(), state, input);
      if (status) return {};
      Error error = std::move(status).error();
      error.where = error.where.empty() ? where : where + ": " + error.where;
      return tl::unexpected<Error>(std::move(error));
    } catch (const std::exception& e) {
      return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
    } catch (...) {
      return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
    }
  }

  /// Resident memory before the first init of that kind; nullopt: it is known, or nobody tells.
  [[nodiscard]] std::optional<std::int64_t> memory_before(int n, const Alternative& as) {
    {
      const Guard lock(mutex_);
      if (memory_kb_[static_cast<std::size_t>(n)].contains(as)) return {};
    }
    // Free memory that the process has kept would be taken by init without being seen.
    malloc_trim(0);
    return resident_kb();
  }

  void take_memory(int n, const Alternative& as, std::int64_t before_kb) {
    const auto now_kb = resident_kb();
    if (!now_kb) return;
    const Guard lock(mutex_);
    memory_kb_[static_cast<std::size_t>(n)][as] =
        std::clamp<std::int64_t>(*now_kb - before_kb, 0, kMaxMemoryKb);
  }

  /// Initialises once per XNode and instance; moves this thread to the core of a real CPU.
  Status prepare(int n, const Alternative& as) {
    const Xpu& x = xpu(as.xpu);
    const Presence presence = session_.presence_of(as.xpu);
    const Graph::Node& node = graph_.nodes[static_cast<std::size_t>(n)];
    const XpuId id = xpu_id(session_.platform, as.xpu);
    // An XPU's host thread may run anywhere; a CPU XNode runs on the instance that is measured.
    const bool real_core = x.type == "cpu" && presence != Presence::kEmulated &&
                           id.index < static_cast<int>(cores_.size());
    const int core = real_core ? cores_[static_cast<std::size_t>(id.index)] : cores_.front();
    if (presence != Presence::kEmulated && core != core_now_) {
      XAUTO_TRY(rt::pin_to_core(core));
      core_now_ = core;
    }
    // A closure usually keeps the context that its last init made: coming back needs init again.
    const auto active = active_.find(n);
    if (states_.empty()) make_states();
    const std::shared_ptr<void>& state = states_[static_cast<std::size_t>(node.module)];
    if (active == active_.end() || active->second.xpu != as.xpu || active->second.impl != as.impl ||
        (as.impl->init_sees_state && active->second.state != state)) {
      const std::string where = "init of XNode '" + node.name + "' on " + x.id;
      active_.erase(n);  // its object goes before the next one comes
      detail::Made made;
      const auto before_kb = memory_before(n, as);
      const xpu::TellLevels tell(xpu::levels_of(x, presence == Presence::kEmulated));
      try {
        made.handle = as.impl->init(id, state.get(), made.object);
      } catch (const std::exception& e) {
        return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
      } catch (...) {
        return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
      }
      if (presence == Presence::kEmulated)
        if (Status emulated = xpu::check_emulated(made.handle); !emulated) {
          emulated.error().where = where;
          return tl::unexpected<Error>(emulated.error());
        }
      const bool emulated = made.handle.kind() == SchedHandle::Kind::kEmulated;
      if (before_kb && !emulated) take_memory(n, as, *before_kb);
      active_[n] = {as.xpu, as.impl, state, emulated, std::move(made)};
    }
    return {};
  }

  Messages newest_;  ///< [topic] of the release before, for what is sampled
  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph& graph_;
  std::vector<Alternatives> alternatives_, variants_;  ///< [node] its own; and not
  struct Active {
    int xpu = -1;
    const detail::ImplSpec* impl = nullptr;
    std::shared_ptr<void> state = nullptr;  ///< that its init was shown
    bool emulated = false;
    detail::Made made = {};
  };
  std::vector<std::shared_ptr<void>> states_;  ///< [module] of this pass
  std::map<int, Active> active_;               ///< node -> XPU it was last initialised for
  std::optional<detail::Inlets> inlets_;
  std::vector<std::vector<detail::ParameterNow>> parameters_;  ///< [module]
  std::vector<int> cores_;
  int core_now_ = -1;

  PiMutex mutex_;  ///< and of writing alternatives_ and variants_
  std::vector<std::map<Where, Taken>> samples_
      XAUTO_GUARDED_BY(mutex_);  ///< [node], in the order of the repetitions
  std::vector<std::map<Alternative, std::int64_t>> memory_kb_
      XAUTO_GUARDED_BY(mutex_);  ///< [node] that its init added
  std::string exec_of_ XAUTO_GUARDED_BY(mutex_);
  std::int64_t exec_since_ns_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< 0: none runs
  bool closed_ XAUTO_GUARDED_BY(mutex_) = false;             ///< the result was taken
  MachineReadings machine_;                                  ///< the thread of `run`
  std::optional<Corun> corun_;                               ///< with --contended; likewise
  std::optional<Audit> audit_;                               ///< with --audit; likewise
  std::unique_ptr<Below> below_;                             ///< on XPUs with levels; likewise
  std::size_t most_sets_ = 0;  ///< of what was below somebody in this pass; likewise
  std::vector<std::unique_ptr<Bound>> bound_;           ///< [module] of this release or the last
  std::size_t questions_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< of the audit
  using Texts = std::map<std::string, std::string, std::less<>>;
  Texts beside_ XAUTO_GUARDED_BY(mutex_), not_beside_ XAUTO_GUARDED_BY(mutex_);  ///< by class
  std::vector<Reading> readings_ XAUTO_GUARDED_BY(mutex_);
  std::int64_t jitter_us_ XAUTO_GUARDED_BY(mutex_) = 0;
};

/// A thread like the one that releases (its priority, its timers), beside all that is measured: how late does it wake?
class WakeUps {
 public:
  explicit WakeUps(std::int64_t shortest_us) : late_(shortest_us) {}
  [[nodiscard]] Status start() {
    XAUTO_ASSIGN(thread_, start_thread([this] {
                   rt::set_timer_slack_1ns();
                   if (const int fifo = FifoRange::within(rt::highest_fifo()).sources; fifo > 0)
                     (void)rt::set_fifo(fifo);
                   for (int i = 1; !stop_.load() && (i <= kJitterWakeUps || !enough_.load()); ++i) {
                     // From now on each time: one that comes late must not make the next ones late.
                     const std::int64_t due_ns = now_ns() + kEveryNs;
                     sleep_until_ns(due_ns);
                     late_.add(now_ns() - due_ns);
                   }
                 }));
    return {};
  }
  /// Once there were kJitterWakeUps. Says what is not in it.
  [[nodiscard]] std::int64_t jitter_us() {
    enough_ = true;
    thread_.join();
    if (late_.stalls() > 0)
      log::warn(
          "this machine stood still for up to {:.1f} ms, at {} of {} wake-ups: jitter_us ({} us) "
          "does not cover that. A run says how late its sources were; profile again where nothing "
          "else runs",
          static_cast<double>(late_.longest_stall_ns()) * 1e-6, late_.stalls(), late_.wake_ups(),
          late_.jitter_us());
    return late_.jitter_us();
  }
  ~WakeUps() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }

 private:
  static constexpr std::int64_t kEveryNs = 5'000'000;
  std::atomic<bool> stop_{false}, enough_{false};
  Lateness late_;
  std::thread thread_;
};

/// Of what is asked for at a rate.
std::int64_t shortest_period_us(const Profile& skeleton) {
  std::int64_t shortest = kMaxPeriodUs;
  for (const SourceSpec& source : skeleton.sources)
    if (!source.pushed) shortest = std::min(shortest, source.period.floor_us());
  return shortest;
}

}  // namespace

Result<Profiled> profile(const detail::AppSpecErased& app, const Session& session,
                         const std::atomic<bool>& stop) {
  struct Shared {
    Graph graph;
    Run run;
    std::promise<Status> ended;
    Shared(const detail::AppSpecErased& app, const Session& session, Graph built)
        : graph(std::move(built)), run(app, session, graph) {}
  };
  XAUTO_ASSIGN(Graph graph, Graph::build(app));
  XAUTO_TRY(can_be_planned(skeleton_of(graph)));
  XAUTO_ASSIGN(auto values, first_values(graph, session.deployment));
  // The thread may be left behind with it.
  auto shared = std::make_shared<Shared>(app, session, std::move(graph));
  shared->run.set_parameters(std::move(values));
  std::future<Status> ended = shared->ended.get_future();
  WakeUps wake_ups(shortest_period_us(skeleton_of(shared->graph)));
  XAUTO_TRY(wake_ups.start());
  // A thread of its own, so that the caller's priority and affinity stay as they are.
  XAUTO_ASSIGN(std::thread thread, start_thread([shared] {
                 Status status = shared->run.run();
                 Status released = shared->run.release();
                 if (status) status = std::move(released);
                 shared->ended.set_value(std::move(status));
               }));
  std::string incomplete;
  int looks_left = kLooksAfterStop;
  while (incomplete.empty() && ended.wait_for(kLookEvery) != std::future_status::ready) {
    if (stop.load() && --looks_left == 0) incomplete = "stopped by the user";
    if (const std::string exec =
            shared->run.takes_too_long(session.profile.exec_limit_s * 1'000'000'000);
        !exec.empty())
      incomplete =
          exec + " did not return within " + std::to_string(session.profile.exec_limit_s) + " s";
  }
  if (incomplete.empty()) {
    thread.join();
    XAUTO_TRY(ended.get());
    shared->run.set_jitter_us(wake_ups.jitter_us());
    return Profiled{to_json(shared->run.result({})), false};
  }
  thread.detach();
  return Profiled{to_json(shared->run.result(incomplete)), true};
}

Status load(const detail::AppSpecErased& app, const Session& session,
            const std::atomic<bool>& stop) {
  XAUTO_ASSIGN(const Graph graph, Graph::build(app));
  XAUTO_ASSIGN(auto values, first_values(graph, session.deployment));
  Run run(app, session, graph);
  run.set_parameters(std::move(values));
  Status done = run.load(stop);
  Status released = run.release();
  return done ? released : done;
}

Result<std::string> describe(const Graph& graph, const Platform& platform) {
  Profile p = skeleton_of(graph);
  p.conditions.platform = platform.name;
  return to_json(p);
}

}  // namespace xauto::runtime
