// SPDX-License-Identifier: Apache-2.0
// The page is data plus a fixed script: names from outside reach it only as JSON string values, and
// the script only ever sets them as text. The script and style are in timeline_page.h.
#include "xauto/timeline.h"

#include "model/json_value.h"

#include "xauto/timeline_page.h"

namespace xauto::cli {
namespace {

Json bars_to_json(const std::vector<Bar>& bars) {
  Json out = Json::array();
  for (const Bar& bar : bars)
    out.push_back(Json::array(
        {bar.row, bar.xnode, bar.module, bar.begin_us, bar.end_us, static_cast<int>(bar.kind)}));
  return out;
}

/// JSON that may stand inside <script>: no "</script>", no "<!--".
std::string script_safe(const Json& value) {
  const std::string text = value.dump_ascii();
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
  Json panels = Json::array();
  for (const Panel& p : timeline.panels)
    panels.push_back({{"id", p.id},
                      {"name", p.name},
                      {"rows", p.rows},
                      {"p50", p.p50_us},
                      {"p99", p.p99_us},
                      {"max", p.max_us},
                      {"predicted", p.predicted_us},
                      {"shown", p.shown_sequence},
                      {"shownLatency", p.shown_latency_us},
                      {"shownIs", p.shown},
                      {"latencies", p.latencies_us},
                      {"measured", bars_to_json(p.measured)},
                      {"plan", bars_to_json(p.predicted)}});
  const Json data = {
      {"title", timeline.title}, {"note", timeline.note}, {"panels", std::move(panels)}};
  return std::string(kPageHead) + "<title>" + html_safe(timeline.title) + "</title>" + kPageStyle +
         kPageBody + timeline.sections + kPagePanels + "<script>const DATA = " + script_safe(data) +
         ";</script>" + kPageScript;
}

}  // namespace xauto::cli
