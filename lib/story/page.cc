// SPDX-License-Identifier: Apache-2.0
// Plain HTML: every text from outside goes through html_safe(). cmake/embed.cmake makes page_files.h of page.css.
#include "story/page.h"

#include <algorithm>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/utf8.h"
#include "story/chain_panel.h"
#include "story/html.h"
#include "story/page_files.h"

namespace xauto::story {
namespace {

constexpr const char* kHead =
    R"(<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">)";
constexpr std::size_t kShownChanges = 100;

/// Line by line; what begins with a dash is an item.
std::string verdict_html(const std::string& verdict) {
  std::string html, line;
  std::istringstream lines(verdict);
  std::string_view open;  // "p", "ul", or neither
  const auto close = [&] {
    if (!open.empty()) html += fmt::format("</{}>", open);
  };
  while (std::getline(lines, line)) {
    line.erase(0, line.find_first_not_of(' '));
    const std::string_view tag = line.starts_with("- ") ? "ul" : "p";
    if (open != tag) {
      close();
      html += fmt::format("<{}>", open = tag);
    } else if (tag == "p") {
      html += "<br>";
    }
    html += tag == "ul" ? "<li>" + html_safe(line.substr(2)) + "</li>" : html_safe(line);
  }
  close();
  return html;
}

double seconds_of(const ReadTrace& trace) {
  return static_cast<double>(trace.end_ns - trace.begin_ns) * 1e-9;
}

/// What became of each run's claims, and what of it is in the trace.
std::string verdicts(const std::vector<PagedRun>& runs) {
  std::string html = "<section class='card'>";
  for (const PagedRun& run : runs) {
    const ReadTrace& trace = run.trace;
    html += "<h2>" + html_safe(policy_of(trace)) + "</h2>";
    if (!trace.verdict.empty()) html += verdict_html(trace.verdict);
    html += fmt::format(
        "<p class='dim'>{}, {} releases in {:.1f} s{}</p>", html_safe(trace.note),
        trace.releases.size(), seconds_of(trace),
        trace.dropped > 0 ? fmt::format(", {} activations dropped", trace.dropped) : "");
    if (trace.lost > 0)
      html += fmt::format(
          "<p><b class='bad'>Incomplete: the trace lost {} events.</b> Dots and waterfalls are of "
          "what is "
          "there.</p>",
          trace.lost);
    if (trace.overwritten > 0)
      html += fmt::format("<p>The trace holds the last {:.1f} s: {} older events were dropped.</p>",
                          seconds_of(trace), trace.overwritten);
  }
  return html + "</section>";
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

struct Load {
  double busy_pct = 0;
  int preemptions = 0;
};

Load load_of(const ReadTrace& trace, std::size_t row) {
  Load load;
  std::vector<std::pair<std::int64_t, std::int64_t>> spans;
  for (const TraceSlice& slice : trace.run) {
    if (slice.row != static_cast<int>(row)) continue;
    spans.emplace_back(slice.begin_ns, slice.end_ns);
    if (slice.category == "run" && slice.part > 1) ++load.preemptions;
  }
  load.busy_pct = share(std::move(spans), trace.end_ns - trace.begin_ns);
  return load;
}

/// A column per run: how busy each XPU was, and how often somebody was suspended there.
std::string load_section(const std::vector<PagedRun>& runs) {
  std::vector<std::string> rows;
  std::string head;
  for (const PagedRun& run : runs) {
    for (const std::string& row : run.trace.rows)
      if (std::find(rows.begin(), rows.end(), row) == rows.end()) rows.push_back(row);
    head += "<th>" + html_safe(policy_of(run.trace)) + "</th>";
  }
  if (rows.empty()) return {};
  std::string html =
      "<section class='card'><h2>How busy each XPU was</h2><table><tr><th>XPU, and "
      "preemptions</th>" +
      head + "</tr>";
  for (const std::string& name : rows) {
    html += "<tr><td>" + html_safe(name) + "</td>";
    for (const PagedRun& run : runs) {
      const auto& own = run.trace.rows;
      const auto at = std::find(own.begin(), own.end(), name);
      if (at == own.end()) {
        html += "<td></td>";
        continue;
      }
      const Load load = load_of(run.trace, static_cast<std::size_t>(at - own.begin()));
      html += fmt::format("<td>{:.1f} %{}</td>", load.busy_pct,
                          load.preemptions > 0 ? fmt::format(", {}", load.preemptions) : "");
    }
    html += "</tr>";
  }
  return html + "</table></section>";
}

std::string changes_table(const ReadTrace& trace) {
  const std::size_t first = trace.changes.size() - std::min(kShownChanges, trace.changes.size());
  std::string html = fmt::format("<h3>Changes of the scenario: {}{}</h3>", trace.changes.size(),
                                 first > 0 ? fmt::format(", the last {}", kShownChanges) : "");
  if (trace.changes.empty()) return html;
  html +=
      "<table><tr><th>from release</th><th>after, s</th><th class='text'>from</th>"
      "<th class='text'>to</th><th class='text'>table</th><th class='text'>why</th>"
      "<th>met it, ms</th><th>worst case</th></tr>";
  for (std::size_t i = first; i < trace.changes.size(); ++i) {
    const TraceChange& c = trace.changes[i];
    html += fmt::format(
        "<tr><td>{}</td><td>{:.3f}</td><td class='text'>{}</td><td class='text'>{}</td>"
        "<td class='text'>{}</td><td class='text'>{}</td><td>{}{}</td><td>{}</td></tr>",
        c.release, static_cast<double>(std::max<std::int64_t>(0, c.at_ns - trace.begin_ns)) * 1e-9,
        html_safe(c.from), html_safe(c.to), html_safe(c.table), html_safe(c.why),
        ms_in_row(c.spanned_us), c.chain.empty() ? "" : " of " + html_safe(c.chain),
        ms_in_row(c.worst_case_us));
  }
  return html + "</table>";
}

/// Of a run with tables: its scenarios, the last changes with their reasons, and what met them.
std::string tables_section(const ReadTrace& trace) {
  if (trace.scenarios.empty() && trace.changes.empty()) return {};
  std::string html =
      "<section class='card'><h2>Scenarios: " + html_safe(policy_of(trace)) + "</h2>";
  if (!trace.scenarios.empty()) {
    html += "<table><tr><th>scenario</th><th class='text'>table</th><th>releases</th></tr>";
    for (const TraceScenario& s : trace.scenarios)
      html += fmt::format("<tr><td>{}</td><td class='text'>{}</td><td>{}</td></tr>",
                          html_safe(s.name), html_safe(s.table), s.releases);
    html += "</table>";
  }
  return html + changes_table(trace) + "</section>";
}

}  // namespace

std::string page_html(const std::vector<PagedRun>& runs) {
  const std::string full = runs.empty() ? "" : runs.front().trace.title;
  const std::string title = full.substr(0, full.rfind(": "));
  std::string html = std::string(kHead) + "<title>" + html_safe(title) + "</title><style>\n" +
                     kPageCss + "</style></head><body>\n<h1>" + html_safe(title) + "</h1>" +
                     verdicts(runs) + legend();
  for (const std::string& chain : chains_of(runs)) html += chain_panel(chain, runs) + "\n";
  for (const PagedRun& run : runs) html += tables_section(run.trace);
  return valid_utf8(html + load_section(runs) + "</body></html>\n");
}

}  // namespace xauto::story
