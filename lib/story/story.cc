// SPDX-License-Identifier: Apache-2.0
#include "story/story.h"

#include <algorithm>
#include <limits>
#include <map>
#include <optional>

namespace xauto::story {
namespace {

class Reader {
 public:
  Reader(const AppSpec& app, const Platform& platform, const std::vector<ModuleInfo>& modules)
      : app_(app),
        platform_(platform),
        modules_(modules),
        open_jobs_(app.xnodes.size()),
        open_activations_(modules.size()),
        open_ids_(modules.size(), -1) {}

  void take(const trace::Event& event) {
    if (!makes_sense(event)) {
      ++story_.lost;
      return;
    }
    const auto ts = static_cast<std::int64_t>(event.ts_ns);
    if (story_.begin_ns == 0) story_.begin_ns = ts;
    story_.end_ns = ts;
    switch (event.kind) {
      case XAUTO_EV_PUBLISH:
        story_.several_rates |= !published_.emplace(event.seq, story_.releases.size()).second;
        story_.releases.push_back({event.seq, ts, ts, Fate::kUnknown});
        break;
      case XAUTO_EV_ACTIVATE:
        leave(open_activations_[event.module], ts, Fate::kUnknown, 0);
        open_activations_[event.module] =
            Activation{event.module, event.seq, ts, ts, Fate::kUnknown, 0};
        open_ids_[event.module] = next_id_++;
        break;
      case XAUTO_EV_TAKE:
        take_input(event);
        break;
      case XAUTO_EV_MISS:
      case XAUTO_EV_HANG:
        story_.incidents.push_back(
            {ts, std::int64_t{event.arg} * (event.kind == XAUTO_EV_HANG ? 1000 : 1), event.module,
             event.kind == XAUTO_EV_HANG ? event.xnode : -1, event.seq});
        break;
      case XAUTO_EV_DONE:
      case XAUTO_EV_DROP:
        end_of_activation(event, ts);
        break;
      default:
        job_step(event, ts);
    }
  }

  Story finish() {
    for (auto& job : open_jobs_) close(job, story_.end_ns);
    for (auto& activation : open_activations_) leave(activation, story_.end_ns, Fate::kUnknown, 0);
    std::stable_sort(
        story_.jobs.begin(), story_.jobs.end(),
        [](const JobStory& a, const JobStory& b) { return a.begin_ns() < b.begin_ns(); });
    sort_activations();
    if (story_.several_rates)
      find_inputs();
    else
      end_releases();
    name_blockers();
    return std::move(story_);
  }

 private:
  bool makes_sense(const trace::Event& e) const {
    if (e.ts_ns == 0 || e.ts_ns > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2)
      return false;
    if (e.kind == XAUTO_EV_PUBLISH) return true;
    if (e.kind < XAUTO_EV_PUBLISH || e.kind > XAUTO_EV_HANG || e.module >= modules_.size())
      return false;
    if (e.kind == XAUTO_EV_TAKE) return (e.arg & XAUTO_TAKE_SOURCE) != 0 || e.arg < modules_.size();
    if (e.kind == XAUTO_EV_ACTIVATE || e.kind == XAUTO_EV_DONE || e.kind == XAUTO_EV_DROP ||
        e.kind == XAUTO_EV_MISS)
      return true;
    return e.xnode < app_.xnodes.size() && e.xpu < platform_.xpus.size() &&
           app_.xnodes[e.xnode].module == modules_[e.module].name;
  }

  void job_step(const trace::Event& e, std::int64_t ts) {
    std::optional<JobStory>& open = open_jobs_[e.xnode];
    const bool opens =
        e.kind == XAUTO_EV_READY || e.kind == XAUTO_EV_START || e.kind == XAUTO_EV_RUN;
    if (open && open->sequence != e.seq && opens) close(open, ts);
    if (!open && opens) {
      open = JobStory{e.xnode, e.module, e.xpu, e.seq, {}, false, false};
      if (const auto& activation = open_activations_[e.module];
          activation && activation->sequence == e.seq)
        open->activation = open_ids_[e.module];
      enter(*open, PhaseKind::kWaiting, ts);
    }
    // What comes after FINISH, or of another activation, belongs to a job that is over.
    if (!open || open->sequence != e.seq) return;
    open->xpu = e.xpu;
    switch (e.kind) {
      case XAUTO_EV_RUN:
      case XAUTO_EV_RESUMED:
        enter(*open, PhaseKind::kRunning, ts);
        break;
      case XAUTO_EV_SUSPEND:
      case XAUTO_EV_RESUME:
        enter(*open, PhaseKind::kSwitching, ts);
        break;
      case XAUTO_EV_SUSPENDED:
        enter(*open, PhaseKind::kSuspended, ts);
        break;
      case XAUTO_EV_FINISH:
        open->complete = true;
        open->failed = e.arg != 0;
        close(open, ts);
        break;
      default:
        break;
    }
  }

  static void enter(JobStory& job, PhaseKind kind, std::int64_t ts) {
    if (!job.phases.empty()) {
      if (job.phases.back().kind == kind) return;
      job.phases.back().end_ns = ts;
      if (job.phases.back().begin_ns == ts) job.phases.pop_back();
    }
    job.phases.push_back({kind, ts, ts, {}});
  }

  void close(std::optional<JobStory>& job, std::int64_t ts) {
    if (!job) return;
    job->phases.back().end_ns = ts;
    story_.jobs.push_back(std::move(*job));
    job.reset();
  }

  void leave(std::optional<Activation>& open, std::int64_t ts, Fate fate, std::uint32_t reason) {
    if (!open) return;
    open->end_ns = ts;
    open->fate = fate;
    open->reason = reason;
    ids_.push_back(open_ids_[static_cast<std::size_t>(open->module)]);
    story_.activations.push_back(std::move(*open));
    open.reset();
  }

  void take_input(const trace::Event& e) {
    std::optional<Activation>& open = open_activations_[e.module];
    if (!open || e.seq > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2) return;
    story_.several_rates = true;
    const bool source = (e.arg & XAUTO_TAKE_SOURCE) != 0;
    const auto index = static_cast<int>(e.arg & ~XAUTO_TAKE_SOURCE);
    open->takes.push_back(
        {source ? index : -1, source ? -1 : index, static_cast<std::int64_t>(e.seq), -1});
  }

  /// By begin; jobs then know theirs by index.
  void sort_activations() {
    std::vector<std::size_t> order(story_.activations.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return story_.activations[a].begin_ns < story_.activations[b].begin_ns;
    });
    std::vector<Activation> sorted;
    std::vector<int> index_of(static_cast<std::size_t>(next_id_), -1);
    for (const std::size_t i : order) {
      if (ids_[i] >= 0)
        index_of[static_cast<std::size_t>(ids_[i])] = static_cast<int>(sorted.size());
      sorted.push_back(std::move(story_.activations[i]));
    }
    story_.activations = std::move(sorted);
    for (JobStory& job : story_.jobs)
      if (job.activation >= 0) job.activation = index_of[static_cast<std::size_t>(job.activation)];
  }

  /// A source's message: the first release from its origin on. A module's: its last output of that
  /// origin before it was taken.
  void find_inputs() {
    std::vector<std::vector<int>> outputs(modules_.size());
    for (std::size_t a = 0; a < story_.activations.size(); ++a)
      if (story_.activations[a].fate == Fate::kDone)
        outputs[static_cast<std::size_t>(story_.activations[a].module)].push_back(
            static_cast<int>(a));
    const auto activation = [&](int i) -> Activation& {
      return story_.activations[static_cast<std::size_t>(i)];
    };
    for (Activation& taker : story_.activations)
      for (Take& take : taker.takes) {
        if (take.source >= 0) {
          const auto at = std::lower_bound(
              story_.releases.begin(), story_.releases.end(), take.origin_ns,
              [](const ReleaseSpan& r, std::int64_t ns) { return r.begin_ns < ns; });
          if (at != story_.releases.end() && at->begin_ns <= taker.begin_ns)
            take.from = static_cast<int>(at - story_.releases.begin());
          continue;
        }
        // A module has one activation at a time: its outputs come in the order of their begins.
        const auto& list = outputs[static_cast<std::size_t>(take.module)];
        auto at =
            std::upper_bound(list.begin(), list.end(), taker.begin_ns,
                             [&](std::int64_t ns, int a) { return ns < activation(a).end_ns; });
        constexpr int kMostWaiting = 1024;  // more than any queue holds
        for (int tried = 0; at != list.begin() && tried < kMostWaiting; ++tried)
          if (activation(*--at).origin_ns() == take.origin_ns) {
            take.from = *at;
            break;
          }
      }
  }

  void end_of_activation(const trace::Event& e, std::int64_t ts) {
    const Fate fate = e.kind == XAUTO_EV_DONE ? Fate::kDone : Fate::kDropped;
    std::optional<Activation>& open = open_activations_[e.module];
    if (open && open->sequence == e.seq) {
      leave(open, ts, fate, e.arg);
    } else {  // it never began, or its beginning was lost
      ids_.push_back(-1);
      story_.activations.push_back({e.module, e.seq, ts, ts, fate, e.arg});
    }
  }

  /// A release is over when every sink module is through with it.
  void end_releases() {
    const auto sinks = static_cast<std::size_t>(std::count_if(
        modules_.begin(), modules_.end(), [](const ModuleInfo& m) { return m.sink; }));
    std::vector<std::size_t> through(story_.releases.size(), 0);
    std::vector<bool> dropped(story_.releases.size(), false);
    for (const Activation& a : story_.activations) {
      const auto at = published_.find(a.sequence);
      if (at == published_.end() || !modules_[static_cast<std::size_t>(a.module)].sink ||
          a.fate == Fate::kUnknown)
        continue;
      ReleaseSpan& release = story_.releases[at->second];
      release.end_ns = std::max(release.end_ns, a.end_ns);
      dropped[at->second] = dropped[at->second] || a.fate == Fate::kDropped;
      if (++through[at->second] == sinks)
        release.fate = dropped[at->second] ? Fate::kDropped : Fate::kDone;
    }
  }

  /// Who ran on the XPU while a job waited for it or was suspended.
  void name_blockers() {
    struct Run {
      std::int64_t begin, end, latest_end;  ///< latest of all up to this one
      int xnode;
    };
    std::vector<std::vector<Run>> runs(platform_.xpus.size());
    for (const JobStory& job : story_.jobs)
      for (const Phase& phase : job.phases)
        if (phase.kind == PhaseKind::kRunning)
          runs[static_cast<std::size_t>(job.xpu)].push_back(
              {phase.begin_ns, phase.end_ns, 0, job.xnode});
    for (auto& list : runs) {
      std::sort(list.begin(), list.end(),
                [](const Run& a, const Run& b) { return a.begin < b.begin; });
      std::int64_t latest = 0;
      for (Run& run : list) run.latest_end = latest = std::max(latest, run.end);
    }
    for (JobStory& job : story_.jobs) {
      const auto& list = runs[static_cast<std::size_t>(job.xpu)];
      for (Phase& phase : job.phases) {
        if (phase.kind != PhaseKind::kWaiting && phase.kind != PhaseKind::kSuspended) continue;
        auto at = std::lower_bound(list.begin(), list.end(), phase.begin_ns,
                                   [](const Run& r, std::int64_t ts) { return r.begin < ts; });
        while (at != list.begin() && std::prev(at)->latest_end > phase.begin_ns) --at;
        for (; at != list.end() && at->begin < phase.end_ns; ++at)
          if (at->end > phase.begin_ns && at->xnode != job.xnode &&
              std::find(phase.by.begin(), phase.by.end(), at->xnode) == phase.by.end())
            phase.by.push_back(at->xnode);
      }
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const std::vector<ModuleInfo>& modules_;
  std::vector<std::optional<JobStory>> open_jobs_;
  std::vector<std::optional<Activation>> open_activations_;
  std::vector<int> open_ids_;  ///< of open_activations_, in the order of their begins
  std::vector<int> ids_;       ///< of Story::activations; -1: it never began
  int next_id_ = 0;
  std::map<std::uint64_t, std::size_t> published_;  ///< sequence -> index into releases
  Story story_;
};

}  // namespace

std::int64_t Activation::origin_ns() const {
  std::int64_t oldest = 0;
  for (const Take& take : takes)
    if (oldest == 0 || take.origin_ns < oldest) oldest = take.origin_ns;
  return oldest;
}

const char* to_string(PhaseKind kind) {
  switch (kind) {
    case PhaseKind::kWaiting:
      return "waiting";
    case PhaseKind::kRunning:
      return "running";
    case PhaseKind::kSwitching:
      return "switching";
    case PhaseKind::kSuspended:
      return "suspended";
  }
  return "?";
}

const char* drop_reason(std::uint32_t reason) {
  switch (reason) {
    case XAUTO_DROP_FAILED:
      return "an XNode failed";
    case XAUTO_DROP_UPSTREAM:
      return "an input was dropped upstream";
    case XAUTO_DROP_OVERRUN:
      return "a newer message replaced it";
    case XAUTO_DROP_HUNG:
      return "it ran past its hang limit";
    case XAUTO_DROP_DIED:
      return "the module's process died";
    default:
      return "for an unknown reason";
  }
}

Result<Story> story_of(const AppSpec& app, const Platform& platform,
                       const std::vector<ModuleInfo>& modules, const trace::Recording& trace) {
  Reader reader(app, platform, modules);
  for (const trace::Event& event : trace.events) reader.take(event);
  Story story = reader.finish();
  if (story.begin_ns == 0)
    return fail(ErrorCode::kUnavailable,
                trace.events.empty() ? "the run left no event"
                                     : "none of the run's " + std::to_string(trace.events.size()) +
                                           " events fits the app and the platform",
                "trace", "was the app linked against another version of XAuto?");
  story.lost += trace.lost;
  story.overwritten = trace.overwritten;
  return story;
}

std::vector<ModuleInfo> modules_of(const AppSpec& app, const trace::Recording& trace) {
  std::vector<ModuleInfo> modules;
  for (const trace::Event& e : trace.events) {
    if (e.module == XAUTO_EV_NONE) continue;
    if (e.module >= modules.size()) modules.resize(std::size_t{e.module} + 1);
    if (e.xnode < app.xnodes.size()) modules[e.module].name = app.xnodes[e.xnode].module;
  }
  for (ModuleInfo& module : modules)
    module.sink = std::none_of(app.edges.begin(), app.edges.end(), [&](const auto& edge) {
      const std::string& from = app.xnodes[static_cast<std::size_t>(edge.first)].module;
      return from == module.name &&
             app.xnodes[static_cast<std::size_t>(edge.second)].module != from;
    });
  return modules;
}

Overruns overruns_of(const AppSpec& app, const Platform& platform, const Story& story,
                     const std::vector<bool>& seen) {
  Overruns over;
  for (const JobStory& job : story.jobs) {
    const auto xpu = static_cast<std::size_t>(job.xpu);
    const auto wcet_us =
        app.xnodes[static_cast<std::size_t>(job.xnode)].wcet_on(platform.xpus[xpu].type);
    if (!job.complete || !wcet_us || !seen[xpu]) continue;
    std::int64_t ran_ns = 0;
    for (const Phase& phase : job.phases)
      if (phase.kind == PhaseKind::kRunning) ran_ns += phase.end_ns - phase.begin_ns;
    const std::int64_t over_us = ran_ns / 1000 - *wcet_us;
    if (over_us <= 0) continue;
    ++over.count;
    if (over_us > over.worst_us) {
      over.worst_us = over_us;
      over.worst = job.xnode;
    }
  }
  return over;
}

}  // namespace xauto::story
