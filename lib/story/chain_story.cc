// SPDX-License-Identifier: Apache-2.0
#include "story/chain_story.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"

namespace xauto::story {
namespace {

constexpr std::size_t kMostNames = 3;

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
    seen_ = {front.begin(), front.end()};
    std::set<int> sensors;
    const auto visit = [&](int slice) {
      const TraceSlice& s = trace_.run[at(slice)];
      if (std::pair key{s.activation, s.name}; parts_.contains(key) && seen_.insert(key).second)
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

  /// After trace_back: what became of the release itself, where what it found is of a newer one.
  void follow(std::size_t release, std::int64_t until_ns, ChainStory& into) const {
    std::set<std::string> on_the_way;
    for (const StoryJob& job : into.jobs) on_the_way.insert(job.xnode);
    const TraceRelease& itself = trace_.releases[release];
    const std::set<Job> knows = made_of(until_ns, [&](int r) { return at(r) == release; });
    const std::set<Job> newer = made_of(until_ns, [&](int r) {
      const TraceRelease& other = trace_.releases[at(r)];
      return other.source == itself.source && other.number > itself.number;
    });
    for (const auto& [key, parts] : parts_) {
      const TraceSlice& first = trace_.run[parts.front()];
      if (seen_.contains(key) || !on_the_way.contains(first.name) || first.begin_ns >= until_ns)
        continue;
      if (knows.contains(key))
        into.own.push_back(job_of(parts));
      else if (!first.samples.empty() && !newer.contains(key) && first.begin_ns >= itself.begin_ns)
        into.missed.push_back(job_of(parts));
    }
    for (std::vector<StoryJob>* list : {&into.own, &into.missed})
      std::stable_sort(list->begin(), list->end(), [](const StoryJob& a, const StoryJob& b) {
        return a.began_us < b.began_us;
      });
  }

 private:
  using Job = std::pair<std::int64_t, std::string>;  ///< (activation, XNode)

  /// The jobs until then that are made of such a release.
  template <class Is>
  [[nodiscard]] std::set<Job> made_of(std::int64_t until_ns, Is is) const {
    std::set<Job> jobs;
    std::vector<char> marked(trace_.run.size(), 0);
    const auto is_marked = [&](int slice) { return slice >= 0 && marked[at(slice)] != 0; };
    for (std::size_t i = 0; i < trace_.run.size() && trace_.run[i].begin_ns < until_ns; ++i) {
      const TraceSlice& s = trace_.run[i];
      if (s.activation < 0) continue;
      const bool knows =
          jobs.contains({s.activation, s.name}) ||
          std::any_of(s.releases.begin(), s.releases.end(), is) ||
          std::any_of(s.from.begin(), s.from.end(), is_marked) ||
          std::any_of(s.samples.begin(), s.samples.end(), [&](const TraceSample& sample) {
            return is_marked(sample.slice) || (sample.release >= 0 && is(sample.release));
          });
      if (!knows) continue;
      marked[i] = 1;
      jobs.emplace(s.activation, s.name);
    }
    return jobs;
  }

  [[nodiscard]] std::vector<Blocker> on_row(const TraceSlice& job, std::int64_t from_ns,
                                            std::int64_t to_ns) const {
    std::vector<Blocker> list;
    for (const TraceSlice& s : trace_.run) {
      if (s.begin_ns >= to_ns) break;  // they come by begin
      if (s.row != job.row || s.category != "run" || s.end_ns <= from_ns || &s == &job) continue;
      const std::int64_t us = (std::min(to_ns, s.end_ns) - std::max(from_ns, s.begin_ns)) / 1000;
      if (us > 0) list.push_back({fmt::format("{} {}", s.name, s.release), us});
    }
    std::stable_sort(list.begin(), list.end(),
                     [](const Blocker& a, const Blocker& b) { return a.us > b.us; });
    return list;
  }

  static void add(std::vector<Blocker>& list, const Blocker& by) {
    const auto at =
        std::find_if(list.begin(), list.end(), [&](const Blocker& b) { return b.who == by.who; });
    if (at == list.end())
      list.push_back(by);
    else
      at->us += by.us;
  }

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
    std::int64_t off_ns = first.end_ns;
    for (const std::size_t part : parts) {
      const TraceSlice& piece = trace_.run[part];
      job.ran_us += (piece.end_ns - piece.begin_ns) / 1000;
      for (const Blocker& by : on_row(first, off_ns, piece.begin_ns)) add(job.preempted_by, by);
      off_ns = piece.end_ns;
    }
    if (first.since_release_us) job.released_us = job.began_us - *first.since_release_us;
    if (job.released_us && first.key_us) job.key_us = *job.released_us + *first.key_us;
    if (first.held_us > 0) job.held_until_us = std::min(job.began_us, job.ready_us + first.held_us);
    if (first.from.empty() && first.released_ns > 0)
      job.late_us = job.ready_us - since(first.released_ns);
    const std::int64_t free_us = std::max(job.ready_us, job.held_until_us.value_or(job.ready_us));
    if (job.began_us > free_us)
      job.waited_for = on_row(first, zero_ns_ + free_us * 1000, first.begin_ns);
    job.lateness_us = last.lateness_us;
    for (const TraceSample& sample : first.samples)
      job.reads.push_back({sample.read, sample.number, since(sample.at_ns), sample.age_us});
    return job;
  }

  const ReadTrace& trace_;
  const std::int64_t zero_ns_;
  /// (activation, XNode) -> slices, by begin
  std::map<Job, std::vector<std::size_t>> parts_;
  std::set<Job> seen_;  ///< by trace_back
};

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

std::string or_dash(const std::optional<std::int64_t>& us, bool sign = false) {
  if (!us) return "-";
  return sign ? fmt::format("{:+.3f}", static_cast<double>(*us) / 1000) : in_ms(*us);
}

}  // namespace

std::string in_ms(std::int64_t us) {
  return fmt::format("{:.3f}", static_cast<double>(us) / 1000);
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
  Tracer tracer(trace, release.released_ns);
  if (!tracer.trace_back(release.xnode, release.activation, story))
    return fail(ErrorCode::kInfeasible, "the job that knew it first is not in the trace",
                fmt::format("{}, release {}", chain.name, release.number));
  const auto itself =
      std::find_if(trace.releases.begin(), trace.releases.end(), [&](const TraceRelease& r) {
        return r.number == release.number && r.begin_ns == release.released_ns;
      });
  if (itself != trace.releases.end())
    tracer.follow(static_cast<std::size_t>(itself - trace.releases.begin()),
                  release.released_ns + release.reaction_us * 1000, story);
  return story;
}

std::string reasons_of(const StoryJob& job) {
  std::string out;
  const auto say = [&](const std::string& text) { out += (out.empty() ? "" : "; ") + text; };
  if (job.late_us >= kWorthSayingUs)
    say("its source came " + in_ms(job.late_us) + " ms after the release");
  std::int64_t free_us = job.ready_us;
  if (job.held_until_us && *job.held_until_us > job.ready_us) {
    free_us = std::min(*job.held_until_us, job.began_us);
    if (free_us - job.ready_us >= kWorthSayingUs)
      say("held until " + in_ms(*job.held_until_us) + " by its policy");
  }
  if (job.began_us - free_us >= kWorthSayingUs)
    say(waited_text(job.began_us - free_us, job.waited_for));
  if (const std::int64_t off_us = job.ended_us - job.began_us - job.ran_us;
      off_us >= kWorthSayingUs)
    say("off the XPU for " + in_ms(off_us) + " ms" +
        (job.preempted_by.empty() ? "" : ", preempted by " + names_of(job.preempted_by, off_us)));
  return out;
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
  out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10} {:>10} {:>10} {:>10} {:>9}  why\n", "XNode",
                     width, "n", "on", "ready", "began", "ended", "key", "lateness");
  std::size_t next = 0;
  const auto sensors_until = [&](std::int64_t us) {
    for (; next < story.sensors.size() && story.sensors[next].released_us <= us; ++next) {
      const StorySensor& sensor = story.sensors[next];
      out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10}\n", "source " + sensor.source, width,
                         sensor.number, "released", in_ms(sensor.released_us));
    }
  };
  const auto tell = [&](const StoryJob& job) {
    out += fmt::format("  {:<{}} {:>7}  {:<8} {:>10} {:>10} {:>10} {:>10} {:>9}  {}\n", job.xnode,
                       width, job.number, job.xpu, in_ms(job.ready_us), in_ms(job.began_us),
                       in_ms(job.ended_us), or_dash(job.key_us), or_dash(job.lateness_us, true),
                       reasons_of(job));
    for (const StoryRead& read : job.reads)
      out += read.number < 0
                 ? fmt::format("    read of {}: nothing\n", read.read)
                 : fmt::format("    read {} {}, {}\n", read.read, read.number,
                               read.age_us < 0 ? "whose release is not in the trace"
                                               : in_ms(read.age_us) + " ms after its release");
  };
  for (const StoryJob& job : story.jobs) {
    sensors_until(job.began_us);
    tell(job);
  }
  sensors_until(INT64_MAX);
  if (story.cut) out += fmt::format("  It goes back further; {} jobs are shown.\n", kMostStoryJobs);
  if (!story.own.empty()) {
    out +=
        fmt::format("\n  Also made of release {}, and not what is told above:\n\n", story.number);
    for (const StoryJob& job : story.own) tell(job);
  }
  if (!story.missed.empty()) {
    out += fmt::format("\n  On the same way meanwhile, without release {}:\n\n", story.number);
    for (const StoryJob& job : story.missed) tell(job);
  }
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
