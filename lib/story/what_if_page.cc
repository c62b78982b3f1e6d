// SPDX-License-Identifier: Apache-2.0
#include "story/what_if_page.h"

#include <algorithm>

#include <fmt/format.h>

#include "base/utf8.h"
#include "story/html.h"
#include "story/page_files.h"

namespace xauto::story {
namespace {

constexpr double kRightMargin = 1.05;  ///< of the longest time, to the end of a strip

std::string part_of(std::int64_t us, double whole_us) {
  return fmt::format("{:.2f}%", 100 * static_cast<double>(us) / whole_us);
}

std::string rule(std::int64_t us, double whole_us, const char* css, const char* what) {
  return fmt::format(
      "<line class='{0}' x1='{1}' x2='{1}' y1='0' y2='22'><title>{2}: {3} ms</title></line>", css,
      part_of(us, whole_us), what, page_ms(us));
}

/// From the median to the longest, beside claim and deadline.
std::string strip(const WhatIfRow& row, const WhatIfChain& chain, double whole_us) {
  std::string svg =
      fmt::format("<svg class='strip' height='22' role='img' aria-label='p50 {} ms, max {} ms'>",
                  page_ms(row.median_us), page_ms(row.longest_us));
  svg += fmt::format(
      "<rect x='{}' y='8' width='{}' height='6' fill='var(--run)' fill-opacity='.45'/>",
      part_of(row.median_us, whole_us), part_of(row.longest_us - row.median_us, whole_us));
  svg += fmt::format("<circle cx='{}' cy='11' r='5' style='fill-opacity:1'/>",
                     part_of(row.median_us, whole_us));
  if (row.claim_us) svg += rule(*row.claim_us, whole_us, "claim", "claimed");
  if (chain.deadline_us) svg += rule(*chain.deadline_us, whole_us, "deadline", "deadline");
  return svg + "</svg>";
}

std::string chain_section(const WhatIfChain& chain) {
  std::int64_t longest = chain.deadline_us.value_or(1);
  for (const WhatIfRow& row : chain.rows)
    longest = std::max({longest, row.longest_us, row.claim_us.value_or(0)});
  const double whole_us = static_cast<double>(longest) * kRightMargin;
  std::string html = "<section class='card'><h2>" + html_safe(chain.name) + "</h2>";
  if (chain.deadline_us)
    html += "<p class='dim'>deadline " + page_ms(*chain.deadline_us) + " ms</p>";
  for (const WhatIfRow& row : chain.rows) {
    html += fmt::format("<p class='run'><b>{}</b> ", html_safe(row.name));
    if (row.count > 0)
      html += fmt::format("p50 {}{}, max {} ms of {} releases", page_ms(row.median_us),
                          row.p99_us < 0 ? "" : ", p99 " + page_ms(row.p99_us),
                          page_ms(row.longest_us), row.count);
    if (row.claim_us) html += fmt::format(", claimed {} ms", page_ms(*row.claim_us));
    html += "</p>" + strip(row, chain, whole_us);
  }
  return html + "</section>\n";
}

std::string load_section(const std::vector<WhatIfLoad>& loads) {
  std::string html = "<section class='card'><h2>How busy</h2><table>";
  for (const WhatIfLoad& load : loads) {
    html += "<tr><td>" + html_safe(load.name) + "</td><td class='text'>";
    for (std::size_t p = 0; p < load.parts.size(); ++p)
      html += fmt::format("{}{} {:.1f} %", p == 0 ? "" : ", ", html_safe(load.parts[p].first),
                          100 * load.parts[p].second);
    html += "</td></tr>";
  }
  return html + "</table></section>\n";
}

}  // namespace

std::string what_if_html(const WhatIfPage& page) {
  std::string html =
      R"(<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>)" +
      html_safe(page.title) + "</title><style>\n" + kPageCss + "</style></head><body>\n<h1>" +
      html_safe(page.title) + "</h1><section class='card'>";
  for (const std::string& sentence : page.verdict) html += "<p>" + html_safe(sentence) + "</p>";
  html +=
      "</section>\n<div class='legend'><span>dot: p50; bar: to the longest</span>"
      "<span><i class='rule'></i>claimed</span><span><i class='rule "
      "deadline'></i>deadline</span></div>";
  for (const WhatIfChain& chain : page.chains) html += chain_section(chain);
  if (!page.loads.empty()) html += load_section(page.loads);
  html += "<section class='card'><h2>What this takes for granted</h2><p>" +
          html_safe(page.assumes) + "</p>";
  if (!page.todo.empty()) {
    html += "<h3>What app.json does not know</h3><ul>";
    for (const std::string& todo : page.todo) html += "<li>" + html_safe(todo) + "</li>";
    html += "</ul>";
  }
  return valid_utf8(html + "</section></body></html>\n");
}

}  // namespace xauto::story
