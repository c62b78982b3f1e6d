// SPDX-License-Identifier: Apache-2.0
// xauto report: traces of finished runs as one page. docs/timeline.md.
#include <filesystem>
#include <iostream>

#include <fmt/format.h>

#include "model/claims.h"
#include "model/json.h"
#include "model/json_value.h"
#include "story/html_report.h"

#include "xauto/command.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

struct ReportFlags {
  std::vector<std::string> traces;
  std::string report, out = "report.html";
};

/// What report.json says of the run that the trace is of: the one of its name, or the only one.
std::string fact_of(const Json& report, const std::string& id) {
  const std::vector<Json>& runs = report.at("runs").elements();
  for (const Json& run : runs) {
    if (!run.is_object() || (runs.size() > 1 && run.at("policy").text() != id)) continue;
    std::string out;
    const auto add = [&](const char* key, const char* what) {
      if (const auto us = run.at(key).number())
        out += fmt::format("{}{} {:.2f} ms", out.empty() ? "" : ", ", what, *us / 1000);
    };
    add("lower_bound_us", "lower bound");
    add("worst_case_us", "worst case");
    if (!run.has("worst_case_us")) return out;
    out += std::string(" of ") + kWorstCaseScope;
    if (!run.at("worst_case_broken").elements().empty()) out += ", which this run is not";
    return out;
  }
  return {};
}

Result<int> make(const ReportFlags& flags, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  Json report;
  if (!flags.report.empty()) {
    XAUTO_ASSIGN(const std::string text, read_file(flags.report));
    report = Json::parse(text).value_or(Json());
    if (report.at("schema").text() != "xauto.report")
      return fail(ErrorCode::kInvalid, "is no report.json", flags.report,
                  "`xauto run --out` and `xauto compare` write it");
  }
  std::vector<story::ReportedTrace> traces;
  for (const std::string& path : flags.traces) {
    XAUTO_ASSIGN(const std::string bytes, read_file(path));
    XAUTO_ASSIGN(story::ReadTrace trace, story::read_trace(bytes, path));
    const std::string id = std::filesystem::path(path).stem().string();
    std::string fact = report.is_object() ? fact_of(report, id) : std::string();
    traces.push_back({id, std::move(fact), std::move(trace)});
  }
  // The page is the result; stdout only says where it is.
  XAUTO_TRY(write_file(flags.out, html_report(traces)));
  if (options.json) {
    auto list = Json::array();
    for (const story::ReportedTrace& t : traces)
      list.push_back(
          {{"trace", t.id}, {"releases", t.trace.releases.size()}, {"lost", t.trace.lost}});
    std::cout << Json{{"out", flags.out}, {"traces", std::move(list)}}.dump(2) << "\n";
  } else {
    std::cout << flags.out << "    open it in a browser\n";
  }
  return kDone;
}

}  // namespace

void add_report(Commands& commands) {
  auto flags = std::make_shared<ReportFlags>();
  Verb verb = commands.add(
      "report", "Make a page of traces: latencies, the worst release and why, XPU load.",
      "xauto report build/demo/heft.pftrace build/demo/xauto.pftrace --out report.html",
      [flags](const Options& options) { return make(*flags, options); });
  verb.option("traces", flags->traces, "files of `xauto run --trace-out` or `xauto compare`")
      .required();
  verb.option("--report", flags->report, "report.json of the same runs, for what was predicted");
  verb.option("--out", flags->out, "the page").shown();
}

}  // namespace xauto::cli
