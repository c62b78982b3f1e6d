// SPDX-License-Identifier: Apache-2.0
// xauto status: every state machine of every running app in words. Coordinators are found by the
// names of their sockets and asked; nothing is written anywhere for this.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <set>

#include <fmt/format.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/socket.h"
#include "model/json_value.h"

#include "launch/supervisor.h"
#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

constexpr const char* kCoordinator = "xauto-coordinat";  // as /proc/PID/comm cuts it

std::string words(const Json& worker) {
  const std::string state = worker.at("state").text().value_or("?");
  if (state == "idle") return "idle";
  std::string text =
      fmt::format("{}: {} (job {}, priority {}, since {:.2f} ms)", state,
                  worker.at("xnode").text().value_or("?"), worker.at("job").integer().value_or(0),
                  worker.at("priority").integer().value_or(0),
                  worker.at("since_us").number().value_or(0) / 1000);
  if (const auto by = worker.at("by").text()) text += " by " + *by;
  return text;
}

/// A coordinator that did not answer us, by what /proc tells everybody.
struct Unseen {
  int pid = 0;
  unsigned uid = 0;
  bool elsewhere = false;  ///< known to be in another network namespace
};

std::string user_name(unsigned uid) {
  const passwd* entry = getpwuid(uid);
  return entry != nullptr ? entry->pw_name : "uid " + std::to_string(uid);
}

std::vector<Unseen> coordinators_but(const std::set<int>& answered) {
  std::error_code error;
  const auto mine = std::filesystem::read_symlink("/proc/self/ns/net", error);
  std::vector<Unseen> unseen;
  for (const auto& entry : std::filesystem::directory_iterator("/proc", error)) {
    const std::string name = entry.path().filename().string();
    const int pid = std::atoi(name.c_str());
    if (pid <= 0 || answered.contains(pid)) continue;
    std::string command;
    std::ifstream file(entry.path() / "comm");
    std::getline(file, command);
    struct stat owner {};
    if (command != kCoordinator || stat(entry.path().c_str(), &owner) != 0) continue;
    const auto theirs = std::filesystem::read_symlink(entry.path() / "ns/net", error);
    unseen.push_back({pid, owner.st_uid, !error && theirs != mine});
  }
  return unseen;
}

/// What is there and cannot be asked from here, and how it can.
std::string words(const Unseen& one) {
  const std::string user = user_name(one.uid);
  std::string text = fmt::format("coordinator pid {} of {}", one.pid, user);
  if (one.elsewhere)
    return text + fmt::format(
                      " is in another network namespace; "
                      "`sudo nsenter -t {0} -n xauto status` asks it",
                      one.pid);
  if (one.uid != geteuid())
    return text + fmt::format(" answers only that user and root; `sudo xauto status` asks it");
  return text + " did not answer";
}

int status(const Options& options) {
  Json sessions = Json::object();
  std::set<int> answered;
  std::set<std::string> runs;
  const std::string prefix = launch::kSocketPrefix;
  for (const std::string& address : abstract_sockets(prefix))
    if (const std::size_t slash = address.rfind('/'); slash > prefix.size())
      runs.insert(address.substr(prefix.size(), slash - prefix.size()));
  for (const std::string& run : runs)
    if (std::vector<Json> answers = ask_coordinators(run); !answers.empty()) {
      for (const Json& answer : answers)
        answered.insert(static_cast<int>(answer.at("pid").integer().value_or(0)));
      sessions[prefix + run] = answers;
    }
  const std::vector<Unseen> unseen = coordinators_but(answered);
  if (options.json) {
    Json list = Json::array();
    for (const Unseen& one : unseen)
      list.push_back({{"pid", one.pid}, {"user", user_name(one.uid)}, {"why", words(one)}});
    Json all = {{"sessions", sessions}};
    if (!unseen.empty()) all["unseen"] = list;
    std::cout << all.dump(2) << "\n";
    return kDone;
  }
  if (sessions.elements().empty())
    std::cout << (unseen.empty()
                      ? "no app is running under XAuto, as far as can be seen from here: in this "
                        "network namespace and its processes\n"
                      : "no app that can be asked from here is running under XAuto\n");
  for (const Unseen& one : unseen) std::cout << "  not seen: " << words(one) << "\n";
  for (std::size_t i = 0; i < sessions.keys().size(); ++i) {
    std::cout << "run " << sessions.keys()[i].substr(prefix.size()) << "\n";
    for (const Json& xpu : sessions.elements()[i].elements()) {
      std::cout << fmt::format(
          "  {:<8}{}, {}; coordinator pid {}, {} decisions\n", xpu.at("xpu").text().value_or("?"),
          xpu.at("discipline").text().value_or("?"), xpu.at("mode").text().value_or("?"),
          xpu.at("pid").integer().value_or(0), xpu.at("decisions").integer().value_or(0));
      for (const Json& worker : xpu.at("workers").elements())
        std::cout << fmt::format("    {:<20}{}\n", worker.at("worker").text().value_or("?"),
                                 words(worker));
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
