// SPDX-License-Identifier: Apache-2.0
// xauto status: every state machine of every running app in words. Coordinators are found by the
// names of their sockets and asked; nothing is written anywhere for this.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <set>

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "launch/sockets.h"
#include "model/json_value.h"
#include "model/xpu_status.h"

#include "xauto/asking.h"
#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

constexpr const char* kCoordinator = "xauto-coordinat";  // as /proc/PID/comm cuts it

std::string words(const WorkerStatus& worker) {
  if (worker.idle()) return worker.state;
  const auto ms = [](std::int64_t us) { return static_cast<double>(us) / 1000; };
  const std::string urgency = worker.due_us ? fmt::format("due in {:.2f} ms", ms(*worker.due_us))
                                            : fmt::format("priority {}", worker.priority);
  return fmt::format("{}: {} (job {}, {}, since {:.2f} ms){}", worker.state, worker.xnode,
                     worker.job, urgency, ms(static_cast<std::int64_t>(worker.since_us)),
                     worker.by.empty() ? "" : " by " + worker.by);
}

/// A coordinator that did not answer us, by what /proc tells everybody.
struct Unseen {
  int pid = 0;
  unsigned uid = 0;
  bool elsewhere = false;  ///< known to be in another network namespace
};

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
  const std::string prefix = launch::kSocketPrefix;
  const std::map<std::string, Coordinated> sessions = ask_coordinators();
  std::set<int> answered;
  std::vector<std::string> runs;
  for (const auto& [run, of] : sessions) {
    runs.push_back(run);
    for (const XpuStatus& xpu : of.xpus) answered.insert(static_cast<int>(xpu.pid));
  }
  const std::vector<Unseen> unseen = coordinators_but(answered);
  std::map<std::string, Counts> looks;  // of runs that claim something
  for (const Watched& watched : introduced(runs))
    if (Counts counts = counts_of(*watched.board); counts.account.claims() || counts.scenario)
      looks.emplace(watched.run, std::move(counts));
  if (options.json) {
    Json list = Json::array();
    for (const Unseen& one : unseen)
      list.push_back({{"pid", one.pid}, {"user", user_name(one.uid)}, {"why", words(one)}});
    Json runs_of = Json::object();
    Json users = Json::object();
    for (const auto& [run, of] : sessions) {
      Json answers = Json::array();
      for (const XpuStatus& xpu : of.xpus) answers.push_back(to_json(xpu));
      runs_of[prefix + run] = std::move(answers);
      if (of.uid != geteuid()) users[prefix + run] = user_name(of.uid);
    }
    Json all = {{"sessions", std::move(runs_of)}};
    if (!users.elements().empty()) all["users"] = std::move(users);
    for (const auto& [run, counts] : looks) {
      if (counts.scenario) all["scenario"][(prefix + run).c_str()] = scenario_json(counts);
      if (!counts.account.claims()) continue;
      Json chains = Json::array();
      const auto measured = [](std::int64_t us) { return us < 0 ? Json() : Json(us); };
      for (const FlowCounts& chain : counts.chains) {
        if (chain.worst_case_us == 0) continue;  // with tables the scenarios claim: `xauto param`
        chains.push_back({{"name", chain.name},
                          {"last_us", measured(chain.last_us)},
                          {"longest_us", measured(chain.longest_us)},
                          {"worst_case_us", chain.worst_case_us}});
        if (chain.lower_bound_us > 0)
          chains.elements().back()["lower_bound_us"] = chain.lower_bound_us;
        if (chain.urgent_worst_case_us > 0)
          chains.elements().back()["urgent"] = {{"longest_us", measured(chain.longest_urgent_us)},
                                                {"worst_case_us", chain.urgent_worst_case_us}};
      }
      Json claims = runtime::claims_json(counts.account);
      claims["chains"] = std::move(chains);
      all["claims"][(prefix + run).c_str()] = std::move(claims);
    }
    if (!unseen.empty()) all["unseen"] = list;
    std::cout << all.dump(2) << "\n";
    return kDone;
  }
  if (sessions.empty())
    std::cout << (unseen.empty()
                      ? "no app is running under XAuto, as far as can be seen from here: in this "
                        "network namespace and its processes\n"
                      : "no app that can be asked from here is running under XAuto\n");
  for (const Unseen& one : unseen) std::cout << "  not seen: " << words(one) << "\n";
  for (const auto& [run, of] : sessions) {
    std::cout << "run " << run << (of.uid == geteuid() ? "" : " of " + user_name(of.uid)) << "\n";
    if (const auto seen = looks.find(run); seen != looks.end())
      std::cout << claims_text(seen->second) << scenario_text(seen->second) << "\n";
    for (const XpuStatus& xpu : of.xpus) {
      std::cout << fmt::format(
          "  {:<8}{}, {}; coordinator pid {}, {} decisions\n", xpu.xpu, to_string(xpu.discipline),
          xpu.arbitrated ? "arbitrated" : "uncontended", xpu.pid, xpu.decisions);
      for (const WorkerStatus& worker : xpu.workers)
        std::cout << fmt::format("    {:<20}{}\n", worker.worker, words(worker));
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
