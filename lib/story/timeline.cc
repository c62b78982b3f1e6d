// SPDX-License-Identifier: Apache-2.0
// The page is data plus a fixed script: names from outside reach it only as JSON string values, and
// the script only ever sets them as text. Plain SVG and DOM, no network, light and dark. Colours:
// Okabe and Ito's palette for colour-blind readers, by module. cmake/embed.cmake makes
// timeline_files.h of timeline.css and timeline.js.
#include "story/timeline.h"

#include "model/json_value.h"
#include "story/timeline_files.h"

namespace xauto::story {
namespace {

constexpr const char* kHead =
    R"(<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">)";

constexpr const char* kBody = R"html(</head><body>
<div class="tools"><span title="in the schedules below: Ctrl and the wheel; keys + - 0 and the arrows">zoom</span> <button id="in" title="key +">+</button> <button id="out" title="key -">&minus;</button> <button id="all" title="key 0">all</button></div>
<h1 id="title"></h1><div id="note" class="dim"></div>
<div class="card"><table id="table"></table></div>
)html";

/// After the sections, if there are any.
constexpr const char* kPanels = R"html(<div class="legend" id="legend"></div>
<div id="panels"></div><div id="tip" role="tooltip"></div>
)html";

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
                      {"shown", p.shown_sequence},
                      {"shownLatency", p.shown_latency_us},
                      {"latencies", p.latencies_us},
                      {"measured", bars_to_json(p.measured)}});
  const Json data = {
      {"title", timeline.title}, {"note", timeline.note}, {"panels", std::move(panels)}};
  return std::string(kHead) + "<title>" + html_safe(timeline.title) + "</title><style>\n" +
         kTimelineCss + "</style>" + kBody + timeline.sections + kPanels +
         "<script>const DATA = " + script_safe(data) + ";</script><script>\n" + kTimelineJs +
         "</script></body></html>\n";
}

}  // namespace xauto::story
