// SPDX-License-Identifier: Apache-2.0
// xauto explain: which chain sets the latency of a policy, and which XPU limits it; or, of a trace,
// why one release took as long as it did.
#include <charconv>
#include <cstdio>
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "model/json.h"
#include "model/json_value.h"
#include "story/chain_story.h"

#include "xauto/command.h"
#include "xauto/policies.h"

namespace xauto::cli {
namespace {

struct ExplainFlags {
  std::string app, platform, policy, windows, trace, chain, activation = "worst";
  double moves_s = 10;
};

Json to_json(const std::vector<story::Blocker>& list) {
  auto out = Json::array();
  for (const story::Blocker& b : list) out.push_back({{"who", b.who}, {"us", b.us}});
  return out;
}

/// One of the chain's; `where` is for messages.
Result<const story::TraceReactions::One*> wanted(const story::TraceReactions& chain,
                                                 const std::string& text,
                                                 const std::string& where) {
  using Release = story::TraceReactions::One;
  if (text == "worst" || text == "median") {
    const Release* found = text == "worst" ? worst_of(chain) : median_of(chain);
    if (found == nullptr)
      return fail(ErrorCode::kInfeasible, "no release in it has a latency", where,
                  "was everything dropped? `xauto report` shows the load");
    return found;
  }
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || number < 0)
    return fail(ErrorCode::kInvalid, "'" + text + "' is no activation", "--activation",
                "worst, median, or a number from 0 on");
  for (const Release& release : chain.releases)
    if (release.number == number) return &release;
  return fail(ErrorCode::kNotFound, "is not in the trace", "release " + std::to_string(number),
              chain.releases.empty() ? "there is no release in it"
                                     : "it has " + std::to_string(chain.releases.front().number) +
                                           " to " + std::to_string(chain.releases.back().number));
}

/// A release of each chain, or of the one asked for.
Result<std::vector<story::ChainStory>> stories_of(const ExplainFlags& flags,
                                                  const story::ReadTrace& trace) {
  if (trace.reactions.empty())
    return fail(ErrorCode::kInvalid, "tells of no chain", flags.trace,
                "take a file of `xauto run --trace-out` or `xauto compare`");
  std::vector<story::ChainStory> stories;
  std::string known;
  for (const story::TraceReactions& chain : trace.reactions) {
    known += (known.empty() ? "" : ", ") + chain.name;
    if (flags.chain.empty() ? chain.releases.empty() : chain.name != flags.chain) continue;
    XAUTO_ASSIGN(const story::TraceReactions::One* release,
                 wanted(chain, flags.activation, flags.trace + ", " + chain.name));
    XAUTO_ASSIGN(story::ChainStory story, story_of(trace, chain, *release));
    stories.push_back(std::move(story));
  }
  if (stories.empty())
    return fail(ErrorCode::kNotFound,
                flags.chain.empty() ? "no chain has a result in the trace"
                                    : "there is no chain '" + flags.chain + "'",
                flags.chain.empty() ? flags.trace : "--chain", "there are " + known);
  return stories;
}

Json or_null(const std::optional<std::int64_t>& us) {
  return us ? Json(*us) : Json();
}

Json to_json(const story::StoryJob& job) {
  auto reads = Json::array();
  for (const story::StoryRead& read : job.reads)
    reads.push_back({{"read", read.read},
                     {"number", read.number < 0 ? Json() : Json(read.number)},
                     {"at_us", read.at_us},
                     {"age_us", read.age_us < 0 ? Json() : Json(read.age_us)}});
  return {{"xnode", job.xnode},
          {"module", job.module},
          {"xpu", job.xpu},
          {"release", job.number},
          {"released_us", or_null(job.released_us)},
          {"late_us", job.late_us},
          {"ready_us", job.ready_us},
          {"held_until_us", or_null(job.held_until_us)},
          {"began_us", job.began_us},
          {"ran_us", job.ran_us},
          {"ended_us", job.ended_us},
          {"without_core_us", job.without_core_us},
          {"key_us", or_null(job.key_us)},
          {"lateness_us", or_null(job.lateness_us)},
          {"waited_for", to_json(job.waited_for)},
          {"preempted_by", to_json(job.preempted_by)},
          {"reads", std::move(reads)}};
}

Json to_json(const std::vector<story::StoryJob>& list) {
  auto jobs = Json::array();
  for (const story::StoryJob& job : list) jobs.push_back(to_json(job));
  return jobs;
}

Json to_json(const story::ChainStory& story) {
  auto sensors = Json::array();
  for (const story::StorySensor& s : story.sensors)
    sensors.push_back(
        {{"source", s.source}, {"release", s.number}, {"released_us", s.released_us}});
  auto way = Json::array();
  for (const story::Spent& spent : story.way)
    way.push_back(
        {{"on", story::to_string(spent.on)},
         {"xnode",
          spent.job < 0 ? Json() : Json(story.jobs[static_cast<std::size_t>(spent.job)].xnode)},
         {"begin_us", spent.begin_us},
         {"end_us", spent.end_us}});
  return {{"chain", story.chain},
          {"note", story.note},
          {"release", story.number},
          {"reaction_us", story.reaction_us},
          {"urgent", story.urgent},
          {"rank", story.rank},
          {"of", story.of},
          {"median_us", story.median_us},
          {"cut", story.cut},
          {"way", std::move(way)},
          {"sensors", std::move(sensors)},
          {"jobs", to_json(story.jobs)},
          {"own", to_json(story.own)},
          {"missed", to_json(story.missed)}};
}

Result<int> explain_trace(const ExplainFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const std::string bytes, read_file(flags.trace));
  XAUTO_ASSIGN(const story::ReadTrace trace, story::read_trace(bytes, flags.trace));
  XAUTO_ASSIGN(const std::vector<story::ChainStory> stories, stories_of(flags, trace));
  if (options.json) {
    Json j = {{"claims", trace.verdict}, {"chains", Json::array()}};
    for (const story::ChainStory& story : stories) j["chains"].push_back(to_json(story));
    j["events_lost"] = trace.lost;
    j["events_dropped_before"] = trace.overwritten;
    std::cout << j.dump(2) << "\n";
    return kDone;
  }
  std::cout << trace.title << "\n";
  if (trace.lost > 0)
    std::cout << "INCOMPLETE: the trace lost " << trace.lost
              << " events; what follows is of what is there\n";
  if (trace.overwritten > 0)
    std::cout << fmt::format("the trace holds {:.1f} s: {} older events were dropped\n",
                             static_cast<double>(trace.end_ns - trace.begin_ns) * 1e-9,
                             trace.overwritten);
  std::cout << trace.verdict << "\n";
  for (const story::ChainStory& story : stories) std::cout << "\n" << story_text(story);
  return kDone;
}

Result<int> explain(const ExplainFlags& flags, const Options& options) {
  if (!flags.trace.empty()) return explain_trace(flags, options);
  for (const auto& [path, option] :
       {std::pair{&flags.app, "--app"}, std::pair{&flags.policy, "--policy"}})
    if (path->empty())
      return fail(ErrorCode::kInvalid, "is needed", option,
                  "or give the trace of a run: xauto explain --trace FILE.pftrace");
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform_of(flags.policy, flags.platform));
  return explain_policy(app, platform, flags.policy, flags.windows, flags.moves_s, options);
}

}  // namespace

void add_explain(Commands& commands) {
  auto flags = std::make_shared<ExplainFlags>();
  Verb verb = commands.add(
      "explain", "Name the chain that sets the latency: of a policy, or of one release of a run.",
      "xauto explain --trace drive.pftrace --activation worst",
      [flags](const Options& options) { return explain(*flags, options); });
  verb.option("--app", flags->app, "app.json");
  verb.option("--platform", flags->platform, kPlatformNames).shown_as("the policy's");
  verb.option("--policy", flags->policy, "policy.json");
  verb.option("--windows", flags->windows, "write a picture of every job's window here, an SVG");
  verb.duration("--time-limit", flags->moves_s, Unit::kSeconds, 0, kYearS,
                "for all that moving an XNode would bring");
  verb.option("--trace", flags->trace,
              "instead of the three above: a file of `xauto run --trace-out` or `xauto compare`")
      .excludes("--app")
      .excludes("--platform")
      .excludes("--policy")
      .excludes("--windows");
  verb.option("--activation", flags->activation,
              "of the trace: the release's number, worst or median")
      .shown();
  verb.option("--chain", flags->chain, "of a trace: the chain; default: each").needs("--trace");
}

}  // namespace xauto::cli
