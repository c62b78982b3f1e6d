// SPDX-License-Identifier: Apache-2.0
// xauto import: app.json out of what a program that knows nothing of XAuto has left: traces, timings; and a program to
// fill in.
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>

#include "base/columns.h"
#include "model/imported.h"
#include "model/json.h"
#include "model/json_value.h"

#include "import/amalthea.h"
#include "import/answers.h"
#include "import/nsight.h"
#include "import/ros2_app.h"
#include "import/skeleton.h"
#include "import/trtexec.h"
#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

namespace fs = std::filesystem;

struct ImportFlags {
  std::string input, architecture, app, name, out, cpp, platform_out;
  std::vector<std::string> trtexec, layers;
  std::int64_t margin_pct = 0, stages = 2;
  bool ask = false;
};

/// Of the app, where nobody says one.
std::string name_of(const ImportFlags& flags) {
  if (!flags.name.empty()) return flags.name;
  const fs::path file = fs::path(flags.input).lexically_normal();
  const std::string name = (fs::is_directory(file) ? file.filename() : file.stem()).string();
  return name.empty() ? "imported" : name;
}

std::string file_name_of(const ImportFlags& flags) {
  return fs::path(flags.input).lexically_normal().filename().string();
}

Result<ImportedApp> import_trace(const ImportFlags& flags, std::vector<std::string>& lines) {
  import::Architecture architecture;
  if (!flags.architecture.empty()) {
    XAUTO_ASSIGN(const std::string text, read_file(flags.architecture));
    XAUTO_ASSIGN(architecture, import::parse_architecture(text, flags.architecture));
  }
  XAUTO_ASSIGN(const import::RosTrace trace, import::read_ros2_trace(flags.input));
  return import::ros2_app(trace, architecture,
                          {name_of(flags), "trace " + file_name_of(flags), flags.margin_pct},
                          lines);
}

/// By what it is: a folder, SQLite, XML.
Result<ImportedApp> import_input(const ImportFlags& flags, std::vector<std::string>& lines,
                                 Platform& platform) {
  std::error_code error;
  if (import::is_amalthea(flags.input)) {
    XAUTO_ASSIGN(const import::AmaltheaModel model, import::read_amalthea(flags.input));
    platform = import::amalthea_platform(model, name_of(flags));
    return import::amalthea_app(model, {name_of(flags), flags.margin_pct}, lines);
  }
  if (fs::is_directory(flags.input, error) || !fs::exists(flags.input, error))
    return import_trace(flags, lines);
  if (!flags.architecture.empty())
    return fail(ErrorCode::kInvalid, "goes with a folder of a ROS 2 trace", "--architecture",
                "leave it out");
  char first[16] = {};
  std::ifstream(flags.input, std::ios::binary).read(first, sizeof first);
  if (std::memcmp(first, "SQLite format 3", sizeof first) == 0) {
    XAUTO_ASSIGN(const import::NsightTrace trace, import::read_nsight(flags.input));
    return import::nsight_app(
        trace, {name_of(flags), "Nsight Systems " + file_name_of(flags), flags.margin_pct}, lines);
  }
  return fail(ErrorCode::kInvalid, "is nothing that is known here", flags.input,
              "name a folder of an LTTng trace, an export of `nsys export --type sqlite`, or an "
              ".amxmi file");
}

/// "NET=TYPE:FILE"
Result<std::vector<import::EngineTimes>> read_engines(const std::vector<std::string>& said) {
  std::vector<import::EngineTimes> engines;
  for (const std::string& text : said) {
    XAUTO_ASSIGN(const auto parts, parse_assignment(text, "--trtexec"));
    const std::size_t colon = parts.second.find(':');
    if (colon == std::string::npos || colon == 0)
      return fail(ErrorCode::kInvalid, "is not NET=TYPE:FILE", "--trtexec " + text,
                  "as in --trtexec detector=gpu:detector.timing.json");
    const std::string file = parts.second.substr(colon + 1);
    XAUTO_ASSIGN(const std::string json, read_file(file));
    XAUTO_ASSIGN(auto times, import::parse_trtexec_times(json, file));
    engines.push_back({parts.first, parts.second.substr(0, colon), std::move(times)});
  }
  return engines;
}

Status add_nets(const ImportFlags& flags, bool alone, ImportedApp& made,
                std::vector<std::string>& lines) {
  XAUTO_ASSIGN(const auto engines, read_engines(flags.trtexec));
  if (alone) made = import::app_of_engines(engines, flags.name.empty() ? "nets" : flags.name);
  XAUTO_TRY(import::add_engines(engines, flags.margin_pct, made, lines));
  for (const std::string& text : flags.layers) {
    XAUTO_ASSIGN(const auto parts, parse_assignment(text, "--layers"));
    XAUTO_ASSIGN(const std::string json, read_file(parts.second));
    XAUTO_ASSIGN(const auto layers, import::parse_trtexec_profile(json, parts.second));
    XAUTO_TRY(import::cut_at_layers(parts.first, layers, static_cast<std::size_t>(flags.stages),
                                    made, lines));
  }
  return {};
}

Result<ImportedApp> import_all(const ImportFlags& flags, std::vector<std::string>& lines,
                               Platform& platform) {
  if (flags.input.empty() && flags.trtexec.empty() && flags.app.empty())
    return fail(ErrorCode::kInvalid, "there is nothing to import", "xauto import",
                "name a trace or a model, --trtexec or --app");
  if (!flags.input.empty() && !flags.app.empty())
    return fail(ErrorCode::kInvalid, "does not go with a trace or a model", "--app",
                "import that first, and then into its app.json");
  ImportedApp made;
  if (!flags.input.empty()) {
    XAUTO_ASSIGN(made, import_input(flags, lines, platform));
  } else if (!flags.app.empty()) {
    XAUTO_ASSIGN(made, load_imported(flags.app));
    if (!flags.name.empty()) made.app.name = flags.name;
  }
  if (!flags.trtexec.empty())
    XAUTO_TRY(add_nets(flags, flags.input.empty() && flags.app.empty(), made, lines));
  return parse_imported(to_json(made), "what was imported");
}

/// One question after the other, on stdin; without an answer it stays.
ImportedApp ask(ImportedApp made) {
  for (std::size_t t = 0; t < made.todo.size();) {
    if (made.todo[t].at.empty()) {
      ++t;
      continue;
    }
    std::cout << wrapped("? " + made.todo[t].what, 2) << "\n> " << std::flush;
    std::string answer;
    if (!std::getline(std::cin, answer)) break;
    if (answer.empty()) {
      ++t;
      continue;
    }
    auto changed = import::with_answer(made, t, answer);
    if (changed)
      made = std::move(*changed);
    else
      std::cout << changed.error().to_string() << "\n";
  }
  std::cout << "\n";
  return made;
}

void print(const ImportedApp& made, const std::vector<std::string>& lines) {
  for (std::string line : lines) {
    for (char& c : line)  // names of a trace may be anything
      if (c >= 0 && c < 0x20) c = '?';
    std::cout << wrapped("  " + line, 4) << "\n";
  }
  if (made.todo.empty()) return;
  std::cout << "\nTODO: what the file does not know\n";
  for (const Todo& todo : made.todo)
    std::cout << wrapped("  - " + todo.what + (todo.at.empty() ? "" : " (" + todo.at + ")"), 4)
              << "\n";
}

Json to_json(const ImportedApp& made, const std::vector<std::string>& lines) {
  Json todo = Json::array();
  for (const Todo& t : made.todo) todo.push_back({{"at", t.at}, {"what", t.what}});
  return {{"schema", "xauto.import"},
          {"version", 1},
          {"app", made.app.name},
          {"lines", Json(lines)},
          {"todo", std::move(todo)}};
}

Status make_folder(const std::string& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return fail(ErrorCode::kIo, error.message(), folder, "name another folder");
  if (fs::exists(fs::path(folder) / "main.cc"))
    return fail(ErrorCode::kInvalid, "has a main.cc already, which is yours", folder,
                "name a new folder");
  return {};
}

Result<int> import_files(const ImportFlags& flags, const Options& options) {
  Outputs outputs;
  if (flags.out.empty() && flags.cpp.empty())
    return fail(ErrorCode::kInvalid, "there is nothing to write", "xauto import",
                "name --out app.json or --cpp DIR");
  if (flags.ask && options.json)
    return fail(ErrorCode::kInvalid, "does not go with --json", "--ask", "leave one of them out");
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_TRY(outputs.expect("--platform-out", flags.platform_out));
  std::vector<std::string> lines;
  Platform platform;
  XAUTO_ASSIGN(ImportedApp made, import_all(flags, lines, platform));
  if (!flags.platform_out.empty() && platform.xpus.empty())
    return fail(ErrorCode::kInvalid, "only a model has processing units", "--platform-out",
                "name a platform.json, or a built-in one, where it is asked for");
  if (flags.ask) made = ask(std::move(made));
  std::vector<import::SkeletonFile> files;
  if (!flags.cpp.empty()) {
    const std::string version = XAUTO_VERSION;
    XAUTO_ASSIGN(files, import::skeleton(made, version.substr(0, version.rfind('.'))));
    XAUTO_TRY(make_folder(flags.cpp));
  }
  if (options.json)
    std::cout << to_json(made, lines).dump(2) << "\n";
  else
    print(made, lines);
  if (!flags.out.empty()) outputs.write(flags.out, to_json(made));
  if (!flags.platform_out.empty()) outputs.write(flags.platform_out, to_json(platform));
  for (const import::SkeletonFile& file : files)
    outputs.write((fs::path(flags.cpp) / file.name).string(), file.text);
  return outputs.status(kDone);
}

}  // namespace

void add_import(Commands& commands) {
  auto flags = std::make_shared<ImportFlags>();
  Verb verb = commands.add(
      "import", "Make app.json of what a program that knows nothing of XAuto has left.",
      "xauto import trace --architecture architecture.yaml --out app.json",
      [flags](const Options& options) { return import_files(*flags, options); });
  verb.option(
      "input", flags->input,
      "folder of an LTTng trace with ros2_tracing's events, what `nsys export --type sqlite` "
      "has written, or a model of Amalthea (.amxmi, or a folder of such files)");
  verb.option("--architecture", flags->architecture,
              "CARET's architecture.yaml of it, which names chains");
  verb.option("--app", flags->app, "an app.json instead: to add to it, ask, or make a program");
  verb.option("--trtexec", flags->trtexec,
              "NET=TYPE:FILE of --exportTimes: an XNode, and what it takes on this type of XPU");
  verb.option("--layers", flags->layers,
              "NET=FILE of --exportProfile: the net is cut into stages, between layers");
  verb.option("--stages", flags->stages, "so many at most")
      .range<std::int64_t>(2, import::kMaxStages)
      .shown();
  verb.option("--name", flags->name, "of the app").shown_as("the input's");
  verb.option("--margin-pct", flags->margin_pct, "WCET = max + this much").range(0, 1000).shown();
  verb.flag("--ask", flags->ask, "ask on the terminal what the file does not know");
  verb.option("--out", flags->out, "where app.json goes");
  verb.option("--platform-out", flags->platform_out,
              "where a platform.json of a model's processing units goes");
  verb.option("--cpp", flags->cpp, "folder for a program to fill in, which runs with stand-ins");
}

}  // namespace xauto::cli
