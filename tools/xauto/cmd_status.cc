// SPDX-License-Identifier: Apache-2.0
// xauto status: every state machine of every running app in words. Coordinators are found by the
// names of their sockets and asked; nothing is written anywhere for this.
#include <iostream>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <poll.h>

#include "base/log.h"
#include "base/socket.h"
#include "coord/protocol.h"
#include "runtime/supervisor.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

using nlohmann::json;
constexpr int kAnswerTimeoutMs = 1000;

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

int status(const Options& options) {
  json sessions = json::object();
  for (const std::string& address : abstract_sockets(runtime::kSocketPrefix)) {
    const std::size_t slash = address.rfind('/');
    const std::string name = address.substr(slash + 1);
    if (name == runtime::kEmudName || name == runtime::kHubName) continue;
    auto answer = ask(address);
    if (!answer) {  // it ended between the look at the table and the question
      log::debug("{}", answer.error().to_string());
      continue;
    }
    sessions[address.substr(0, slash)].push_back(std::move(*answer));
  }
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
