// SPDX-License-Identifier: Apache-2.0
// Bars are boxes of a width in percent, so they fit any screen, and their text stays text.
#include "story/waterfall.h"

#include <algorithm>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "story/html.h"
#include "story/lanes.h"

namespace xauto::story {
namespace {

constexpr std::size_t kMostRows = 60;
/// Of the whole width: what is narrower is not seen.
constexpr std::int64_t kLeastPart = 2000;

class Scale {
 public:
  explicit Scale(std::int64_t to_us) : to_us_(std::max<std::int64_t>(1, to_us)) {}
  /// Empty: it is not within the picture.
  [[nodiscard]] std::string bar(std::int64_t from_us, std::int64_t until_us, const char* css,
                                const std::string& title, const std::string& text = {},
                                const std::string& style = {}) const {
    from_us = std::max<std::int64_t>(0, from_us);
    until_us = std::min(until_us, to_us_);
    if (until_us <= from_us) return {};
    return fmt::format("<i class='{}' style='left:{:.2f}%;width:{:.2f}%{}' title='{}'>{}</i>", css,
                       percent(from_us), percent(until_us - from_us), style, html_safe(title),
                       html_safe(text));
  }
  [[nodiscard]] std::string mark(std::int64_t us, const char* css, const std::string& title) const {
    if (us < 0 || us > to_us_) return {};
    return fmt::format("<i class='{}' style='left:{:.2f}%' title='{}'></i>", css, percent(us),
                       html_safe(title));
  }

 private:
  [[nodiscard]] double percent(std::int64_t us) const {
    return 100 * static_cast<double>(us) / static_cast<double>(to_us_);
  }
  std::int64_t to_us_;
};

std::string row(const std::string& who, const std::string& on, const std::string& bars,
                const std::string& why, const std::string& style = {}) {
  return fmt::format(
      "<div class='row'><span class='who'>{}<span class='dim'> {}</span></span><span "
      "class='lane'{}>{}</span>{}"
      "</div>",
      html_safe(who), html_safe(on), style, bars,
      why.empty() ? "" : "<span class='why'>" + html_safe(why) + "</span>");
}

std::string lasted(const char* what, std::int64_t us) {
  return fmt::format("{} {} ms", what, page_ms(us));
}

/// The whole of it, stretch by stretch.
std::string way_bar(const ChainStory& story, const Scale& scale) {
  std::string bars;
  for (const Spent& spent : story.way) {
    const std::int64_t us = spent.end_us - spent.begin_us;
    const std::string whose =
        spent.job < 0 ? "" : story.jobs[static_cast<std::size_t>(spent.job)].xnode;
    bars += scale.bar(spent.begin_us, spent.end_us, css_class(spent.on),
                      lasted(to_string(spent.on), us) + (whose.empty() ? "" : ", " + whose),
                      spent.on == SpentOn::kRunning ? whose : "");
  }
  return bars.empty() ? "" : row("all of it", "", bars, "");
}

std::string job_bars(const StoryJob& job, const Scale& scale) {
  const std::int64_t free_us =
      std::clamp(job.held_until_us.value_or(job.ready_us), job.ready_us, job.began_us);
  std::string bars =
      scale.bar(job.ready_us - job.late_us, job.ready_us, css_class(SpentOn::kSource),
                lasted("its source was late for", job.late_us));
  bars += scale.bar(job.ready_us, free_us, css_class(SpentOn::kHeld),
                    lasted("held", free_us - job.ready_us));
  bars += scale.bar(free_us, job.began_us, css_class(SpentOn::kWaiting),
                    waited_text(job.began_us - free_us, job.waited_for));
  std::int64_t off_us = job.began_us;
  for (const auto& [begin_us, end_us] : job.parts) {
    bars += scale.bar(off_us, begin_us, css_class(SpentOn::kSuspended),
                      lasted("off the XPU for", begin_us - off_us));
    bars +=
        scale.bar(begin_us, end_us, css_class(SpentOn::kRunning), lasted("ran", end_us - begin_us));
    off_us = end_us;
  }
  bars += scale.bar(job.ended_us - job.without_core_us, job.ended_us, css_class(SpentOn::kNoCore),
                    lasted("of it the kernel ran others for", job.without_core_us));
  if (job.key_us)
    bars += scale.mark(*job.key_us, "key", "its key: " + page_ms(*job.key_us) + " ms");
  return bars;
}

std::string reads_of(const StoryJob& job) {
  std::string text;
  for (const StoryRead& read : job.reads)
    text += fmt::format("{}read {} {}", text.empty() ? "" : "; ", read.read,
                        read.number < 0 ? "(nothing)" : std::to_string(read.number));
  return text;
}

std::string job_rows(const std::vector<StoryJob>& jobs, const Scale& scale) {
  std::string rows;
  std::string before;
  std::size_t left = kMostRows;
  for (const StoryJob& job : jobs) {
    if (job.ended_us <= 0) {
      before += fmt::format("{}{} {}", before.empty() ? "" : ", ", job.xnode, job.number);
      continue;
    }
    if (left == 0) break;
    --left;
    std::string why = reasons_of(job);
    if (const std::string reads = reads_of(job); !reads.empty())
      why += (why.empty() ? "" : "; ") + reads;
    rows += row(fmt::format("{} {}", job.xnode, job.number), job.xpu, job_bars(job, scale), why);
  }
  if (left == 0) rows += fmt::format("<p class='dim'>The first {} jobs are shown.</p>", kMostRows);
  if (!before.empty())
    rows = "<p class='dim'>From before the release: " + html_safe(before) + "</p>" + rows;
  return rows;
}

/// What each XPU did meanwhile; jobs on the way stand out.
std::string xpu_rows(const ReadTrace& trace, const TraceReactions::One& release,
                     const ChainStory& story, const Scale& scale) {
  struct Meanwhile {
    std::int64_t begin, end;
    const TraceSlice* slice;
    int lane = 0;
  };
  std::set<std::pair<std::int64_t, std::string>> own;
  for (const StoryJob& job : story.jobs) own.emplace(job.activation, job.xnode);
  std::vector<std::vector<Meanwhile>> pieces(trace.rows.size());
  const std::int64_t until_ns = release.released_ns + story.reaction_us * 1000;
  for (const TraceSlice& s : trace.run) {
    if (s.begin_ns >= until_ns) break;
    if (s.end_ns <= release.released_ns) continue;
    if ((s.end_ns - s.begin_ns) / 1000 * kLeastPart < story.reaction_us) continue;
    pieces[static_cast<std::size_t>(s.row)].push_back({s.begin_ns, s.end_ns, &s});
  }
  constexpr int kLanePx = 16;
  std::string rows;
  for (std::size_t r = 0; r < pieces.size(); ++r) {
    if (pieces[r].empty()) continue;
    std::vector<Meanwhile*> list;
    for (Meanwhile& piece : pieces[r])  // a job that was let on during a switch overlaps it
      if (piece.slice->category != "switch") list.push_back(&piece);
    const int lanes = std::max(1, assign_lanes(list));
    for (Meanwhile& piece : pieces[r])
      if (piece.slice->category == "switch") list.push_back(&piece);
    std::string bars;
    for (const Meanwhile* piece : list) {
      const TraceSlice& s = *piece->slice;
      const bool switching = s.category == "switch";
      const bool on_the_way = !switching && own.contains({s.activation, s.name});
      const std::int64_t from_us = (s.begin_ns - release.released_ns) / 1000,
                         to_us = (s.end_ns - release.released_ns) / 1000;
      bars += scale.bar(
          from_us, to_us,
          switching    ? "switch"
          : on_the_way ? "run"
                       : "other",
          fmt::format("{} {}, {} to {} ms", s.name, s.release, page_ms(from_us), page_ms(to_us)),
          switching ? "" : s.name, fmt::format(";top:{}px", piece->lane * kLanePx));
    }
    rows += row(trace.rows[r], "", bars, "", fmt::format(" style='height:{}px'", lanes * kLanePx));
  }
  return rows.empty() ? "" : "<h3>Who had the XPUs</h3>" + rows;
}

}  // namespace

const char* css_class(SpentOn on) {
  switch (on) {
    case SpentOn::kRunning:
      return "run";
    case SpentOn::kHeld:
      return "held";
    case SpentOn::kWaiting:
      return "wait";
    case SpentOn::kSuspended:
      return "off";
    case SpentOn::kNoCore:
      return "core";
    case SpentOn::kMissed:
    case SpentOn::kSource:
    case SpentOn::kUntaken:
    case SpentOn::kUntold:
      break;
  }
  return "gap";
}

std::string waterfall(const ReadTrace& trace, const TraceReactions::One& release,
                      const ChainStory& story) {
  const Scale scale(story.reaction_us);
  std::string html = way_bar(story, scale) + job_rows(story.jobs, scale);
  if (!story.own.empty())
    html +=
        fmt::format("<h3>Also made of release {}, and not what is told above</h3>", story.number) +
        job_rows(story.own, scale);
  if (!story.missed.empty())
    html += fmt::format("<h3>On the same way meanwhile, without release {}</h3>", story.number) +
            job_rows(story.missed, scale);
  return html + xpu_rows(trace, release, story, scale);
}

}  // namespace xauto::story
