// SPDX-License-Identifier: Apache-2.0
// Sections are written here as plain HTML, every text from outside through html_safe(); the
// schedule below them is the timeline page's (timeline.h), showing the slowest release instead
// of the median one.
#include "story/html_report.h"

#include <algorithm>
#include <map>
#include <sstream>

#include <fmt/format.h>

#include "base/quantile.h"
#include "story/chain_story.h"
#include "story/timeline.h"

namespace xauto::story {
namespace {

using Latencies = std::vector<std::int64_t>;

std::string ms(std::int64_t us) {
  return fmt::format("{:.2f}", static_cast<double>(us) / 1000);
}

Latencies latencies_of(const std::vector<TraceResult>& results) {
  Latencies list;
  for (const TraceResult& result : results) list.push_back(result.latency_us);
  return list;
}

std::map<std::string, Latencies> latencies_by_output(const ReadTrace& trace) {
  std::map<std::string, Latencies> out;
  for (const TraceOutputs& outputs : trace.outputs) {
    Latencies& list = out[outputs.module] = latencies_of(outputs.results);
    std::sort(list.begin(), list.end());
  }
  return out;
}

/// As bars, from the least to the greatest latency of the page's section.
std::string histogram(const Latencies& sorted, std::int64_t from, std::int64_t to) {
  constexpr int kBins = 48;
  std::vector<int> bins(kBins, 0);
  for (const std::int64_t us : sorted)
    ++bins[static_cast<std::size_t>(std::min<std::int64_t>(
        kBins - 1, (us - from) * kBins / std::max<std::int64_t>(1, to - from)))];
  const int most = std::max(1, *std::max_element(bins.begin(), bins.end()));
  std::string svg = fmt::format(
      "<svg viewBox='0 0 240 34' style='width:240px' role='img' aria-label='distribution from {} "
      "to {} ms'>"
      "<line class='grid' x1='0' x2='240' y1='33' y2='33'/>",
      ms(from), ms(to));
  for (int b = 0; b < kBins; ++b) {
    const int count = bins[static_cast<std::size_t>(b)];
    if (count == 0) continue;
    const int height = std::max(2, 32 * count / most);
    svg += fmt::format("<rect x='{}' y='{}' width='4' height='{}' fill='var(--accent)'/>", b * 5,
                       33 - height, height);
  }
  return svg + "</svg>";
}

/// Where the trace has lost its beginning, no number is of the whole run.
std::string window_of(const ReadTrace& trace) {
  return trace.overwritten == 0
             ? ""
             : fmt::format(" (of the last {:.1f} s)",
                           static_cast<double>(trace.end_ns - trace.begin_ns) * 1e-9);
}

std::string outputs_section(const ReadTrace& trace) {
  const auto outputs = latencies_by_output(trace);
  if (outputs.empty()) return "<p class='dim'>No latency: no result is in the trace.</p>";
  std::int64_t from = outputs.begin()->second.front(), to = from;
  for (const auto& [name, list] : outputs) {
    from = std::min(from, list.front());
    to = std::max(to, list.back());
  }
  const bool deadline = trace.deadline_us >= 0;
  std::string html = fmt::format(
      "<table><tr><th>output of, ms{}</th><th>n</th><th>p50</th><th>p99</th><th>max</th>{}"
      "<th style='text-align:left'>from {} to {} ms</th></tr>",
      window_of(trace), deadline ? "<th>missed</th>" : "", ms(from), ms(to));
  for (const auto& [name, list] : outputs) {
    const auto misses = std::count_if(list.begin(), list.end(), [&](std::int64_t us) {
      return deadline && us > trace.deadline_us;
    });
    html += fmt::format(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{}"
        "<td style='text-align:left'>{}</td></tr>",
        html_safe(name), list.size(), ms(quantile_of_sorted(list, 0.5)),
        list.size() < kLeastOfP99 ? "-" : ms(quantile_of_sorted(list, 0.99)), ms(list.back()),
        deadline ? fmt::format("<td>{}</td>", misses) : "", histogram(list, from, to));
  }
  return html + "</table>";
}

/// Counts of the whole run; of one that goes on, of what the trace has.
std::vector<ChainCounts> counts_of(const ReadTrace& trace) {
  if (!trace.counts.empty()) return trace.counts;
  std::vector<ChainCounts> list;
  for (const TraceReactions& chain : trace.reactions) {
    ChainCounts counts{chain.name, static_cast<std::int64_t>(chain.releases.size())};
    Latencies us;
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
    list.push_back(std::move(counts));
  }
  return list;
}

/// Line by line; what begins with a dash is an item.
std::string verdict_html(const std::string& verdict) {
  std::string html = "<p>", line;
  std::istringstream lines(verdict);
  bool listed = false;
  while (std::getline(lines, line)) {
    line.erase(0, line.find_first_not_of(' '));
    if (!line.starts_with("- ")) {
      html += (listed ? "</ul>" : "") + html_safe(line) + " ";
      listed = false;
      continue;
    }
    html += (listed ? "<li>" : "<ul><li>") + html_safe(line.substr(2)) + "</li>";
    listed = true;
  }
  return html + (listed ? "</ul>" : "</p>");
}

/// The way of its slowest release, job by job.
std::string story_section(const ReadTrace& trace, const TraceReactions& chain) {
  const TraceReactions::One* worst = worst_of(chain);
  if (worst == nullptr) return {};
  std::string html =
      fmt::format("<h2>Slowest release of {}{}: {}, {} ms</h2>", html_safe(chain.name),
                  window_of(trace), worst->number, ms(worst->reaction_us));
  const auto story = story_of(trace, chain, *worst);
  if (!story) return html + "<p class='dim'>" + html_safe(story.error().to_string()) + "</p>";
  html +=
      "<table class='worst'><tr><th>XNode, ms since then</th><th style='text-align:left'>on</th>"
      "<th>ready</th><th>began</th><th>ended</th><th>key</th>"
      "<th style='text-align:left'>why not sooner</th></tr>";
  const auto tell = [&](const StoryJob& job) {
    std::string why = reasons_of(job);
    for (const StoryRead& read : job.reads)
      why += fmt::format("{}read {} {}", why.empty() ? "" : "; ", read.read,
                         read.number < 0 ? "(nothing)" : std::to_string(read.number));
    html += fmt::format(
        "<tr><td>{} {}</td><td style='text-align:left'>{}</td><td>{}</td><td>{}</td><td>{}</td>"
        "<td>{}</td><td style='text-align:left'>{}</td></tr>",
        html_safe(job.xnode), job.number, html_safe(job.xpu), ms(job.ready_us), ms(job.began_us),
        ms(job.ended_us), job.key_us ? ms(*job.key_us) : "", html_safe(why));
  };
  const auto head = [&](const std::string& text) {
    html += "<tr><td colspan='7' class='dim'>" + text + "</td></tr>";
  };
  for (const StoryJob& job : story->jobs) tell(job);
  if (!story->own.empty())
    head(fmt::format("also made of {}, and not what is told above:", worst->number));
  for (const StoryJob& job : story->own) tell(job);
  if (!story->missed.empty())
    head(fmt::format("on the same way meanwhile, without {}:", worst->number));
  for (const StoryJob& job : story->missed) tell(job);
  return html + "</table>";
}

/// Of a run with tables: its scenarios, the last changes with their reasons, and what met them.
std::string tables_section(const ReadTrace& trace) {
  if (trace.scenarios.empty() && trace.changes.empty()) return {};
  const auto time = [](std::int64_t us) { return us < 0 ? std::string("-") : ms(us); };
  std::string html = "<h2>Scenarios</h2><p class='dim'>" + html_safe(trace.verdict) + "</p>";
  if (!trace.scenarios.empty()) {
    html +=
        "<table><tr><th>scenario</th><th style='text-align:left'>table</th><th>releases</th>"
        "</tr>";
    for (const TraceScenario& s : trace.scenarios)
      html += fmt::format("<tr><td>{}</td><td style='text-align:left'>{}</td><td>{}</td></tr>",
                          html_safe(s.name), html_safe(s.table), s.releases);
    html += "</table>";
  }
  constexpr std::size_t kShown = 100;
  const std::size_t first = trace.changes.size() - std::min(kShown, trace.changes.size());
  html += fmt::format("<h2>Changes of the scenario: {}{}</h2>", trace.changes.size(),
                      first > 0 ? fmt::format(", the last {}", kShown) : "");
  if (trace.changes.empty()) return html;
  const TraceChange* nearest = nullptr;
  const auto share = [](const TraceChange& c) {
    return static_cast<double>(c.spanned_us) / static_cast<double>(c.worst_case_us);
  };
  for (const TraceChange& c : trace.changes)
    if (c.spanned_us >= 0 && c.worst_case_us > 0 &&
        (nearest == nullptr || share(c) > share(*nearest)))
      nearest = &c;
  if (nearest != nullptr)
    html += fmt::format(
        "<p>Of what met a change the nearest to its worst case, {}, took {} ms of {} "
        "({} to {}, release {}).</p>",
        "a result of " + html_safe(nearest->chain), ms(nearest->spanned_us),
        ms(nearest->worst_case_us), html_safe(nearest->from), html_safe(nearest->to),
        nearest->release);
  html +=
      "<table><tr><th>from release</th><th>after, s</th><th style='text-align:left'>from</th>"
      "<th style='text-align:left'>to</th><th style='text-align:left'>table</th>"
      "<th style='text-align:left'>why</th><th>met it, ms</th><th>worst case</th></tr>";
  for (std::size_t i = first; i < trace.changes.size(); ++i) {
    const TraceChange& c = trace.changes[i];
    html += fmt::format(
        "<tr><td>{}</td><td>{:.3f}</td><td style='text-align:left'>{}</td>"
        "<td style='text-align:left'>{}</td><td style='text-align:left'>{}</td>"
        "<td style='text-align:left'>{}</td><td>{}{}</td><td>{}</td></tr>",
        c.release, static_cast<double>(std::max<std::int64_t>(0, c.at_ns - trace.begin_ns)) * 1e-9,
        html_safe(c.from), html_safe(c.to), html_safe(c.table), html_safe(c.why),
        time(c.spanned_us), c.chain.empty() ? "" : " of " + html_safe(c.chain),
        time(c.worst_case_us));
  }
  return html + "</table>";
}

/// Time in which at least one of the slices holds, of the whole.
double share(std::vector<std::pair<std::int64_t, std::int64_t>> spans, std::int64_t whole) {
  std::sort(spans.begin(), spans.end());
  std::int64_t busy = 0, until = 0;
  for (const auto& [begin, end] : spans) {
    busy += std::max<std::int64_t>(0, end - std::max(begin, until));
    until = std::max(until, end);
  }
  return whole <= 0 ? 0 : 100.0 * static_cast<double>(busy) / static_cast<double>(whole);
}

std::string load_section(const ReadTrace& trace) {
  std::string html =
      "<h2>XPU load</h2><table><tr><th>XPU</th><th>busy</th><th>of it switching</th>"
      "<th>jobs</th><th>preemptions</th><th></th></tr>";
  const std::int64_t whole = trace.end_ns - trace.begin_ns;
  for (std::size_t r = 0; r < trace.rows.size(); ++r) {
    std::vector<std::pair<std::int64_t, std::int64_t>> all, switching;
    int jobs = 0, preemptions = 0;
    for (const TraceSlice& slice : trace.run) {
      if (slice.row != static_cast<int>(r)) continue;
      all.emplace_back(slice.begin_ns, slice.end_ns);
      if (slice.category == "switch") switching.emplace_back(slice.begin_ns, slice.end_ns);
      if (slice.category == "run") (slice.part == 1 ? jobs : preemptions) += 1;
    }
    const double busy = share(all, whole);
    html += fmt::format(
        "<tr><td>{}</td><td>{:.1f} %</td><td>{:.1f} %</td><td>{}</td><td>{}</td>"
        "<td class='bar'><div style='width:{:.1f}%'></div></td></tr>",
        html_safe(trace.rows[r]), busy, share(switching, whole), jobs, preemptions, busy);
  }
  return html + "</table>";
}

std::string policy_of(const ReadTrace& trace) {
  const auto colon = trace.title.rfind(": ");
  return colon == std::string::npos ? trace.title : trace.title.substr(colon + 2);
}

std::string id_of(const ReportedTrace& reported, std::size_t number) {
  const bool plain = !reported.id.empty() &&
                     std::all_of(reported.id.begin(), reported.id.end(), [](unsigned char c) {
                       return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-';
                     });
  return plain ? reported.id : "trace" + std::to_string(number);
}

}  // namespace

std::vector<Panel> output_panels(const std::string& id, const std::string& name,
                                 const ReadTrace& trace) {
  std::vector<Panel> panels;
  for (const TraceOutputs& outputs : trace.outputs) {
    const TraceResult& worst = *std::max_element(
        outputs.results.begin(), outputs.results.end(),
        [](const TraceResult& a, const TraceResult& b) { return a.latency_us < b.latency_us; });
    Panel panel;
    panel.id = id + "-" + std::to_string(panels.size());
    panel.name = name + ": " + outputs.module;
    panel.rows = trace.rows;
    panel.latencies_us = latencies_of(outputs.results);
    Latencies sorted = panel.latencies_us;
    std::sort(sorted.begin(), sorted.end());
    panel.p50_us = quantile_of_sorted(sorted, 0.5);
    if (sorted.size() >= kLeastOfP99) panel.p99_us = quantile_of_sorted(sorted, 0.99);
    panel.max_us = sorted.back();
    panel.shown_sequence = worst.number;
    panel.shown_latency_us = worst.latency_us;
    // Others' releases, too: they are what is waited for.
    for (const TraceSlice& s : trace.run) {
      if (s.category == "done" || s.end_ns <= worst.begin_ns || s.begin_ns >= worst.end_ns)
        continue;
      const bool switching = s.category == "switch";
      const auto us = [&](std::int64_t ns) {
        return (std::clamp(ns, worst.begin_ns, worst.end_ns) - worst.begin_ns) / 1000;
      };
      panel.measured.push_back({s.row, switching ? s.name.substr(s.name.find(' ') + 1) : s.name,
                                s.module, us(s.begin_ns), us(s.end_ns),
                                switching ? BarKind::kSwitch : BarKind::kRun});
    }
    panels.push_back(std::move(panel));
  }
  return panels;
}

std::string counts_section(const std::string& title, const ReadTrace& trace) {
  const std::vector<ChainCounts> list = counts_of(trace);
  if (list.empty()) return {};
  const auto time = [](std::int64_t us) { return us < 0 ? std::string("-") : ms(us); };
  const auto any = [&](std::int64_t ChainCounts::*of) {
    return std::any_of(list.begin(), list.end(), [&](const ChainCounts& c) { return c.*of >= 0; });
  };
  const bool claims = any(&ChainCounts::worst_case_us), deadlines = any(&ChainCounts::deadline_us);
  const std::string of = !trace.counts.empty() ? " (whole run)" : window_of(trace);
  std::string html = fmt::format(
      "<h2>{}</h2><table class='counts'><tr><th>chain, "
      "ms{}</th><th>n</th><th>p50</th><th>p99</th><th>max</th>{}{}"
      "</tr>",
      html_safe(title), of, claims ? "<th>worst case</th><th>bound</th><th></th>" : "",
      deadlines ? "<th>deadline</th><th>missed</th>" : "");
  for (const ChainCounts& c : list) {
    html +=
        fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>",
                    html_safe(c.name), c.results, time(c.p50_us), time(c.p99_us), time(c.max_us));
    if (claims)
      html += fmt::format("<td>{}</td><td>{}</td><td>{}</td>", time(c.worst_case_us),
                          time(c.lower_bound_us),
                          c.exceeded                   ? "<b>exceeded</b>"
                          : c.worst_case_us < 0        ? ""
                          : c.max_us > c.worst_case_us ? "within the emulator's part"
                                                       : "within");
    if (deadlines)
      html += fmt::format("<td>{}</td><td>{}</td>", time(c.deadline_us),
                          c.misses < 0 ? "" : std::to_string(c.misses));
    html += "</tr>";
  }
  return "<div class='card'>" + html + "</table>" +
         (trace.verdict.empty() ? "" : verdict_html(trace.verdict)) + "</div>";
}

std::string html_report(const std::vector<ReportedTrace>& traces) {
  Timeline page;
  page.note = "written by xauto report; each chart shows the slowest release";
  for (std::size_t i = 0; i < traces.size(); ++i) {
    const ReadTrace& trace = traces[i].trace;
    if (page.title.empty()) page.title = trace.title.substr(0, trace.title.rfind(": "));
    page.sections +=
        "<div class='card'><h2>" + html_safe(trace.title) + "</h2><p class='dim'>" +
        html_safe(trace.note) +
        fmt::format(", {} releases, {} activations dropped", trace.releases.size(), trace.dropped) +
        "</p>";
    if (trace.lost > 0)
      page.sections += fmt::format(
          "<p><b>Incomplete: the trace lost {} events.</b> Numbers below are of what is there.</p>",
          trace.lost);
    if (trace.overwritten > 0)
      page.sections +=
          fmt::format("<p>The trace holds {:.1f} s: {} older events were dropped.</p>",
                      static_cast<double>(trace.end_ns - trace.begin_ns) * 1e-9, trace.overwritten);
    page.sections += counts_section("Chains", trace) + outputs_section(trace);
    for (const TraceReactions& chain : trace.reactions)
      page.sections += story_section(trace, chain);
    page.sections += tables_section(trace) + load_section(trace) + "</div>";
    std::vector<Panel> panels = output_panels(id_of(traces[i], i), policy_of(trace), trace);
    if (panels.empty()) panels.push_back({id_of(traces[i], i), policy_of(trace)});
    for (Panel& panel : panels) page.panels.push_back(std::move(panel));
  }
  return timeline_html(page);
}

}  // namespace xauto::story
