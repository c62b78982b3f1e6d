// SPDX-License-Identifier: Apache-2.0
#include "story/chain_story.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/columns.h"
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
  void follow(std::size_t release, std::int64_t until_ns,
              const std::pair<std::int64_t, std::string>& end, ChainStory& into) const {
    std::set<std::string> on_the_way;
    for (const StoryJob& job : into.jobs) on_the_way.insert(job.xnode);
    const TraceRelease& itself = trace_.releases[release];
    const std::set<Job> knows = made_of(until_ns, [&](int r) { return at(r) == release; });
    const auto is_newer = [&](int r) {
      const TraceRelease& other = trace_.releases[at(r)];
      return other.source == itself.source && other.number > itself.number;
    };
    const std::set<Job> newer = made_of(until_ns, is_newer);
    find_way(release, end, knows, newer, into);
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

  /// Writes `way` from its end to its begin.
  class Way {
   public:
    Way(ChainStory& into, std::int64_t reaction_us) : into_(into), from_us_(reaction_us) {}
    /// What went on since then, until what is there already.
    void back_to(std::int64_t us, SpentOn on, int job) {
      us = std::max<std::int64_t>(us, 0);
      if (us >= from_us_) return;
      into_.way.insert(into_.way.begin(), Spent{on, job, us, from_us_});
      from_us_ = us;
    }
    [[nodiscard]] bool done() const { return from_us_ <= 0; }

   private:
    ChainStory& into_;
    std::int64_t from_us_;
  };

  static void add_job(const StoryJob& job, int index, Way& way) {
    std::int64_t off_since_us = job.ended_us;
    for (auto part = job.parts.rbegin(); part != job.parts.rend(); ++part) {
      way.back_to(part->second, SpentOn::kSuspended, index);
      if (part == job.parts.rbegin() && job.without_core_us > 0)
        way.back_to(part->second - std::min(job.without_core_us, part->second - part->first),
                    SpentOn::kNoCore, index);
      way.back_to(part->first, SpentOn::kRunning, index);
      off_since_us = part->first;
    }
    const std::int64_t free_us =
        std::min(off_since_us, std::max(job.ready_us, job.held_until_us.value_or(job.ready_us)));
    way.back_to(free_us, SpentOn::kWaiting, index);
    way.back_to(job.ready_us, SpentOn::kHeld, index);
  }

  void find_way(std::size_t release, const Job& end, const std::set<Job>& knows,
                const std::set<Job>& newer, ChainStory& into) const {
    std::map<Job, int> index;
    for (std::size_t j = 0; j < into.jobs.size(); ++j)
      index[{into.jobs[j].activation, into.jobs[j].xnode}] = static_cast<int>(j);
    const TraceRelease& itself = trace_.releases[release];
    // The last of those that know the release itself: of all that a result is made of, the oldest counts. Where none
    // does, of those that know a newer one.
    const auto rank_of = [&](int j) {
      const StoryJob& job = into.jobs[at(j)];
      return std::pair{knows.contains({job.activation, job.xnode}), job.ended_us};
    };
    const auto later = [&](int best, const Job& job) {
      const auto found = index.find(job);
      if (found == index.end() || !(knows.contains(job) || newer.contains(job))) return best;
      return best < 0 || rank_of(found->second) >= rank_of(best) ? found->second : best;
    };
    const auto job_of_slice = [&](int slice) {
      return Job{trace_.run[at(slice)].activation, trace_.run[at(slice)].name};
    };
    int job = index.at(end);
    bool at_release = false;
    Way way(into, into.reaction_us);
    std::set<int> been;
    while (job >= 0 && been.insert(job).second && !way.done()) {
      const StoryJob& here = into.jobs[at(job)];
      way.back_to(here.ended_us, SpentOn::kUntaken, job);
      add_job(here, job, way);
      const TraceSlice& first = trace_.run[parts_.at({here.activation, here.xnode}).front()];
      int before = -1;
      for (const int slice : first.from) before = later(before, job_of_slice(slice));
      std::int64_t released_us =
          -1;  // of a sensor's message that it has read itself: the oldest that counts
      const auto reads = [&](int r) {
        const TraceRelease& other = trace_.releases[at(r)];
        if (other.source != itself.source || other.number < itself.number) return;
        const std::int64_t us = since(other.begin_ns);
        released_us = released_us < 0 ? us : std::min(released_us, us);
      };
      for (const int r : first.releases) reads(r);
      const bool fired = released_us >= 0;
      for (const TraceSample& sample : first.samples) {
        if (sample.slice >= 0) before = later(before, job_of_slice(sample.slice));
        if (sample.release >= 0) reads(sample.release);
      }
      if (released_us >= 0 && (before < 0 || (released_us == 0 && !rank_of(before).first))) {
        before = -1;
        way.back_to(released_us, fired ? SpentOn::kSource : SpentOn::kUntaken, -1);
        at_release = true;
      }
      job = before;
    }
    way.back_to(0, at_release ? SpentOn::kMissed : SpentOn::kUntold, -1);
  }

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
    job.activation = first.activation;
    job.began_us = since(first.begin_ns);
    job.ready_us = job.began_us - first.waited_us;
    job.ended_us = since(last.end_ns);
    std::int64_t off_ns = first.end_ns;
    for (const std::size_t part : parts) {
      const TraceSlice& piece = trace_.run[part];
      job.ran_us += (piece.end_ns - piece.begin_ns) / 1000;
      job.parts.emplace_back(since(piece.begin_ns), since(piece.end_ns));
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
    job.without_core_us = std::min(last.without_core_us, job.ran_us);
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

/// What it waited for, of one stretch on the way: the most of it, or nothing.
std::string whom_of(const ChainStory& story, const Spent& spent) {
  if (spent.job < 0) return {};
  const StoryJob& job = story.jobs[at(spent.job)];
  const std::vector<Blocker>& list =
      spent.on == SpentOn::kWaiting ? job.waited_for : job.preempted_by;
  return list.empty() ? "" : list.front().who;
}

}  // namespace

const char* to_string(SpentOn on) {
  switch (on) {
    case SpentOn::kMissed:
      return "missed, waiting for the next release";
    case SpentOn::kSource:
      return "source late";
    case SpentOn::kHeld:
      return "held";
    case SpentOn::kWaiting:
      return "waiting";
    case SpentOn::kRunning:
      return "running";
    case SpentOn::kSuspended:
      return "off the XPU";
    case SpentOn::kNoCore:
      return "not run by the kernel";
    case SpentOn::kUntaken:
      return "made, and not yet taken";
    case SpentOn::kUntold:
      break;
  }
  return "not told by the trace";
}

std::string way_text(const ChainStory& story) {
  std::map<SpentOn, std::int64_t> sums;
  std::map<SpentOn, const Spent*> longest;
  for (const Spent& spent : story.way) {
    sums[spent.on] += spent.end_us - spent.begin_us;
    const Spent*& most = longest[spent.on];
    if (most == nullptr || spent.end_us - spent.begin_us > most->end_us - most->begin_us)
      most = &spent;
  }
  std::vector<std::pair<SpentOn, std::int64_t>> list(sums.begin(), sums.end());
  std::stable_sort(list.begin(), list.end(),
                   [](const auto& a, const auto& b) { return a.second > b.second; });
  std::string out = in_ms(story.reaction_us) + " ms";
  bool first = true;
  for (const auto& [on, us] : list) {
    if (us < kWorthSayingUs) continue;
    out += (std::exchange(first, false) ? ": " : ", ") + in_ms(us) + " " + to_string(on);
    if (on != SpentOn::kWaiting && on != SpentOn::kSuspended) continue;
    if (const std::string whom = whom_of(story, *longest.at(on)); !whom.empty())
      out += fmt::format(" (the most for {})", whom);
  }
  return out;
}

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
                  release.released_ns + release.reaction_us * 1000,
                  {release.activation, release.xnode}, story);
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
  if (job.without_core_us >= kWorthSayingUs)
    say("for " + in_ms(job.without_core_us) + " ms the kernel ran others on its core");
  return out;
}

std::string story_text(const ChainStory& story) {
  constexpr std::size_t kOfStory = 18;
  std::string out = fmt::format("{}: {} {} took {} ms, ", story.chain,
                                story.urgent ? "urgent release" : "release", story.number,
                                in_ms(story.reaction_us));
  out += story.rank == 1 ? fmt::format("the longest of {}", story.of)
                         : fmt::format("number {} from the longest of {}", story.rank, story.of);
  out += fmt::format("; the median is {}.\n  {}\n", in_ms(story.median_us), story.note);
  if (!story.way.empty()) out += "  On its way, " + way_text(story) + ".\n";
  out += "\n  All in ms since that release.\n\n";
  out += row_of("XNode", kOfStory) + fmt::format("{:>6}  ", "n") + left("on", 8) +
         fmt::format("{:>8}{:>9}{:>9}{:>9}{:>9}\n", "ready", "began", "ended", "key", "lateness");
  std::size_t next = 0;
  const auto sensors_until = [&](std::int64_t us) {
    for (; next < story.sensors.size() && story.sensors[next].released_us <= us; ++next) {
      const StorySensor& sensor = story.sensors[next];
      out += row_of("source " + sensor.source, kOfStory) +
             fmt::format("{:>6}  released{:>8}\n", sensor.number, in_ms(sensor.released_us));
    }
  };
  const auto tell = [&](const StoryJob& job) {
    out += row_of(job.xnode, kOfStory) + fmt::format("{:>6}  ", job.number) + left(job.xpu, 8) +
           fmt::format("{:>8}{:>9}{:>9}{:>9}{:>9}\n", in_ms(job.ready_us), in_ms(job.began_us),
                       in_ms(job.ended_us), or_dash(job.key_us), or_dash(job.lateness_us, true));
    if (const std::string why = reasons_of(job); !why.empty())
      out += wrapped("    " + why, 6) + "\n";
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
