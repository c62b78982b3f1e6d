// SPDX-License-Identifier: Apache-2.0
#include "story/chain_story.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "story/account.h"

namespace xauto::story {
namespace {

std::vector<const TraceReactions::One*> by_reaction(const TraceReactions& chain) {
  std::vector<const TraceReactions::One*> list;
  for (const TraceReactions::One& one : chain.releases) list.push_back(&one);
  std::stable_sort(list.begin(), list.end(),
                   [](const auto* a, const auto* b) { return a->reaction_us > b->reaction_us; });
  return list;
}

class Tracer {
 public:
  Tracer(const ReadTrace& trace, std::int64_t zero_ns) : trace_(trace), zero_ns_(zero_ns) {
    for (std::size_t i = 0; i < trace.run.size(); ++i)
      if (trace.run[i].category == "run" && trace.run[i].activation >= 0)
        parts_[{trace.run[i].activation, trace.run[i].name}].push_back(i);
  }

  /// The job of `xnode` in `activation`, and all that it is made of. False: it is not there.
  bool trace_back(const std::string& xnode, std::int64_t activation, ChainStory& into) {
    std::vector<std::pair<std::int64_t, std::string>> front = {{activation, xnode}};
    if (!parts_.contains(front.front())) return false;
    std::set<std::pair<std::int64_t, std::string>> seen(front.begin(), front.end());
    std::set<int> sensors;
    const auto visit = [&](int slice) {
      const TraceSlice& s = trace_.run[at(slice)];
      if (std::pair key{s.activation, s.name}; parts_.contains(key) && seen.insert(key).second)
        front.push_back(std::move(key));
    };
    for (std::size_t next = 0; next < front.size(); ++next) {
      if (into.jobs.size() == kMostStoryJobs) {
        into.cut = true;
        break;
      }
      const std::vector<std::size_t>& parts = parts_.at(front[next]);
      into.jobs.push_back(job_of(parts));
      const TraceSlice& first = trace_.run[parts.front()];
      for (const int slice : first.from) visit(slice);
      sensors.insert(first.releases.begin(), first.releases.end());
      for (const TraceSample& sample : first.samples) {
        if (sample.slice >= 0) visit(sample.slice);
        if (sample.release >= 0) sensors.insert(sample.release);
      }
    }
    for (const int r : sensors) {
      const TraceRelease& release = trace_.releases[at(r)];
      into.sensors.push_back({release.source, release.number, since(release.begin_ns)});
    }
    std::stable_sort(into.jobs.begin(), into.jobs.end(),
                     [](const StoryJob& a, const StoryJob& b) { return a.began_us < b.began_us; });
    std::stable_sort(
        into.sensors.begin(), into.sensors.end(),
        [](const StorySensor& a, const StorySensor& b) { return a.released_us < b.released_us; });
    return true;
  }

 private:
  [[nodiscard]] std::int64_t since(std::int64_t ns) const { return (ns - zero_ns_) / 1000; }

  [[nodiscard]] StoryJob job_of(const std::vector<std::size_t>& parts) const {
    const TraceSlice &first = trace_.run[parts.front()], &last = trace_.run[parts.back()];
    StoryJob job;
    job.xnode = first.name;
    job.module = first.module;
    job.xpu = trace_.rows[at(first.row)];
    job.number = first.release;
    job.began_us = since(first.begin_ns);
    job.ready_us = job.began_us - first.waited_us;
    job.ended_us = since(last.end_ns);
    for (const std::size_t part : parts)
      job.ran_us += (trace_.run[part].end_ns - trace_.run[part].begin_ns) / 1000;
    if (first.since_release_us) job.released_us = job.began_us - *first.since_release_us;
    if (job.released_us && first.key_us) job.key_us = *job.released_us + *first.key_us;
    job.lateness_us = last.lateness_us;
    for (const TraceSample& sample : first.samples)
      job.reads.push_back({sample.read, sample.number, since(sample.at_ns), sample.age_us});
    return job;
  }

  const ReadTrace& trace_;
  const std::int64_t zero_ns_;
  /// (activation, XNode) -> slices, by begin
  std::map<std::pair<std::int64_t, std::string>, std::vector<std::size_t>> parts_;
};

std::string or_dash(const std::optional<std::int64_t>& us, bool sign = false) {
  if (!us) return "-";
  return sign ? fmt::format("{:+.3f}", static_cast<double>(*us) / 1000) : in_ms(*us);
}

}  // namespace

const TraceReactions::One* worst_of(const TraceReactions& chain) {
  const auto list = by_reaction(chain);
  return list.empty() ? nullptr : list.front();
}

const TraceReactions::One* median_of(const TraceReactions& chain) {
  const auto list = by_reaction(chain);
  return list.empty() ? nullptr : list[list.size() / 2];
}

Result<ChainStory> story_of(const ReadTrace& trace, const TraceReactions& chain,
                            const TraceReactions::One& release) {
  ChainStory story;
  story.chain = chain.name;
  story.note = chain.note;
  story.number = release.number;
  story.reaction_us = release.reaction_us;
  story.urgent = release.urgent;
  const auto list = by_reaction(chain);
  story.of = static_cast<std::int64_t>(list.size());
  story.rank = std::find(list.begin(), list.end(), &release) - list.begin() + 1;
  story.median_us = list[list.size() / 2]->reaction_us;
  if (!Tracer(trace, release.released_ns).trace_back(release.xnode, release.activation, story))
    return fail(ErrorCode::kInfeasible, "the job that knew it first is not in the trace",
                fmt::format("{}, release {}", chain.name, release.number));
  return story;
}

std::string story_text(const ChainStory& story) {
  std::string out = fmt::format("{}: {} {} took {} ms, ", story.chain,
                                story.urgent ? "urgent release" : "release", story.number,
                                in_ms(story.reaction_us));
  out += story.rank == 1 ? fmt::format("the longest of {}", story.of)
                         : fmt::format("number {} from the longest of {}", story.rank, story.of);
  out += fmt::format("; the median is {}.\n  {}\n\n  All in ms since that release.\n\n",
                     in_ms(story.median_us), story.note);
  std::size_t width = 12;
  for (const StoryJob& job : story.jobs) width = std::max(width, job.xnode.size());
  for (const StorySensor& sensor : story.sensors) width = std::max(width, sensor.source.size() + 7);
  out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10} {:>10} {:>10} {:>10} {:>9}\n", "XNode", width,
                     "n", "on", "ready", "began", "ended", "key", "lateness");
  std::size_t next = 0;
  const auto sensors_until = [&](std::int64_t us) {
    for (; next < story.sensors.size() && story.sensors[next].released_us <= us; ++next) {
      const StorySensor& sensor = story.sensors[next];
      out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10}\n", "source " + sensor.source, width,
                         sensor.number, "released", in_ms(sensor.released_us));
    }
  };
  for (const StoryJob& job : story.jobs) {
    sensors_until(job.began_us);
    out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10} {:>10} {:>10} {:>10} {:>9}\n", job.xnode,
                       width, job.number, job.xpu, in_ms(job.ready_us), in_ms(job.began_us),
                       in_ms(job.ended_us), or_dash(job.key_us), or_dash(job.lateness_us, true));
    for (const StoryRead& read : job.reads)
      out += read.number < 0
                 ? fmt::format("    read of {}: nothing\n", read.read)
                 : fmt::format("    read {} {}, {}\n", read.read, read.number,
                               read.age_us < 0 ? "whose release is not in the trace"
                                               : in_ms(read.age_us) + " ms after its release");
  }
  sensors_until(INT64_MAX);
  if (story.cut) out += fmt::format("  It goes back further; {} jobs are shown.\n", kMostStoryJobs);
  const StoryJob* latest = nullptr;
  for (const StoryJob& job : story.jobs)
    if (job.lateness_us && (latest == nullptr || *job.lateness_us > *latest->lateness_us))
      latest = &job;
  if (latest != nullptr)
    out += fmt::format("\n  Latest against its key: {} {}, {} ms.\n", latest->xnode, latest->number,
                       or_dash(latest->lateness_us, true));
  return out;
}

}  // namespace xauto::story
