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
#include <nlohmann/json.hpp>
#include <poll.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/log.h"
#include "base/socket.h"
#include "coord/protocol.h"
#include "runtime/supervisor.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

using nlohmann::json;
constexpr int kAnswerTimeoutMs = 1000;
constexpr const char* kCoordinator = "xauto-coordinat";  // as /proc/PID/comm cuts it

Result<json> ask(const std::string& address) {
  XAUTO_ASSIGN(const UniqueFd socket, connect_abstract(address));
  const auto kind = static_cast<std::uint32_t>(coord::MessageKind::kStatus);
  XAUTO_TRY(send_packet(socket.get(), &kind, sizeof kind));
  pollfd ready{socket.get(), POLLIN, 0};
  if (poll(&ready, 1, kAnswerTimeoutMs) != 1)
    return fail(ErrorCode::kTimeout, "did not answer within 1 s", address);
  std::string text(coord::kMaxStatusBytes, '\0');
  XAUTO_ASSIGN(const std::size_t size, receive_packet(socket.get(), text.data(), text.size()));
  json parsed = json::parse(text.substr(0, size), nullptr, false);
  if (parsed.is_discarded() || !parsed.is_object())
    return fail(ErrorCode::kInvalid, "answered with something else than a status", address);
  return parsed;
}

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
  json sessions = json::object();
  std::set<int> answered;
  for (const std::string& address : abstract_sockets(runtime::kSocketPrefix)) {
    const std::size_t slash = address.rfind('/');
    const std::string name = address.substr(slash + 1);
    if (name == runtime::kEmudName || name == runtime::kHubName) continue;
    auto answer = ask(address);
    if (!answer) {  // it ended between the look at the table and the question
      log::debug("{}", answer.error().to_string());
      continue;
    }
    answered.insert(answer->value("pid", 0));
    sessions[address.substr(0, slash)].push_back(std::move(*answer));
  }
  const std::vector<Unseen> unseen = coordinators_but(answered);
  if (options.json) {
    json list = json::array();
    for (const Unseen& one : unseen)
      list.push_back({{"pid", one.pid}, {"user", user_name(one.uid)}, {"why", words(one)}});
    json all = {{"sessions", sessions}};
    if (!list.empty()) all["unseen"] = list;
    std::cout << all.dump(2) << "\n";
    return kDone;
  }
  if (sessions.empty())
    std::cout << (unseen.empty()
                      ? "no app is running under XAuto, as far as can be seen from here: in this "
                        "network namespace and its processes\n"
                      : "no app that can be asked from here is running under XAuto\n");
  for (const Unseen& one : unseen) std::cout << "  not seen: " << words(one) << "\n";
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
