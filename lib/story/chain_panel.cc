// SPDX-License-Identifier: Apache-2.0
#include "story/chain_panel.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/quantile.h"
#include "story/chain_story.h"
#include "story/html.h"
#include "story/waterfall.h"

namespace xauto::story {
namespace {

constexpr int kStripPx = 24;
/// More dots are not told apart. The longest ones are always there.
constexpr std::size_t kMostDots = 1200, kAlwaysDots = 200;
/// A deadline further off than so many times what was seen is told, and not drawn: nothing else could be seen.
constexpr std::int64_t kFarDeadline = 3;

/// One run's part of a panel.
struct Part {
  const PagedRun* run = nullptr;
  const TraceReactions* reactions = nullptr;  ///< null: the trace has none
  ChainCounts counts;
  bool whole_run = false;  ///< so are the counts
};

ChainCounts counted(const TraceReactions& chain) {
  ChainCounts counts{chain.name, static_cast<std::int64_t>(chain.releases.size())};
  std::vector<std::int64_t> us;
  for (const TraceReactions::One& one : chain.releases) us.push_back(one.reaction_us);
  std::sort(us.begin(), us.end());
  if (!us.empty()) {
    counts.p50_us = quantile_of_sorted(us, 0.5);
    if (us.size() >= kLeastOfP99) counts.p99_us = quantile_of_sorted(us, 0.99);
    counts.max_us = us.back();
  }
  counts.deadline_us = chain.deadline_us;
  if (chain.deadline_us >= 0)
    counts.misses = us.end() - std::upper_bound(us.begin(), us.end(), chain.deadline_us);
  return counts;
}

std::optional<Part> part_of(const std::string& chain, const PagedRun& run) {
  Part part{&run};
  for (const TraceReactions& one : run.trace.reactions)
    if (one.name == chain) part.reactions = &one;
  for (const ChainCounts& one : run.trace.counts)
    if (one.name == chain) part.counts = one, part.whole_run = true;
  if (part.reactions == nullptr && !part.whole_run) return std::nullopt;
  if (!part.whole_run) part.counts = counted(*part.reactions);
  if (part.counts.deadline_us < 0 && part.reactions != nullptr)
    part.counts.deadline_us = part.reactions->deadline_us;
  return part;
}

/// The axis that all runs of a chain share, from 0.
struct Axis {
  std::int64_t to_us = 1;
  [[nodiscard]] std::string at(std::int64_t us) const {
    return fmt::format("{:.2f}%", 100 * static_cast<double>(us) / static_cast<double>(to_us));
  }
};

Axis axis_of(const std::vector<Part>& parts) {
  std::int64_t seen_us = 1, deadline_us = -1;
  for (const Part& part : parts) {
    seen_us = std::max({seen_us, part.counts.max_us, part.counts.worst_case_us});
    deadline_us = std::max(deadline_us, part.counts.deadline_us);
    if (part.reactions == nullptr) continue;
    for (const auto& one : part.reactions->releases) seen_us = std::max(seen_us, one.reaction_us);
  }
  if (deadline_us <= kFarDeadline * seen_us) seen_us = std::max(seen_us, deadline_us);
  return {seen_us + seen_us / 20};
}

std::string line(const Axis& axis, std::int64_t us, const char* css, const std::string& title) {
  if (us < 0 || us > axis.to_us) return {};
  const std::string x = axis.at(us);
  return fmt::format("<line class='{}' x1='{}' x2='{}' y1='0' y2='{}'><title>{}</title></line>",
                     css, x, x, kStripPx, html_safe(title));
}

std::string strip(const Part& part, const Axis& axis) {
  std::string svg = fmt::format(
      "<svg class='strip' height='{}' role='img' aria-label='how long each release took under {}'>",
      kStripPx, html_safe(policy_of(part.run->trace)));
  std::vector<const TraceReactions::One*> list;
  for (const auto& one : part.reactions->releases) list.push_back(&one);
  std::stable_sort(list.begin(), list.end(),
                   [](const auto* a, const auto* b) { return a->reaction_us > b->reaction_us; });
  const std::size_t step =
      list.size() <= kMostDots ? 1 : list.size() / (kMostDots - kAlwaysDots) + 1;
  std::size_t drawn = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    if (i >= kAlwaysDots && i % step != 0) continue;
    ++drawn;
    svg += fmt::format("<circle cx='{}' cy='{}' r='2'/>", axis.at(list[i]->reaction_us),
                       4 + list[i]->number * 7 % (kStripPx - 8));
  }
  const ChainCounts& c = part.counts;
  svg += line(axis, c.lower_bound_us, "bound",
              "no policy claims less than " + page_ms(c.lower_bound_us) + " ms");
  svg += line(axis, c.worst_case_us, "claim", "claimed: " + page_ms(c.worst_case_us) + " ms");
  svg += line(axis, c.deadline_us, "deadline", "deadline: " + page_ms(c.deadline_us) + " ms");
  return svg + "</svg>" +
         (drawn == list.size()
              ? ""
              : fmt::format("<p class='dim'>{} of {} dots: the {} longest, and 1 of {} others</p>",
                            drawn, list.size(), kAlwaysDots, step));
}

std::string axis_html(const Axis& axis) {
  double step = 1;
  const double to_ms = static_cast<double>(axis.to_us) / 1000;
  const double wanted = to_ms / 5;
  const double decade = std::pow(10, std::floor(std::log10(wanted)));
  for (const int times : {1, 2, 5, 10})
    if (times * decade >= wanted * 0.999) {
      step = times * decade;
      break;
    }
  std::string html = "<div class='axis'>";
  for (double ms = 0; ms <= to_ms * 0.96; ms += step)
    html += fmt::format("<span style='left:{}'>{:g}{}</span>",
                        axis.at(static_cast<std::int64_t>(ms * 1000)), ms, ms == 0 ? " ms" : "");
  return html + "</div>";
}

/// What was counted and claimed, in a line.
std::string numbers(const Part& part) {
  const ChainCounts& c = part.counts;
  std::string text = fmt::format("p50 {}, p99 {}, max {} of {} results", ms_in_row(c.p50_us),
                                 ms_in_row(c.p99_us), ms_in_row(c.max_us), c.results);
  const ReadTrace& trace = part.run->trace;
  if (!part.whole_run && trace.overwritten > 0)
    text += fmt::format(" (of the last {:.1f} s)",
                        static_cast<double>(trace.end_ns - trace.begin_ns) * 1e-9);
  std::string html = "<span class='dim'>" + text + "</span>";
  if (c.worst_case_us >= 0)
    html += fmt::format(" <span>claimed {}{}</span>", page_ms(c.worst_case_us),
                        c.exceeded                   ? ": <b class='bad'>exceeded</b>"
                        : c.max_us > c.worst_case_us ? ": within the emulator's part"
                                                     : "");
  if (c.misses > 0) html += fmt::format(" <b class='bad'>{} missed the deadline</b>", c.misses);
  if (c.lost > 0) html += fmt::format(" <b class='bad'>{} lost</b>", c.lost);
  return html;
}

std::string url_of(const std::string& path) {
  std::string out;
  for (const char c : path) {
    const auto byte = static_cast<unsigned char>(c);
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                       c == '-' || c == '_' || c == '.' || c == '/';
    out += plain ? std::string(1, c) : fmt::format("%{:02X}", byte);
  }
  return out;
}

std::string release_html(const Part& part, const TraceReactions::One& release, const char* which,
                         bool open) {
  const ReadTrace& trace = part.run->trace;
  std::string html = fmt::format("<details{}><summary>{}: {} release, {}, took {} ms</summary>",
                                 open ? " open" : "", html_safe(policy_of(trace)), which,
                                 release.number, page_ms(release.reaction_us));
  const auto story = story_of(trace, *part.reactions, release);
  if (!story)
    return html + "<p class='dim'>" + html_safe(story.error().to_string()) + "</p></details>";
  std::string place = fmt::format(
      "at {:.3f} s: search there for “{} {}”",
      static_cast<double>(std::max<std::int64_t>(0, release.released_ns - trace.begin_ns)) * 1e-9,
      html_safe(part.reactions->name), release.number);
  if (!part.run->file.empty())
    place = fmt::format("<a href='{}'>{}</a> (for ui.perfetto.dev) has it {}.",
                        html_safe(url_of(part.run->file)),
                        html_safe(part.run->file.substr(part.run->file.rfind('/') + 1)), place);
  else
    place = "A trace (--trace-out) would have it " + place + ".";
  html += "<p>" + html_safe(way_text(*story)) + ". <span class='dim'>" + place + "</span></p>";
  return html + waterfall(trace, release, *story) + "</details>";
}

}  // namespace

std::string policy_of(const ReadTrace& trace) {
  const auto colon = trace.title.rfind(": ");
  return colon == std::string::npos ? trace.title : trace.title.substr(colon + 2);
}

std::vector<std::string> chains_of(const std::vector<PagedRun>& runs) {
  std::vector<std::string> names;
  const auto add = [&](const std::string& name) {
    if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  };
  for (const PagedRun& run : runs) {
    for (const ChainCounts& counts : run.trace.counts) add(counts.name);
    for (const TraceReactions& chain : run.trace.reactions) add(chain.name);
  }
  return names;
}

std::string legend() {
  std::string html = "<p class='legend'>";
  for (const auto& [css, text] :
       {std::pair{"run", "running"}, std::pair{"wait", "waiting for another"},
        std::pair{"held", "held by the policy"}, std::pair{"off", "suspended"},
        std::pair{"core", "not run by the kernel (where in a job is not known)"},
        std::pair{"gap", "late, missed, or not yet taken"}, std::pair{"key", "key"}})
    html += fmt::format("<span><i class='{}'></i>{}</span>", css, text);
  for (const auto& [css, text] : {std::pair{"claim", "claim"}, std::pair{"bound", "bound"},
                                  std::pair{"deadline", "deadline"}})
    html += fmt::format("<span><i class='rule {}'></i>{}</span>", css, text);
  return html + "</p>";
}

std::string chain_panel(const std::string& chain, const std::vector<PagedRun>& runs) {
  std::vector<Part> parts;
  for (const PagedRun& run : runs)
    if (auto part = part_of(chain, run)) parts.push_back(*part);
  const auto deadline = std::find_if(parts.begin(), parts.end(),
                                     [](const Part& p) { return p.counts.deadline_us >= 0; });
  std::string html = "<section class='card'><h2>" + html_safe(chain) + "</h2><p class='dim'>";
  if (!parts.empty() && parts.front().reactions != nullptr) {
    const std::string& note = parts.front().reactions->note;  // "from source front; worst case ..."
    html += html_safe(note.substr(0, note.find(';')));
  }
  if (deadline != parts.end())
    html += ", deadline " + page_ms(deadline->counts.deadline_us) + " ms";
  html += "</p>";
  const Axis axis = axis_of(parts);
  bool drawn = false;
  for (const Part& part : parts) {
    html += fmt::format("<p class='run'><b>{}</b> {}</p>", html_safe(policy_of(part.run->trace)),
                        numbers(part));
    if (part.reactions == nullptr || part.reactions->releases.empty()) continue;
    html += strip(part, axis);
    drawn = true;
  }
  if (drawn) html += axis_html(axis);
  for (const Part& part : parts) {
    if (part.reactions == nullptr || part.reactions->releases.empty()) continue;
    const TraceReactions::One* worst = worst_of(*part.reactions);
    const TraceReactions::One* median = median_of(*part.reactions);
    html += release_html(part, *worst, "slowest", &part == &parts.back());
    if (median != worst) html += release_html(part, *median, "median", false);
  }
  return html + "</section>";
}

}  // namespace xauto::story
