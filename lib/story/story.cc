// SPDX-License-Identifier: Apache-2.0
#include "story/story.h"

#include <algorithm>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "model/components.h"

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
        most_open_(modules.size(), 1),
        read_(modules.size()),
        phase_ns_(modules.size(), 0) {
    for (std::size_t m = 0; m < modules.size(); ++m)
      for (const ModuleSpec& spec : app.modules)
        if (spec.name == modules[m].name)
          most_open_[m] = static_cast<std::size_t>(std::max<std::int64_t>(1, spec.max_in_flight));
    for (const auto& [u, v] : app.samples) readers_.insert(v);
    learn_phases();
  }

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
        publish(event, ts);
        break;
      case XAUTO_EV_ACTIVATE:
        activate(event, ts);
        break;
      case XAUTO_EV_TAKE:
        take_input(event);
        break;
      case XAUTO_EV_SAMPLE:
        take_sample(event, ts);
        break;
      case XAUTO_EV_HELD_UP:
        if (event.arg < app_.xnodes.size())
          story_.incidents.push_back(
              {ts, 0, event.module, event.xnode, event.seq, static_cast<int>(event.arg)});
        break;
      case XAUTO_EV_MISS:
      case XAUTO_EV_HANG:
        story_.incidents.push_back(
            {ts, std::int64_t{event.arg} * (event.kind == XAUTO_EV_HANG ? 1000 : 1), event.module,
             event.kind == XAUTO_EV_HANG ? event.xnode : -1, event.seq});
        break;
      case XAUTO_EV_SWITCH:
        story_.switches.push_back({ts, event.seq, static_cast<int>(event.arg & 0xffff),
                                   event.module, static_cast<Why>(std::min(event.arg >> 16, 255u)),
                                   event.xnode < app_.xnodes.size() ? event.xnode : -1});
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
    for (auto& open : open_jobs_)
      while (!open.empty()) close(open, open.begin(), story_.end_ns);
    for (auto& open : open_activations_)
      while (!open.empty()) leave(open, open.begin(), story_.end_ns, Fate::kUnknown, 0);
    std::stable_sort(
        story_.jobs.begin(), story_.jobs.end(),
        [](const JobStory& a, const JobStory& b) { return a.begin_ns() < b.begin_ns(); });
    sort_activations();
    story_.num_modules = modules_.size();
    find_inputs();
    find_urgent();
    find_samples();
    name_blockers();
    return std::move(story_);
  }

 private:
  /// With several activations of one module in flight each is found by its number.
  struct OpenActivation {
    Activation activation;
    int id = 0;  ///< in the order of their begins
  };
  using OpenActivations = std::vector<OpenActivation>;
  using OpenJobs = std::vector<JobStory>;

  /// How much later than its component's activation each source of a module releases.
  void learn_phases() {
    const auto parts = find_components(app_);
    if (!parts) return;
    for (std::size_t m = 0; m < modules_.size(); ++m)
      for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
        if (app_.xnodes[i].module == modules_[m].name)
          phase_ns_[m] = parts->components[static_cast<std::size_t>(parts->of[i])].offset_us * 1000;
  }

  bool makes_sense(const trace::Event& e) const {
    if (e.ts_ns == 0 || e.ts_ns > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2)
      return false;
    if (e.kind == XAUTO_EV_PUBLISH) return source_of(e.arg & ~XAUTO_RELEASE_URGENT) >= 0;
    if (e.kind == XAUTO_EV_SWITCH) return true;
    if (e.kind < XAUTO_EV_PUBLISH || e.kind > XAUTO_EV_NO_CORE || e.module >= modules_.size())
      return false;
    if (e.kind == XAUTO_EV_TAKE || e.kind == XAUTO_EV_SAMPLE)
      return source_of(e.arg & ~XAUTO_RELEASE_URGENT) >= 0 ||
             (e.arg & ~XAUTO_RELEASE_URGENT) < modules_.size();
    if (e.kind == XAUTO_EV_ACTIVATE || e.kind == XAUTO_EV_DONE || e.kind == XAUTO_EV_DROP ||
        e.kind == XAUTO_EV_MISS)
      return true;
    return e.xnode < app_.xnodes.size() && e.xpu < platform_.xpus.size() &&
           app_.xnodes[e.xnode].module == modules_[e.module].name;
  }

  /// -1: `arg` names no source. The number is that of app.json.
  [[nodiscard]] int source_of(std::uint32_t arg) const {
    const std::uint32_t index = arg & ~XAUTO_TAKE_SOURCE;
    return (arg & XAUTO_TAKE_SOURCE) != 0 && index < app_.sources.size() ? static_cast<int>(index)
                                                                         : -1;
  }

  void publish(const trace::Event& e, std::int64_t ts) {
    const int source = source_of(e.arg & ~XAUTO_RELEASE_URGENT);
    const auto& stated = app_.sources[static_cast<std::size_t>(source)].urgent;
    const bool urgent = stated && stated->marked_by.empty() && (e.arg & XAUTO_RELEASE_URGENT) != 0;
    story_.releases.push_back({e.seq, ts, source, urgent});
  }

  void activate(const trace::Event& e, std::int64_t ts) {
    OpenActivations& open = open_activations_[e.module];
    while (open.size() >= most_open_[e.module]) leave(open, open.begin(), ts, Fate::kUnknown, 0);
    open.push_back({Activation{e.module, e.seq, ts, ts, Fate::kUnknown, 0}, next_id_++});
  }

  static OpenActivations::iterator numbered(OpenActivations& open, std::uint64_t sequence) {
    return std::find_if(open.begin(), open.end(),
                        [&](const OpenActivation& o) { return o.activation.sequence == sequence; });
  }

  void job_step(const trace::Event& e, std::int64_t ts) {
    OpenJobs& open = open_jobs_[e.xnode];
    const auto find = [&] {
      return std::find_if(open.begin(), open.end(),
                          [&](const JobStory& job) { return job.sequence == e.seq; });
    };
    auto job = find();
    if (job == open.end() &&
        (e.kind == XAUTO_EV_READY || e.kind == XAUTO_EV_START || e.kind == XAUTO_EV_RUN)) {
      while (open.size() >= most_open_[e.module]) close(open, open.begin(), ts);
      JobStory& begun = open.emplace_back();
      begun.xnode = e.xnode;
      begun.module = e.module;
      begun.xpu = e.xpu;
      begun.sequence = e.seq;
      OpenActivations& activations = open_activations_[e.module];
      if (const auto activation = numbered(activations, e.seq); activation != activations.end())
        open.back().activation = activation->id;
      enter(open.back(), PhaseKind::kWaiting, ts);
      job = std::prev(open.end());
    }
    // What comes after FINISH, or of another activation, belongs to a job that is over.
    if (job == open.end()) return;
    job->xpu = e.xpu;
    switch (e.kind) {
      case XAUTO_EV_START:
        job->held_us = e.arg;
        break;
      case XAUTO_EV_NO_CORE:
        job->without_core_us = e.arg;
        break;
      case XAUTO_EV_RUN:
        give_samples(e);
        enter(*job, PhaseKind::kRunning, ts);
        break;
      case XAUTO_EV_RESUMED:
        enter(*job, PhaseKind::kRunning, ts);
        break;
      case XAUTO_EV_SUSPEND:
      case XAUTO_EV_RESUME:
        enter(*job, PhaseKind::kSwitching, ts);
        break;
      case XAUTO_EV_SUSPENDED:
        enter(*job, PhaseKind::kSuspended, ts);
        break;
      case XAUTO_EV_FINISH:
        job->complete = true;
        job->failed = e.arg != 0;
        close(open, job, ts);
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

  void close(OpenJobs& open, OpenJobs::iterator job, std::int64_t ts) {
    job->phases.back().end_ns = ts;
    story_.jobs.push_back(std::move(*job));
    open.erase(job);
  }

  void leave(OpenActivations& open, OpenActivations::iterator at, std::int64_t ts, Fate fate,
             std::uint32_t reason) {
    Activation& activation = at->activation;
    activation.end_ns = ts;
    activation.fate = fate;
    activation.reason = reason;
    ids_.push_back(at->id);
    story_.activations.push_back(std::move(activation));
    open.erase(at);
  }

  /// Told right after ACTIVATE.
  void take_input(const trace::Event& e) {
    OpenActivations& open = open_activations_[e.module];
    if (open.empty() || e.seq > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2) return;
    const std::uint32_t by = e.arg & ~XAUTO_RELEASE_URGENT;
    const int source = source_of(by);
    const auto origin_ns = static_cast<std::int64_t>(e.seq);
    Activation& activation = open.back().activation;
    activation.takes.push_back({source, source >= 0 ? -1 : static_cast<int>(by), origin_ns,
                                (e.arg & XAUTO_RELEASE_URGENT) != 0, -1});
    const std::int64_t later_ns =
        source < 0
            ? 0
            : app_.sources[static_cast<std::size_t>(source)].offset_us * 1000 - phase_ns_[e.module];
    if (activation.released_ns == 0 || origin_ns - later_ns < activation.released_ns)
      activation.released_ns = origin_ns - later_ns;
  }

  /// Told right before RUN of the module's first XNode, by the thread that runs it.
  void take_sample(const trace::Event& e, std::int64_t ts) {
    const int source = source_of(e.arg);
    const bool nothing = e.seq > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2;
    SampleRead read{source, source >= 0 ? -1 : static_cast<int>(e.arg), ts,
                    nothing ? -1 : static_cast<std::int64_t>(e.seq), -1};
    std::vector<SampleRead>& reads = read_[e.module];
    // One of an activation whose RUN was lost is replaced.
    std::erase_if(reads, [&](const SampleRead& r) {
      return r.source == read.source && r.module == read.module;
    });
    reads.push_back(read);
  }

  void give_samples(const trace::Event& e) {
    std::vector<SampleRead>& reads = read_[e.module];
    if (reads.empty() || (!readers_.empty() && !readers_.contains(e.xnode))) return;
    OpenActivations& open = open_activations_[e.module];
    if (const auto at = numbered(open, e.seq); at != open.end())
      at->activation.samples = std::move(reads);
    reads.clear();
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

  /// A source's message: its first release from its origin on. A module's: its last output of that
  /// origin before it was taken.
  void find_inputs() {
    const auto activation = [&](int i) -> Activation& {
      return story_.activations[static_cast<std::size_t>(i)];
    };
    std::vector<std::vector<int>> outputs(modules_.size());
    for (std::size_t a = 0; a < story_.activations.size(); ++a)
      if (story_.activations[a].fate == Fate::kDone)
        outputs[static_cast<std::size_t>(story_.activations[a].module)].push_back(
            static_cast<int>(a));
    for (std::vector<int>& list : outputs)
      std::stable_sort(list.begin(), list.end(),
                       [&](int a, int b) { return activation(a).end_ns < activation(b).end_ns; });
    for (Activation& taker : story_.activations)
      for (Take& take : taker.takes) {
        if (take.source >= 0) {
          auto at =
              std::lower_bound(story_.releases.begin(), story_.releases.end(), take.origin_ns,
                               [](const Release& r, std::int64_t ns) { return r.begin_ns < ns; });
          const auto first = at;
          while (at != story_.releases.end() && at->begin_ns == first->begin_ns &&
                 at->source != take.source)
            ++at;
          if (at != story_.releases.end() && at->begin_ns <= taker.begin_ns &&
              at->source == take.source)
            take.from = static_cast<int>(at - story_.releases.begin());
          continue;
        }
        const auto& list = outputs[static_cast<std::size_t>(take.module)];
        auto at =
            std::upper_bound(list.begin(), list.end(), taker.begin_ns,
                             [&](std::int64_t ns, int a) { return ns < activation(a).end_ns; });
        constexpr int kMostWaiting = 1024;  // more than any queue holds
        for (int tried = 0; at != list.begin() && tried < kMostWaiting; ++tried) {
          const Activation& from = activation(*--at);
          if ((from.released_ns > 0 ? from.released_ns : from.origin_ns()) != take.origin_ns)
            continue;
          take.from = *at;
          break;
        }
      }
  }

  /// By edges, from the releases on; who publishes began before whoever takes.
  void find_urgent() {
    for (Activation& taker : story_.activations)
      for (const Take& take : taker.takes) {
        if (take.from < 0) continue;
        const auto from = static_cast<std::size_t>(take.from);
        int source = take.source < 0                ? story_.activations[from].urgent_source
                     : story_.releases[from].urgent ? take.source
                                                    : -1;
        if (source < 0 && take.urgent && take.module >= 0) source = marked_by(take.module);
        taker.urgent_source = std::max(taker.urgent_source, source);  // a component has one
      }
  }
  /// The source of whose releases this module says which are urgent; -1: of none.
  [[nodiscard]] int marked_by(int module) const {
    const auto marks = [&](const SourceSpec& source) {
      return source.urgent &&
             source.urgent->marked_by == modules_[static_cast<std::size_t>(module)].name;
    };
    const auto at = std::ranges::find_if(app_.sources, marks);
    return at == app_.sources.end() ? -1 : static_cast<int>(at - app_.sources.begin());
  }

  /// By numbers: each module and each source counts its own.
  void find_samples() {
    std::map<std::pair<int, std::uint64_t>, int> outputs, releases;
    for (std::size_t a = 0; a < story_.activations.size(); ++a)
      if (const Activation& done = story_.activations[a]; done.fate == Fate::kDone)
        outputs[{done.module, done.sequence}] = static_cast<int>(a);
    for (std::size_t r = 0; r < story_.releases.size(); ++r)
      releases[{story_.releases[r].source, story_.releases[r].sequence}] = static_cast<int>(r);
    for (Activation& reader : story_.activations)
      for (SampleRead& read : reader.samples) {
        const bool source = read.source >= 0;
        const auto& known = source ? releases : outputs;
        const auto at = known.find(
            {source ? read.source : read.module, static_cast<std::uint64_t>(read.number)});
        if (read.number < 0 || at == known.end()) continue;
        const auto i = static_cast<std::size_t>(at->second);
        if ((source ? story_.releases[i].begin_ns : story_.activations[i].end_ns) <= read.read_ns)
          read.from = at->second;
      }
  }

  void end_of_activation(const trace::Event& e, std::int64_t ts) {
    const Fate fate = e.kind == XAUTO_EV_DONE ? Fate::kDone : Fate::kDropped;
    OpenActivations& open = open_activations_[e.module];
    if (const auto at = numbered(open, e.seq); at != open.end()) {
      leave(open, at, ts, fate, e.arg);
    } else {  // it never began, or its beginning was lost
      ids_.push_back(-1);
      story_.activations.push_back({e.module, e.seq, ts, ts, fate, e.arg});
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
  std::vector<OpenJobs> open_jobs_;                ///< [xnode], the oldest first
  std::vector<OpenActivations> open_activations_;  ///< [module], the oldest first
  std::vector<std::size_t> most_open_;             ///< [module] activations in flight
  std::vector<std::vector<SampleRead>> read_;      ///< [module] of the RUN that comes
  std::set<int> readers_;                          ///< XNodes that begin with a sample
  std::vector<std::int64_t> phase_ns_;             ///< [module] offset of its component
  std::vector<int> ids_;                           ///< of Story::activations; -1: it never began
  int next_id_ = 0;
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

bool Activation::left_out() const {
  return fate == Fate::kDropped && (reason == XAUTO_DROP_OFF || reason == XAUTO_DROP_SKIPPED);
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
    case XAUTO_DROP_OFF:
      return "the module is off";
    case XAUTO_DROP_SKIPPED:
      return "it was skipped, as was told, or a change of tables drained";
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

std::vector<ModuleInfo> modules_of(const AppSpec& app, const std::vector<std::string>& names) {
  std::vector<ModuleInfo> modules;
  for (const std::string& name : names)
    modules.push_back(
        {name, std::none_of(app.edges.begin(), app.edges.end(), [&](const auto& edge) {
           const std::string& from = app.xnodes[static_cast<std::size_t>(edge.first)].module;
           return from == name && app.xnodes[static_cast<std::size_t>(edge.second)].module != from;
         })});
  return modules;
}

}  // namespace xauto::story
