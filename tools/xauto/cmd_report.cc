// SPDX-License-Identifier: Apache-2.0
// xauto report: traces of finished runs as one page. docs/timeline.md.
#include <filesystem>
#include <iostream>

#include "model/json.h"
#include "model/json_value.h"
#include "story/page.h"
#include "story/trace_reader.h"

#include "xauto/command.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

struct ReportFlags {
  std::vector<std::string> traces;
  std::string out = "report.html";
};

Result<int> make(const ReportFlags& flags, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  std::vector<story::PagedRun> runs;
  auto list = Json::array();
  for (const std::string& path : flags.traces) {
    XAUTO_ASSIGN(const std::string bytes, read_file(path));
    XAUTO_ASSIGN(story::ReadTrace trace, story::read_trace(bytes, path));
    list.push_back({{"trace", std::filesystem::path(path).stem().string()},
                    {"releases", trace.releases.size()},
                    {"lost", trace.lost}});
    runs.push_back({link_from(flags.out, path), std::move(trace)});
  }
  // The page is the result; stdout only says where it is.
  XAUTO_TRY(write_file(flags.out, story::page_html(runs)));
  if (options.json)
    std::cout << Json{{"out", flags.out}, {"traces", std::move(list)}}.dump(2) << "\n";
  else
    std::cout << flags.out << "    open it in a browser\n";
  return kDone;
}

}  // namespace

void add_report(Commands& commands) {
  auto flags = std::make_shared<ReportFlags>();
  Verb verb = commands.add(
      "report",
      "Make a page of traces: claims, each chain's releases, where their time went, XPU load.",
      "xauto report build/demo/heft.pftrace build/demo/xauto.pftrace --out report.html",
      [flags](const Options& options) { return make(*flags, options); });
  verb.option("traces", flags->traces, "files of `xauto run --trace-out` or `xauto compare`")
      .required();
  verb.option("--out", flags->out, "the page").shown();
}

}  // namespace xauto::cli
