// SPDX-License-Identifier: Apache-2.0
// Flows: one arrow per edge inside a module and activation, from the last slice of the XNode that
// hands over to the first of the one that takes, so that a viewer follows what really waited for
// what. Numbers of releases mean nothing across modules: an activation's arrows come from what it
// took. A trace that does not tell what it took has arrows inside modules only.
#include "story/run_trace.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "base/fnv.h"
#include "story/job_tracks.h"
#include "story/lanes.h"
#include "story/perfetto.h"

namespace xauto::story {
namespace {

using Track = PerfettoWriter::Track;
using Details = PerfettoWriter::Details;

/// Puts slices on one track so that they nest whatever their times are: a child is cut to its
/// parent, a slice to the next one of its depth. A switch that began before the next job was let on
/// goes on inside that one. Slices come by begin, parents first.
class Nest {
 public:
  Nest(PerfettoWriter& out, Track track) : out_(out), track_(track) {}
  ~Nest() { leave(0, stack_.empty() ? 0 : stack_.front().end); }
  Nest(const Nest&) = delete;
  Nest& operator=(const Nest&) = delete;

  void add(int depth, std::int64_t begin, std::int64_t end, const std::string& name,
           Details details = {}) {
    begin = std::max(begin, last_);
    leave(depth, begin);
    std::optional<Switch> rest = std::exchange(switch_, std::nullopt);
    if (depth > 0 && stack_.empty() && details.category == "switch")
      switch_ = Switch{end, name, details};
    if (!stack_.empty()) end = std::min(end, stack_.back().end);
    end = std::max(begin, end);
    out_.begin(track_, begin, name, std::move(details));
    stack_.push_back({depth, end});
    last_ = begin;
    if (rest && depth == 0 && rest->end > begin)
      add(1, begin, rest->end, rest->name, std::move(rest->details));
  }

  void instant(std::int64_t ts, const std::string& name, Details details = {}) {
    ts = std::max(ts, last_);
    out_.instant(track_, ts, name, std::move(details));
    last_ = ts;
  }

 private:
  struct Open {
    int depth;
    std::int64_t end;
  };
  struct Switch {  ///< the last slice, if it is a switch in no job
    std::int64_t end;
    std::string name;
    Details details;
  };
  void leave(int depth, std::int64_t now) {
    while (!stack_.empty() && (stack_.back().depth >= depth || stack_.back().end <= now)) {
      last_ = std::max(last_, std::min(stack_.back().end, now));
      out_.end(track_, last_);
      stack_.pop_back();
    }
  }
  PerfettoWriter& out_;
  Track track_;
  std::vector<Open> stack_;
  std::optional<Switch> switch_;
  std::int64_t last_ = 0;
};

/// A stretch of time on an XPU's row.
struct Piece {
  int row = -1;
  std::int64_t begin = 0, end = 0;
  std::string name;
  Details details;
  int lane = 0;
};

class Painter {
 public:
  Painter(const AppSpec& app, const Scene& scene, const Story& story)
      : app_(app), scene_(scene), story_(story), out_(scene.group) {}

  std::string paint(std::int64_t clock_offset_ns) {
    root_ = out_.add_track(PerfettoWriter::kNoParent, scene_.title, scene_.note);
    if (story_.lost > 0) {
      out_.mark_lossy();
      out_.instant(root_, story_.begin_ns,
                   fmt::format("INCOMPLETE: {} events were lost", story_.lost),
                   {"loss", {}, {}, {}});
    }
    if (story_.overwritten > 0) {
      out_.mark_lossy();
      out_.instant(root_, story_.begin_ns,
                   fmt::format("the trace holds from here on: {} older events were dropped",
                               story_.overwritten),
                   {"loss", {}, {}, {}});
    }
    for (const Incident& incident : story_.incidents) paint_incident(incident);
    paint_switches();
    collect_run();
    connect();
    paint_releases();
    paint_chains(out_, root_, app_, scene_, story_);
    paint_samples(out_, root_, app_, scene_, story_, std::move(samples_));
    paint_rows();
    paint_modules();
    paint_results();
    paint_counters();
    return out_.write(clock_offset_ns);
  }

 private:
  void paint_incident(const Incident& incident) {
    const double ms = static_cast<double>(incident.took_us) / 1000;
    const std::string text =
        incident.waits >= 0 ? fmt::format("{} was suspended while {} waits for its work",
                                          name(incident.xnode), name(incident.waits))
        : incident.xnode >= 0
            ? fmt::format("{} ran past its hang limit of {:.0f} ms", name(incident.xnode), ms)
            : fmt::format("release {} missed its deadline: {:.2f} ms", incident.sequence, ms);
    out_.instant(root_, incident.at_ns, text, {"incident", {}, {}, {}});
  }

  void paint_switches() {
    if (scene_.tables == nullptr || (story_.switches.empty() && scene_.scenarios.empty())) return;
    const auto name_in = [](const auto& list, int at) {
      const auto i = static_cast<std::size_t>(at);
      return i < list.size() ? list[i].name : std::string("?");
    };
    const Track track = out_.add_track(root_, "tables", scene_.verdict);
    for (const ScenarioInfo& s : scene_.scenarios) paint_scenario(track, s);
    // The run begins under the first one. A trace that does not reach back to that does not tell.
    std::string from =
        story_.overwritten + story_.lost == 0 ? name_in(scene_.tables->scenarios, 0) : "?";
    for (const SwitchStory& s : story_.switches) {
      const std::string to = name_in(scene_.tables->scenarios, s.scenario),
                        table = name_in(scene_.tables->tables, s.table);
      const ChangeInfo* told = told_of(s, to);
      if (told != nullptr) from = told->from;
      const std::string why =
          std::string(to_string(s.why)) + (s.xnode < 0 ? "" : ": " + name(s.xnode));
      Details details{"table",
                      {{"release", static_cast<std::int64_t>(s.release)},
                       {"from", from},
                       {"to", to},
                       {"table", table},
                       {"why", why}},
                      {},
                      {}};
      if (told != nullptr && told->spanned_us >= 0) {
        if (!told->chain.empty()) details.args.emplace_back("chain", told->chain);
        details.args.emplace_back("spanned_us", told->spanned_us);
      }
      if (told != nullptr && told->worst_case_us >= 0)
        details.args.emplace_back("worst_case_us", told->worst_case_us);
      out_.instant(track, s.at_ns,
                   fmt::format("'{}' -> '{}', table '{}' ({})", from, to, table, why),
                   std::move(details));
      from = to;
    }
  }

  /// What the report says of it; null: nothing.
  const ChangeInfo* told_of(const SwitchStory& s, const std::string& to) const {
    const auto at = std::find_if(
        scene_.changes.begin(), scene_.changes.end(),
        [&](const ChangeInfo& change) { return change.release == s.release && change.to == to; });
    return at == scene_.changes.end() ? nullptr : &*at;
  }

  /// Of the whole run, where its trace begins.
  void paint_scenario(Track track, const ScenarioInfo& s) {
    Details details{"scenario",
                    {{"scenario", s.name},
                     {"table", s.table},
                     {"releases", static_cast<std::int64_t>(s.releases)}},
                    {},
                    {}};
    out_.instant(track, story_.begin_ns, fmt::format("scenario '{}', table '{}'", s.name, s.table),
                 std::move(details));
  }

  const std::string& name(int xnode) const {
    return app_.xnodes[static_cast<std::size_t>(xnode)].name;
  }
  std::string names(const std::vector<int>& xnodes) const {
    std::string out;
    for (const int xnode : xnodes) out += (out.empty() ? "" : ", ") + name(xnode);
    return out;
  }
  int row_of(int xpu) const { return scene_.row_of[static_cast<std::size_t>(xpu)]; }

  /// What each job did on its XPU; where its first and last pieces are, for the arrows.
  void collect_run() {
    first_.assign(story_.jobs.size(), -1);
    last_ = first_;
    for (std::size_t j = 0; j < story_.jobs.size(); ++j) {
      const JobStory& job = story_.jobs[j];
      std::int64_t waited_ns = 0;
      int part = 0;
      std::string waited_for;
      for (std::size_t p = 0; p < job.phases.size(); ++p) {
        const Phase& phase = job.phases[p];
        if (phase.kind == PhaseKind::kWaiting || phase.kind == PhaseKind::kSuspended) {
          waited_ns += phase.end_ns - phase.begin_ns;
          waited_for = names(phase.by);
          continue;
        }
        const bool runs = phase.kind == PhaseKind::kRunning;
        Piece piece{row_of(job.xpu),
                    phase.begin_ns,
                    phase.end_ns,
                    runs ? name(job.xnode) : "switch: " + name(job.xnode),
                    {},
                    0};
        piece.details.category = runs ? "run" : "switch";
        auto& args = piece.details.args;
        args.emplace_back("release", static_cast<std::int64_t>(job.sequence));
        if (job.activation >= 0)
          args.emplace_back("activation", static_cast<std::int64_t>(job.activation));
        args.emplace_back("module", app_.xnodes[static_cast<std::size_t>(job.xnode)].module);
        if (runs) {
          if (!scene_.priorities.empty())
            args.emplace_back("priority", scene_.priorities[static_cast<std::size_t>(job.xnode)]);
          args.emplace_back("part", static_cast<std::int64_t>(++part));
          args.emplace_back("waited_us", waited_ns / 1000);
          if (part == 1 && job.held_us > 0)
            args.emplace_back("held_us", std::min(job.held_us, waited_ns / 1000));
          if (!waited_for.empty())
            args.emplace_back(part == 1 ? "waited_for" : "preempted_by", waited_for);
          if (job.failed) args.emplace_back("failed", std::int64_t{1});
          if (!job.complete) args.emplace_back("incomplete", std::int64_t{1});
          if (first_[j] < 0) first_[j] = static_cast<int>(run_.size());
          last_[j] = static_cast<int>(run_.size());
        }
        run_.push_back(std::move(piece));
      }
      if (first_[j] >= 0 && job.without_core_us > 0)
        last_piece(j)->args.emplace_back("without_core_us", job.without_core_us);
      if (scene_.keys == nullptr || first_[j] < 0) continue;
      const auto window = window_of(app_, *scene_.keys, story_, job);
      if (!window) continue;
      tell_window(*window, begin_of(first_[j]), *first_piece(j));
      if (job.complete) tell_lateness(*window, job.end_ns(), *last_piece(j));
    }
  }

  /// Never back in time, whatever a damaged trace says: viewers take the earlier end for the
  /// source.
  void arrow(Details& from, Details& to, bool forward) {
    if (!forward) return;
    from.flows_out.push_back(++flows_);
    to.flows_in.push_back(flows_);
  }
  Details* first_piece(std::size_t job) {
    return first_[job] < 0 ? nullptr : &run_[static_cast<std::size_t>(first_[job])].details;
  }
  Details* last_piece(std::size_t job) {
    return last_[job] < 0 ? nullptr : &run_[static_cast<std::size_t>(last_[job])].details;
  }

  std::int64_t begin_of(int piece) const { return run_[static_cast<std::size_t>(piece)].begin; }

  /// Which jobs belong together: of one activation, as far as that is known.
  [[nodiscard]] static std::int64_t key_of(const JobStory& job) {
    return job.activation >= 0 ? job.activation : static_cast<std::int64_t>(job.sequence);
  }
  [[nodiscard]] const std::vector<Take>& takes_of(int activation) const {
    static const std::vector<Take> kNone;
    return activation < 0 ? kNone : story_.activations[static_cast<std::size_t>(activation)].takes;
  }

  void connect() {
    releases_.resize(story_.releases.size());
    activations_.resize(story_.activations.size());
    results_.resize(story_.activations.size());
    samples_.resize(story_.activations.size());
    std::map<std::pair<int, std::int64_t>, std::size_t> job_of;  // (XNode, key)
    for (std::size_t j = 0; j < story_.jobs.size(); ++j)
      job_of.try_emplace({story_.jobs[j].xnode, key_of(story_.jobs[j])}, j);
    std::vector<int> first_job(story_.activations.size(), -1), last_job = first_job;
    for (std::size_t j = 0; j < story_.jobs.size(); ++j)
      if (const int a = story_.jobs[j].activation; a >= 0 && last_piece(j) != nullptr) {
        last_job[static_cast<std::size_t>(a)] = static_cast<int>(j);
        int& first = first_job[static_cast<std::size_t>(a)];
        if (first < 0) first = static_cast<int>(j);
      }
    connect_samples(first_job, last_job);
    if (!scene_.elsewhere.empty()) connect_hosts(last_job);

    const auto predecessors = app_.predecessors();
    const auto successors = app_.successors();
    const auto within = [&](int u, int v) {
      return app_.xnodes[static_cast<std::size_t>(u)].module ==
             app_.xnodes[static_cast<std::size_t>(v)].module;
    };
    for (std::size_t j = 0; j < story_.jobs.size(); ++j) {
      const JobStory& job = story_.jobs[j];
      Details* first = first_piece(j);
      if (first == nullptr) continue;
      bool from_somewhere = false;
      for (const int u : predecessors[static_cast<std::size_t>(job.xnode)]) {
        if (!within(u, job.xnode)) continue;
        from_somewhere = true;
        const auto at = job_of.find({u, key_of(job)});
        if (at == job_of.end() || last_piece(at->second) == nullptr) continue;
        arrow(*last_piece(at->second), *first, begin_of(last_[at->second]) < begin_of(first_[j]));
      }
      const int own = job.activation;
      const std::vector<Take>& takes = takes_of(own);
      std::string messages;   // of other hosts
      if (!from_somewhere) {  // its origin
        for (const Take& take : takes) {
          connect_take(take, last_job, *first, begin_of(first_[j]));
          if (!elsewhere(take.module)) continue;
          first->across_in.push_back(
              across(take.module, job.module, static_cast<std::int64_t>(job.sequence)));
          messages += (messages.empty() ? "" : "; ") + message_to(job, take.module);
        }
        if (!messages.empty()) first->args.emplace_back("messages", std::move(messages));
        if (takes.empty() && own >= 0)
          arrow(activations_[static_cast<std::size_t>(own)], *first,
                story_.activations[static_cast<std::size_t>(own)].begin_ns < begin_of(first_[j]));
      }
      const auto& next = successors[static_cast<std::size_t>(job.xnode)];
      const bool ends =
          std::none_of(next.begin(), next.end(), [&](int v) { return within(job.xnode, v); });
      if (!ends || own < 0) continue;
      const Activation& activation = story_.activations[static_cast<std::size_t>(own)];
      const bool output =
          takes.empty() || scene_.modules[static_cast<std::size_t>(activation.module)].sink;
      if (output && activation.fate == Fate::kDone)
        arrow(*last_piece(j), results_[static_cast<std::size_t>(own)],
              begin_of(last_[j]) <= activation.end_ns);
    }
  }

  [[nodiscard]] bool elsewhere(int module) const {
    return static_cast<std::size_t>(module) < scene_.elsewhere.size() &&
           !scene_.elsewhere[static_cast<std::size_t>(module)].empty();
  }
  /// What `job` has from `module` of another host, whose part alone knows when it was sent; times are since the release.
  /// Activations of a component are numbered alike.
  [[nodiscard]] std::string message_to(const JobStory& job, int module) const {
    const auto m = static_cast<std::size_t>(module);
    std::string out;
    for (const auto& [u, v] : app_.edges) {
      if (v != job.xnode ||
          app_.xnodes[static_cast<std::size_t>(u)].module != scene_.modules[m].name)
        continue;
      out = fmt::format("{} {} of host {}", name(u), job.sequence, scene_.elsewhere[m]);
      if (scene_.keys == nullptr) continue;
      const std::vector<std::int64_t>& keys =
          scene_.keys->placements[static_cast<std::size_t>(u)].key_us;
      for (const Crossing& crossing : scene_.keys->crossings)
        if (crossing.from == u && crossing.host + 1 == static_cast<int>(scene_.group))
          out +=
              fmt::format(", key {} us, X {} us", keys[job.sequence % keys.size()], crossing.x_us);
    }
    return out;
  }
  /// Of the arrow from an activation of a module to one of a module of another host: both hosts' files have it.
  [[nodiscard]] std::uint64_t across(int from, int to, std::int64_t number) const {
    Fnv fnv;
    for (const int module : {from, to})
      fnv.add(scene_.modules[static_cast<std::size_t>(module)].name);
    fnv.add(number);
    return fnv.value() | std::uint64_t{1} << 63U;  // none that this file counts
  }
  /// Arrows to other hosts, from what published.
  void connect_hosts(const std::vector<int>& last_job) {
    std::set<std::pair<std::string, std::string>> heard;  // modules
    for (const auto* pairs : {&app_.edges, &app_.samples})
      for (const auto& [u, v] : *pairs)
        heard.emplace(app_.xnodes[static_cast<std::size_t>(u)].module,
                      app_.xnodes[static_cast<std::size_t>(v)].module);
    for (std::size_t a = 0; a < story_.activations.size(); ++a) {
      const Activation& done = story_.activations[a];
      if (done.fate != Fate::kDone || last_job[a] < 0) continue;
      for (int to = 0; to < static_cast<int>(scene_.elsewhere.size()); ++to)
        if (elsewhere(to) &&
            heard.contains({scene_.modules[static_cast<std::size_t>(done.module)].name,
                            scene_.modules[static_cast<std::size_t>(to)].name}))
          last_piece(static_cast<std::size_t>(last_job[a]))
              ->across_out.push_back(
                  across(done.module, to, static_cast<std::int64_t>(done.sequence)));
    }
  }

  void connect_take(const Take& take, const std::vector<int>& last_job, Details& to,
                    std::int64_t begin) {
    if (take.from < 0) return;
    const auto from = static_cast<std::size_t>(take.from);
    if (take.source >= 0) {
      arrow(releases_[from], to, story_.releases[from].begin_ns <= begin);
    } else if (const int job = last_job[from]; job >= 0) {
      const auto j = static_cast<std::size_t>(job);
      arrow(*last_piece(j), to, begin_of(last_[j]) < begin);
    }
  }

  /// Through the instant at which it was read, so that a reader of the file can tell it from what
  /// fires.
  void connect_samples(const std::vector<int>& first_job, const std::vector<int>& last_job) {
    std::set<std::tuple<int, int, std::int64_t>>
        first_reads;  // an arrow from another host ends once
    for (std::size_t a = 0; a < story_.activations.size(); ++a) {
      const std::vector<SampleRead>& reads = story_.activations[a].samples;
      samples_[a].resize(reads.size());
      for (std::size_t i = 0; i < reads.size(); ++i) {
        const SampleRead& read = reads[i];
        const int reader = story_.activations[a].module;
        if (read.number >= 0 && elsewhere(read.module) &&
            first_reads.emplace(read.module, reader, read.number).second)
          samples_[a][i].across_in.push_back(across(read.module, reader, read.number));
        if (read.from >= 0)
          connect_take({read.source, read.module, 0, false, read.from}, last_job, samples_[a][i],
                       read.read_ns);
        if (first_job[a] < 0) continue;
        const auto j = static_cast<std::size_t>(first_job[a]);
        arrow(samples_[a][i], *first_piece(j), read.read_ns <= begin_of(first_[j]));
      }
    }
  }

  void paint_releases() {
    std::vector<Piece> spans;
    for (std::size_t r = 0; r < story_.releases.size(); ++r) {
      const Release& release = story_.releases[r];
      Piece piece{0,
                  release.begin_ns,
                  release.begin_ns,
                  fmt::format("release {}", release.sequence),
                  releases_[r],
                  0};
      piece.details.category = "release";
      auto& args = piece.details.args;
      args.emplace_back("release", static_cast<std::int64_t>(release.sequence));
      args.emplace_back("source", app_.sources[static_cast<std::size_t>(release.source)].name);
      if (release.urgent) args.emplace_back("urgent", std::int64_t{1});
      spans.push_back(std::move(piece));
    }
    paint_lanes(root_, "releases", "a sensor's message: when it came", spans, false);
  }

  void paint_lanes(Track parent, const std::string& title, const std::string& description,
                   std::vector<Piece>& pieces, bool exclusive) {
    std::vector<Piece*> list;
    for (Piece& piece : pieces) list.push_back(&piece);
    paint_lanes(parent, title, description, list, exclusive);
  }

  /// The track; of several lanes the first.
  Track paint_lanes(Track parent, const std::string& title, const std::string& description,
                    std::vector<Piece*>& pieces, bool exclusive) {
    int lanes = 1;
    // A job is let on while its predecessor is still being taken off: the switch is drawn inside
    // it.
    const auto depth = [](const Piece* piece) {
      return piece->details.category == "switch" ? 1 : 0;
    };
    if (exclusive)
      std::stable_sort(pieces.begin(), pieces.end(), [&](const Piece* a, const Piece* b) {
        return a->begin != b->begin ? a->begin < b->begin : depth(a) < depth(b);
      });
    else
      lanes = std::max(1, assign_lanes(pieces));
    Track top = 0;
    for (int lane = 0; lane < lanes; ++lane) {
      const Track track = out_.add_track(parent, title, lane == 0 ? description : "");
      if (lane == 0) top = track;
      Nest nest(out_, track);
      for (Piece* piece : pieces) {
        if (!exclusive && piece->lane != lane) continue;
        const int at = exclusive ? depth(piece) : 0;
        nest.add(at, piece->begin, piece->end, piece->name, std::move(piece->details));
      }
    }
    return top;
  }

  void paint_rows() {
    const Track group =
        out_.add_track(root_, "run", "what ran on each XPU; a preempted job is cut");
    std::vector<std::vector<Piece*>> by_row(scene_.rows.size());
    for (Piece& piece : run_) by_row[static_cast<std::size_t>(piece.row)].push_back(&piece);
    for (std::size_t r = 0; r < scene_.rows.size(); ++r) {
      if (!scene_.rows[r].here) continue;
      const Track track =
          paint_lanes(group, scene_.rows[r].name, "", by_row[r], scene_.rows[r].exclusive);
      paint_windows(out_, track, static_cast<int>(r), app_, scene_, story_);
    }
  }

  void paint_modules() {
    const Track group =
        out_.add_track(root_, "modules", "activations, their jobs, the jobs' states");
    struct Entry {
      std::int64_t begin, end;
      int depth, lane;
      std::string name;
      Details details;
    };
    std::vector<int> lanes(scene_.modules.size(), 1);
    const std::vector<int> lane_of = activation_lanes(lanes);
    std::vector<std::vector<Entry>> entries(scene_.modules.size());
    for (std::size_t a = 0; a < story_.activations.size(); ++a) {
      const Activation& activation = story_.activations[a];
      Details details = activations_[a];
      details.category = "module";
      details.args.emplace_back("release", static_cast<std::int64_t>(activation.sequence));
      if (activation.fate == Fate::kDropped)
        details.args.emplace_back("dropped", drop_reason(activation.reason));
      entries[static_cast<std::size_t>(activation.module)].push_back(
          {activation.begin_ns, activation.end_ns, 0, lane_of[a],
           fmt::format("{} {}{}", scene_.modules[static_cast<std::size_t>(activation.module)].name,
                       activation.sequence,
                       activation.left_out()
                           ? (activation.reason == XAUTO_DROP_OFF ? " off" : " skipped")
                       : activation.fate == Fate::kDropped ? " dropped"
                                                           : ""),
           std::move(details)});
    }
    for (const JobStory& job : story_.jobs) {
      auto& list = entries[static_cast<std::size_t>(job.module)];
      Details details{
          "job", {{"xpu", scene_.rows[static_cast<std::size_t>(row_of(job.xpu))].name}}, {}, {}};
      if (job.failed) details.args.emplace_back("failed", std::int64_t{1});
      const int lane = job.activation < 0 ? 0 : lane_of[static_cast<std::size_t>(job.activation)];
      list.push_back({job.begin_ns(), job.end_ns(), 1, lane, name(job.xnode), std::move(details)});
      for (const Phase& phase : job.phases) {
        Details why{"state", {}, {}, {}};
        if (!phase.by.empty())
          why.args.emplace_back(phase.kind == PhaseKind::kSuspended ? "preempted_by" : "waited_for",
                                names(phase.by));
        list.push_back(
            {phase.begin_ns, phase.end_ns, 2, lane, to_string(phase.kind), std::move(why)});
      }
    }
    for (std::size_t m = 0; m < entries.size(); ++m) {
      if (elsewhere(static_cast<int>(m))) continue;
      std::stable_sort(entries[m].begin(), entries[m].end(), [](const Entry& a, const Entry& b) {
        return a.begin != b.begin ? a.begin < b.begin : a.depth < b.depth;
      });
      for (int lane = 0; lane < lanes[m]; ++lane) {
        Nest nest(out_, out_.add_track(group, scene_.modules[m].name));
        for (Entry& e : entries[m])
          if (e.lane == lane) nest.add(e.depth, e.begin, e.end, e.name, std::move(e.details));
      }
    }
  }

  /// [activation] its lane among those of its module that are in flight with it. `lanes`: how many
  /// each module has.
  std::vector<int> activation_lanes(std::vector<int>& lanes) const {
    struct Flight {
      std::int64_t begin, end;
      std::size_t activation;
      int lane = 0;
    };
    std::vector<std::vector<Flight>> flights(lanes.size());
    for (std::size_t a = 0; a < story_.activations.size(); ++a) {
      const Activation& activation = story_.activations[a];
      flights[static_cast<std::size_t>(activation.module)].push_back(
          {activation.begin_ns, activation.end_ns, a});
    }
    std::vector<int> lane_of(story_.activations.size(), 0);
    for (std::size_t m = 0; m < flights.size(); ++m) {
      std::vector<Flight*> list;
      for (Flight& flight : flights[m]) list.push_back(&flight);
      lanes[m] = std::max(1, assign_lanes(list));
      for (const Flight& flight : flights[m]) lane_of[flight.activation] = flight.lane;
    }
    return lane_of;
  }

  /// Where the arrows end: outputs published.
  void paint_results() {
    Nest nest(out_, out_.add_track(root_, "done", "outputs published"));
    std::vector<std::size_t> order;
    for (std::size_t a = 0; a < story_.activations.size(); ++a)
      if (story_.activations[a].fate == Fate::kDone && !results_[a].flows_in.empty())
        order.push_back(a);
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return story_.activations[a].end_ns < story_.activations[b].end_ns;
    });
    for (const std::size_t a : order) {
      const Activation& activation = story_.activations[a];
      Details& details = results_[a];
      details.category = "done";
      details.args.emplace_back("release", static_cast<std::int64_t>(activation.sequence));
      if (const std::int64_t origin_ns = activation.origin_ns(); origin_ns > 0) {
        details.args.emplace_back("latency_us", (activation.end_ns - origin_ns) / 1000);
        if (app_.deadline_us) details.args.emplace_back("deadline_us", *app_.deadline_us);
      }
      nest.instant(
          activation.end_ns,
          fmt::format("{} {}", scene_.modules[static_cast<std::size_t>(activation.module)].name,
                      activation.sequence),
          std::move(details));
    }
  }

  /// How many activations of a module are in flight.
  void paint_in_flight(Track group) {
    std::vector<Steps> steps(scene_.modules.size());
    for (const Activation& a : story_.activations) {
      if (a.end_ns == a.begin_ns) continue;  // it never began
      steps[static_cast<std::size_t>(a.module)].emplace_back(a.begin_ns, 1);
      steps[static_cast<std::size_t>(a.module)].emplace_back(a.end_ns, -1);
    }
    for (std::size_t m = 0; m < steps.size(); ++m)
      if (!elsewhere(static_cast<int>(m)))
        paint_counter(group, scene_.modules[m].name + " in flight", std::move(steps[m]));
  }

  using Steps = std::vector<std::pair<std::int64_t, std::int64_t>>;  ///< time, change
  void paint_counter(Track parent, const std::string& title, Steps steps) {
    const Track track = out_.add_counter(parent, title);
    out_.count(track, story_.begin_ns, 0);
    std::stable_sort(steps.begin(), steps.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    std::int64_t value = 0;
    for (std::size_t i = 0; i < steps.size(); ++i) {
      value += steps[i].second;
      if (i + 1 == steps.size() || steps[i + 1].first != steps[i].first)
        out_.count(track, steps[i].first, value);
    }
  }

  void paint_counters() {
    const Track group = out_.add_track(root_, "counters");
    paint_in_flight(group);
    std::vector<Steps> waiting(scene_.rows.size()), suspended(scene_.rows.size());
    for (const JobStory& job : story_.jobs)
      for (const Phase& phase : job.phases) {
        const auto row = static_cast<std::size_t>(row_of(job.xpu));
        Steps* steps = phase.kind == PhaseKind::kWaiting     ? &waiting[row]
                       : phase.kind == PhaseKind::kSuspended ? &suspended[row]
                                                             : nullptr;
        if (steps == nullptr) continue;
        steps->emplace_back(phase.begin_ns, 1);
        steps->emplace_back(phase.end_ns, -1);
      }
    for (std::size_t r = 0; r < scene_.rows.size(); ++r) {
      if (!scene_.rows[r].here) continue;
      paint_counter(group, scene_.rows[r].name + " jobs waiting", std::move(waiting[r]));
      paint_counter(group, scene_.rows[r].name + " jobs suspended", std::move(suspended[r]));
    }
    Steps dropped, missed;
    for (const Activation& a : story_.activations)
      if (a.fate == Fate::kDropped && !a.left_out()) dropped.emplace_back(a.end_ns, 1);
    if (app_.deadline_us)
      for (const Activation& a : story_.activations)
        if (a.fate == Fate::kDone && scene_.modules[static_cast<std::size_t>(a.module)].sink &&
            a.origin_ns() > 0 && (a.end_ns - a.origin_ns()) / 1000 > *app_.deadline_us)
          missed.emplace_back(a.end_ns, 1);
    paint_counter(group, "activations dropped", std::move(dropped));
    if (app_.deadline_us) paint_counter(group, "deadlines missed", std::move(missed));
    const Track lost = out_.add_counter(group, "trace events lost");
    out_.count(lost, story_.begin_ns, static_cast<std::int64_t>(story_.lost));
    out_.count(lost, story_.end_ns, static_cast<std::int64_t>(story_.lost));
    if (story_.overwritten == 0) return;
    const Track before = out_.add_counter(group, "older trace events dropped");
    out_.count(before, story_.begin_ns, static_cast<std::int64_t>(story_.overwritten));
  }

  const AppSpec& app_;
  const Scene& scene_;
  const Story& story_;
  PerfettoWriter out_;
  Track root_ = 0;
  std::vector<Piece> run_;
  std::vector<int> first_, last_;  ///< by job: index into run_, -1: it never ran
  std::vector<Details> releases_, activations_, results_;  ///< arrows of each
  std::vector<std::vector<Details>> samples_;              ///< [activation][sample] likewise
  std::uint64_t flows_ = 0;
};

}  // namespace

Result<std::string> perfetto_trace(const AppSpec& app, const Scene& scene, const Story& story,
                                   std::int64_t clock_offset_ns) {
  for (const int row : scene.row_of)
    if (row < 0 || static_cast<std::size_t>(row) >= scene.rows.size())
      return fail(ErrorCode::kInternal, "an XPU has no row", "trace");
  return Painter(app, scene, story).paint(clock_offset_ns);
}

}  // namespace xauto::story
