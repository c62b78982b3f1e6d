// SPDX-License-Identifier: Apache-2.0
#include "xauto/asking.h"

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>

#include <poll.h>
#include <pwd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/socket.h"
#include "base/utf8.h"
#include "coord/protocol.h"
#include "processes/address.h"
#include "processes/parameters.h"

namespace xauto::cli {
namespace {

/// Sockets of other users that are open at a time, of one and of all: else they have our descriptors.
constexpr std::size_t kMostOfOne = 128, kMostOfOthers = 384;
constexpr int kTryAgainMs = 20;  ///< whose queue is full
constexpr std::size_t kMaxAnswer = std::max(coord::kMaxStatusBytes, runtime::kMaxParameterAnswer);

/// Whether the process is the peer's: its pid may have become another one's since it listened. In a PID
/// namespace of its own it has called itself by the last of its numbers.
bool listens(const Peer& peer, pid_t named) {
  std::ifstream status("/proc/" + std::to_string(peer.pid) + "/status");
  bool same_user = false, same_pid = false;
  for (std::string line; std::getline(status, line);) {
    std::istringstream words(line);
    std::string key;
    words >> key;
    if (key == "Uid:") {
      uid_t real = 0, effective = 0;
      same_user = words >> real >> effective && effective == peer.uid;
    } else if (key == "NSpid:") {
      pid_t last = 0;
      for (pid_t pid; words >> pid;) last = pid;
      same_pid = last == named;
    }
  }
  return same_user && same_pid;
}

Status may_ask(const Peer& peer, const RunSocket& at) {
  if (peer.uid == geteuid()) return {};
  const std::string of = "run '" + at.run + "' is of " + user_name(peer.uid);
  if (geteuid() != 0)
    return fail(ErrorCode::kPermission, of + ", and answers only that user and root", "--run",
                "ask as that user, or with sudo");
  if (listens(peer, at.pid)) return {};
  return fail(ErrorCode::kPermission,
              of + ", whose process " + std::to_string(peer.pid) + " is not the one in its name",
              "--run", "somebody has taken this name: it is no run of XAuto");
}

/// Those of others that are open.
class Others {
 public:
  Status count(const Peer& peer, const std::string& run) {
    if (peer.uid == geteuid()) return {};
    if (of_[peer.uid] >= kMostOfOne || all_ >= kMostOfOthers)
      return fail(ErrorCode::kUnavailable,
                  user_name(peer.uid) + " listens at too many names of runs", "run '" + run + "'",
                  "ask for a run by its name");
    ++of_[peer.uid];
    ++all_;
    return {};
  }

 private:
  std::map<uid_t, std::size_t> of_;
  std::size_t all_ = 0;
};

Result<Host> reach(const RunSocket& at, Others& others) {
  XAUTO_ASSIGN(UniqueFd socket, connect_to_anybody(at.address));
  XAUTO_ASSIGN(const Peer peer, peer_of(socket.get()));
  XAUTO_TRY(may_ask(peer, at));
  XAUTO_TRY(others.count(peer, at.run));
  return Host{peer.uid, std::move(socket)};
}

void clean(Json& json, bool lines) {
  if (const auto text = json.text()) json = Json(for_terminal(*text, lines));
  for (Json& element : json.elements()) clean(element, lines);
}

Result<Answer> answer_of(const Host& host, const std::string& address, std::string& room,
                         bool lines) {
  Answer answer{host.uid, {}, {}};
  XAUTO_ASSIGN(const std::size_t size,
               receive_packet(host.socket.get(), room.data(), room.size(), &answer.fds));
  std::optional<Json> said = Json::parse(std::string_view(room).substr(0, size));
  if (!said || !said->is_object())
    return fail(ErrorCode::kInvalid, "answered with something else than a status", address);
  answer.said = *std::move(said);
  clean(answer.said, lines);
  return answer;
}

int left_ms(std::int64_t until_ns) {
  return static_cast<int>(std::max<std::int64_t>(0, (until_ns - now_ns()) / 1'000'000));
}

}  // namespace

std::string user_name(unsigned uid) {
  const passwd* entry = getpwuid(uid);
  return entry != nullptr ? entry->pw_name : "uid " + std::to_string(uid);
}

std::vector<RunSocket> run_sockets() {
  std::vector<RunSocket> sockets;
  for (const std::string& address : abstract_sockets(runtime::kSocketPrefix))
    if (auto parsed = runtime::parse_address(address))
      sockets.push_back({address, parsed->run, parsed->name, parsed->pid});
  return sockets;
}

std::vector<Result<Host>> reach(const std::vector<RunSocket>& sockets, int limit_ms) {
  const std::int64_t until_ns = now_ns() + std::int64_t{limit_ms} * 1'000'000;
  Others others;
  std::vector<Result<Host>> hosts;
  for (const RunSocket& at : sockets) hosts.push_back(reach(at, others));
  const auto waits = [](const Result<Host>& host) {
    return !host && host.error().code == ErrorCode::kTimeout;
  };
  while (std::any_of(hosts.begin(), hosts.end(), waits) && left_ms(until_ns) > 0) {
    poll(nullptr, 0, std::min(kTryAgainMs, left_ms(until_ns)));
    for (std::size_t i = 0; i < hosts.size(); ++i)
      if (waits(hosts[i])) hosts[i] = reach(sockets[i], others);
  }
  return hosts;
}

std::vector<Result<Answer>> ask(const std::vector<RunSocket>& sockets, const std::string& question,
                                int limit_ms, bool lines) {
  const std::int64_t until_ns = now_ns() + std::int64_t{limit_ms} * 1'000'000;
  // Half of it for those whose queue is full, so that whoever else is slow has as much.
  std::vector<Result<Host>> hosts = reach(sockets, limit_ms / 2);
  std::vector<Result<Answer>> answers;
  std::vector<pollfd> fds(sockets.size(), pollfd{-1, POLLIN, 0});
  std::size_t open = 0;
  for (std::size_t i = 0; i < hosts.size(); ++i) {
    answers.emplace_back(fail(ErrorCode::kTimeout,
                              "did not answer within " + std::to_string(limit_ms) + " ms",
                              sockets[i].address));
    Status asked;
    if (hosts[i] && !question.empty())
      asked = send_packet(hosts[i]->socket.get(), question.data(), question.size());
    if (!hosts[i] || !asked) {
      answers[i] = tl::unexpected<Error>(hosts[i] ? asked.error() : hosts[i].error());
      continue;
    }
    fds[i].fd = hosts[i]->socket.get();
    ++open;
  }
  std::string room(kMaxAnswer, '\0');
  while (open > 0) {
    const int ready = poll(fds.data(), fds.size(), left_ms(until_ns));
    if (ready < 0 && errno == EINTR) continue;
    if (ready <= 0) break;
    for (std::size_t i = 0; i < fds.size(); ++i) {
      if (fds[i].fd < 0 || fds[i].revents == 0) continue;
      answers[i] = answer_of(*hosts[i], sockets[i].address, room, lines);
      fds[i].fd = -1;
      --open;
    }
  }
  return answers;
}

}  // namespace xauto::cli
