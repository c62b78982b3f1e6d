// SPDX-License-Identifier: Apache-2.0
// xauto import: app.json out of what a program that knows nothing of XAuto has left: traces, timings.
#include <filesystem>
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "base/columns.h"
#include "model/imported.h"
#include "model/json.h"
#include "model/json_value.h"

#include "import/ros2_app.h"
#include "xauto/command.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

namespace fs = std::filesystem;

struct ImportFlags {
  std::string trace, architecture, name, out;
  std::int64_t margin_pct = 0;
  bool ask = false;
};

Result<ImportedApp> import_trace(const ImportFlags& flags, std::vector<std::string>& lines) {
  import::Architecture architecture;
  if (!flags.architecture.empty()) {
    XAUTO_ASSIGN(const std::string text, read_file(flags.architecture));
    XAUTO_ASSIGN(architecture, import::parse_architecture(text, flags.architecture));
  }
  XAUTO_ASSIGN(const import::RosTrace trace, import::read_ros2_trace(flags.trace));
  const std::string name = fs::path(flags.trace).lexically_normal().filename().string();
  import::Ros2Options options{flags.name, "trace " + name, flags.margin_pct};
  if (options.name.empty()) options.name = name.empty() ? "imported" : name;
  return import::ros2_app(trace, architecture, options, lines);
}

void print(const ImportedApp& made, const std::vector<std::string>& lines) {
  for (const std::string& line : lines) std::cout << wrapped("  " + line, 4) << "\n";
  if (made.todo.empty()) return;
  std::cout << "\nTODO: what the file does not know\n";
  for (const Todo& todo : made.todo)
    std::cout << wrapped("  - " + todo.what + (todo.at.empty() ? "" : " (" + todo.at + ")"), 4)
              << "\n";
}

Result<int> import_files(const ImportFlags& flags, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  std::vector<std::string> lines;
  XAUTO_ASSIGN(const ImportedApp made, import_trace(flags, lines));
  const std::string text = to_json(made);
  XAUTO_ASSIGN(const ImportedApp again, parse_imported(text, flags.out));
  (void)options;
  print(again, lines);
  outputs.write(flags.out, text);
  return outputs.status(kDone);
}

}  // namespace

void add_import(Commands& commands) {
  auto flags = std::make_shared<ImportFlags>();
  Verb verb =
      commands.add("import", "Make app.json of a trace of a program that knows nothing of XAuto.",
                   "xauto import trace --architecture architecture.yaml --out app.json",
                   [flags](const Options& options) { return import_files(*flags, options); });
  verb.option("trace", flags->trace, "folder of an LTTng trace with ros2_tracing's events")
      .required();
  verb.option("--architecture", flags->architecture,
              "CARET's architecture.yaml, which names chains");
  verb.option("--name", flags->name, "of the app").shown_as("the trace's");
  verb.option("--margin-pct", flags->margin_pct, "WCET = max + this much").range(0, 1000).shown();
  verb.option("--out", flags->out, "where app.json goes").required();
}

}  // namespace xauto::cli
