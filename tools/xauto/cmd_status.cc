// SPDX-License-Identifier: Apache-2.0
// xauto status: every state machine of every running app in words. Coordinators are found by the
// names of their sockets and asked; nothing is written anywhere for this.
#include <iostream>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/socket.h"
#include "runtime/supervisor.h"

#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

using nlohmann::json;

std::string words(const json& worker) {
  const std::string state = worker.value("state", "?");
  if (state == "idle") return "idle";
  std::string text = fmt::format("{}: {} (job {}, priority {}, since {:.2f} ms)", state,
                                 worker.value("xnode", "?"), worker.value("job", 0ull),
                                 worker.value("priority", 0ll),
                                 static_cast<double>(worker.value("since_us", 0ll)) / 1000);
  if (worker.contains("by")) text += " by " + worker["by"].get<std::string>();
  return text;
}

int status(const Options& options) {
  json sessions = json::object();
  std::set<std::string> runs;
  const std::string prefix = runtime::kSocketPrefix;
  for (const std::string& address : abstract_sockets(prefix))
    if (const std::size_t slash = address.rfind('/'); slash > prefix.size())
      runs.insert(address.substr(prefix.size(), slash - prefix.size()));
  for (const std::string& run : runs)
    if (std::vector<json> answers = ask_coordinators(run); !answers.empty())
      sessions[prefix + run] = std::move(answers);
  if (options.json) {
    std::cout << json{{"sessions", sessions}}.dump(2) << "\n";
    return kDone;
  }
  if (sessions.empty()) std::cout << "no app is running under XAuto\n";
  for (const auto& [session, xpus] : sessions.items()) {
    std::cout << "run " << session.substr(std::string(runtime::kSocketPrefix).size()) << "\n";
    for (const json& xpu : xpus) {
      std::cout << fmt::format("  {:<8}{}, {}; coordinator pid {}, {} decisions\n",
                               xpu.value("xpu", "?"), xpu.value("discipline", "?"),
                               xpu.value("mode", "?"), xpu.value("pid", 0),
                               xpu.value("decisions", 0ull));
      for (const json& worker : xpu.value("workers", json::array()))
        std::cout << fmt::format("    {:<20}{}\n", worker.value("worker", "?"), words(worker));
    }
  }
  return kDone;
}

}  // namespace

void add_status(Commands& commands) {
  commands.add("status", "Tell what every worker of every running app is doing.", "xauto status",
               [](const Options& options) { return status(options); });
}

}  // namespace xauto::cli
