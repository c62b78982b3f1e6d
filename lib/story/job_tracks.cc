// SPDX-License-Identifier: Apache-2.0
#include "story/job_tracks.h"

#include <algorithm>
#include <string>

#include <fmt/format.h>

#include "base/index.h"
#include "model/deployment.h"
#include "story/lanes.h"

namespace xauto::story {
namespace {

using Track = PerfettoWriter::Track;
using Details = PerfettoWriter::Details;

struct Span {
  std::int64_t begin = 0, end = 0;
  std::string name;
  Details details;
  int lane = 0;
};

/// One track, or several of one name where spans overlap.
void paint_spans(PerfettoWriter& out, Track parent, const std::string& title,
                 const std::string& description, std::vector<Span>& spans) {
  std::vector<Span*> list;
  for (Span& span : spans) list.push_back(&span);
  const int lanes = std::max(1, assign_lanes(list));
  std::vector<Track> tracks;
  for (int lane = 0; lane < lanes; ++lane)
    tracks.push_back(out.add_track(parent, title, lane == 0 ? description : ""));
  for (Span* span : list) {
    out.begin(tracks[at(span->lane)], span->begin, span->name, std::move(span->details));
    out.end(tracks[at(span->lane)], std::max(span->begin, span->end));
  }
}

/// Of the whole run, where its trace begins.
void paint_counts(PerfettoWriter& out, Track group, const ChainCounts& counts,
                  std::int64_t begin_ns) {
  Details details{"counts", {{"chain", counts.name}, {"results", counts.results}}, {}, {}};
  const auto add = [&](const char* name, std::int64_t value) {
    if (value >= 0) details.args.emplace_back(name, value);
  };
  add("p50_us", counts.p50_us);
  add("p99_us", counts.p99_us);
  add("max_us", counts.max_us);
  add("worst_case_us", counts.worst_case_us);
  add("lower_bound_us", counts.lower_bound_us);
  add("deadline_us", counts.deadline_us);
  add("misses", counts.misses);
  add("lost", counts.lost);
  if (counts.exceeded) add("exceeded", 1);
  out.instant(group, begin_ns, "chain '" + counts.name + "' in the whole run", std::move(details));
}

}  // namespace

void paint_chains(PerfettoWriter& out, Track root, const AppSpec& app, const Scene& scene,
                  const Story& story) {
  const Track group = out.add_track(root, "chains", scene.verdict);
  for (const ChainCounts& counts : scene.counts) paint_counts(out, group, counts, story.begin_ns);
  std::vector<std::vector<Span>> spans(std::min(app.chains.size(), kMaxChains));
  for (const Reaction& reaction : reactions_of(app, story)) {
    if (at(reaction.chain) >= spans.size()) break;  // they come by chain
    const ChainSpec& chain = app.chains[at(reaction.chain)];
    const JobStory& job = story.jobs[at(reaction.job)];
    Span span{reaction.released_ns,
              reaction.end_ns,
              fmt::format("{} {}", chain.name, reaction.number),
              {"chain",
               {{"release", reaction.number},
                {"reaction_us", reaction.us()},
                {"xnode", app.xnodes[at(job.xnode)].name},
                {"activation", static_cast<std::int64_t>(job.activation)}},
               {},
               {}},
              0};
    if (reaction.urgent) span.details.args.emplace_back("urgent", std::int64_t{1});
    if (chain.deadline_us) span.details.args.emplace_back("deadline_us", *chain.deadline_us);
    spans[at(reaction.chain)].push_back(std::move(span));
  }
  for (std::size_t c = 0; c < spans.size(); ++c) {
    std::string text = "from source " + app.sources[at(app.chains[c].from)].name;
    // Never without the verdict, which is the group's.
    if (c < scene.claims.size()) {
      const ChainClaim& claim = scene.claims[c];
      text +=
          fmt::format("; worst case {} us, bound {} us", claim.worst_case_us, claim.lower_bound_us);
      if (claim.urgent_worst_case_us)
        text += fmt::format("; of an urgent release {} us", *claim.urgent_worst_case_us);
    }
    paint_spans(out, group, app.chains[c].name, text, spans[c]);
  }
}

void paint_windows(PerfettoWriter& out, Track track, int row, const AppSpec& app,
                   const Scene& scene, const Story& story) {
  if (scene.keys == nullptr) return;
  std::vector<Span> spans;
  for (const JobStory& job : story.jobs) {
    if (scene.row_of[at(job.xpu)] != row) continue;
    const auto window = window_of(app, *scene.keys, story, job);
    if (!window) continue;
    Span span{window->begin_ns,
              window->key_ns,
              app.xnodes[at(job.xnode)].name,
              {"window", {{"release", static_cast<std::int64_t>(job.sequence)}}, {}, {}},
              0};
    if (job.complete) tell_lateness(*window, job.end_ns(), span.details);
    spans.push_back(std::move(span));
  }
  paint_spans(out, track, "windows", "of each job: from its release and hold to its key", spans);
}

void paint_samples(PerfettoWriter& out, Track root, const AppSpec& app, const Scene& scene,
                   const Story& story, std::vector<std::vector<Details>> arrows) {
  struct Instant {
    const Activation* reader;
    const SampleRead* read;
    Details* details;
  };
  std::vector<Instant> instants;
  for (std::size_t a = 0; a < story.activations.size(); ++a)
    for (std::size_t i = 0; i < story.activations[a].samples.size(); ++i)
      instants.push_back({&story.activations[a], &story.activations[a].samples[i], &arrows[a][i]});
  if (instants.empty()) return;
  std::stable_sort(instants.begin(), instants.end(), [](const Instant& a, const Instant& b) {
    return a.read->read_ns < b.read->read_ns;
  });
  const Track track = out.add_track(root, "samples", "what was read of topics that fire nobody");
  for (const Instant& instant : instants) {
    const SampleRead& read = *instant.read;
    const bool source = read.source >= 0;
    const std::string from = source && at(read.source) < app.sources.size()
                                 ? app.sources[at(read.source)].name
                             : source ? "source " + std::to_string(read.source)
                                      : scene.modules[at(read.module)].name;
    const std::string& reader = scene.modules[at(instant.reader->module)].name;
    Details& details = *instant.details;
    details.category = "sample";
    details.args = {{"reader", reader},
                    {"release", static_cast<std::int64_t>(instant.reader->sequence)},
                    {"read", from}};
    std::string name = fmt::format("{} reads {} ", reader, from);
    if (read.number < 0) {
      name += "nothing";
    } else {
      name += std::to_string(read.number);
      details.args.emplace_back("number", read.number);
    }
    if (read.from >= 0) {
      const std::int64_t released_ns = source ? story.releases[at(read.from)].begin_ns
                                              : story.activations[at(read.from)].released_ns;
      if (released_ns > 0) details.args.emplace_back("age_us", (read.read_ns - released_ns) / 1000);
    }
    out.instant(track, read.read_ns, name, std::move(details));
  }
}

void tell_window(const ObservedWindow& window, std::int64_t began_ns, Details& first) {
  first.args.emplace_back("since_release_us", (began_ns - window.released_ns) / 1000);
  first.args.emplace_back("hold_us", (window.begin_ns - window.released_ns) / 1000);
  first.args.emplace_back("key_us", (window.key_ns - window.released_ns) / 1000);
}

void tell_lateness(const ObservedWindow& window, std::int64_t ended_ns, Details& last) {
  // Towards later: what is late by less than a microsecond is late.
  const std::int64_t ns = ended_ns - window.key_ns;
  last.args.emplace_back("lateness_us", ns > 0 ? (ns + 999) / 1000 : ns / 1000);
}

}  // namespace xauto::story
