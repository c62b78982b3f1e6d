// SPDX-License-Identifier: Apache-2.0
// The page is data plus a fixed script: names from outside reach it only as JSON string values, and
// the script only ever sets them as text. The script and style are in timeline_page.h.
#include "xauto/timeline.h"

#include <nlohmann/json.hpp>

#include "xauto/timeline_page.h"

namespace xauto::cli {
namespace {

using nlohmann::ordered_json;

ordered_json bars_to_json(const std::vector<Bar>& bars) {
  ordered_json out = ordered_json::array();
  for (const Bar& bar : bars)
    out.push_back(
        {bar.row, bar.xnode, bar.module, bar.begin_us, bar.end_us, static_cast<int>(bar.kind)});
  return out;
}

ordered_json or_null(const std::optional<std::int64_t>& us) {
  return us ? ordered_json(*us) : ordered_json();
}

/// JSON that may stand inside <script>: no "</script>", no "<!--".
std::string script_safe(const ordered_json& value) {
  const std::string text = value.dump(-1, ' ', true, ordered_json::error_handler_t::replace);
  std::string out;
  out.reserve(text.size());
  for (const char c : text) {
    if (c == '<')
      out += "\\u003c";
    else
      out += c;
  }
  return out;
}

}  // namespace

std::string html_safe(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '&':
        out += "&amp;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string timeline_html(const Timeline& timeline) {
  ordered_json panels = ordered_json::array();
  for (const Panel& p : timeline.panels)
    panels.push_back({{"id", p.id},
                      {"name", p.name},
                      {"rows", p.rows},
                      {"p50", or_null(p.p50_us)},
                      {"p99", or_null(p.p99_us)},
                      {"max", or_null(p.max_us)},
                      {"predicted", or_null(p.predicted_us)},
                      {"shown", p.shown_sequence},
                      {"shownLatency", p.shown_latency_us},
                      {"shownIs", p.shown},
                      {"latencies", p.latencies_us},
                      {"measured", bars_to_json(p.measured)},
                      {"plan", bars_to_json(p.predicted)}});
  const ordered_json data = {
      {"title", timeline.title}, {"note", timeline.note}, {"panels", std::move(panels)}};
  return std::string(kPageHead) + "<title>" + html_safe(timeline.title) + "</title>" + kPageStyle +
         kPageBody + timeline.sections + kPagePanels + "<script>const DATA = " + script_safe(data) +
         ";</script>" + kPageScript;
}

}  // namespace xauto::cli
