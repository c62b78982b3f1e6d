// SPDX-License-Identifier: Apache-2.0
#include "launch/system_lease.h"

#include <algorithm>
#include <cstring>

#include <unistd.h>

#include "base/clock.h"
#include "base/socket.h"
#include "processes/marks.h"
#include "xpu/kind.h"

namespace xauto::launch {
namespace {

constexpr std::int64_t kAgainNs = 50'000'000;
constexpr int kWatchMs = 2'000;
constexpr int kAnswerMs = 60'000;  ///< the test of many jobs takes its time

Status may_ask(const std::string& path) {
  if (access(path.c_str(), F_OK) != 0)
    return fail(ErrorCode::kNotFound, "no service of the machine listens there", path);
  if (access(path.c_str(), W_OK) != 0)
    return fail(ErrorCode::kPermission, "this user may not use the machine's coordinators", path,
                "who may is in the socket's group: `sudo adduser $USER xauto`, and log in again");
  return {};
}

}  // namespace

std::vector<JoinXpu> shareable_xpus(const runtime::Session& session) {
  std::vector<JoinXpu> found;
  const std::vector<runtime::RealXpu> real = runtime::real_xpus_of(session);
  for (std::size_t x = 0; x < real.size(); ++x) {
    const Xpu& spec = session.platform.xpus[x];
    const Discipline discipline = xpu::discipline_of(spec, false, session.cpu.by_keys);
    if (real[x].hardware.empty() || discipline == Discipline::kKernel ||
        xpu::orders_one_process(spec, false))
      continue;  // Linux's, or ordered in one process alone
    JoinXpu& xpu = found.emplace_back();
    std::strncpy(xpu.id, spec.id.c_str(), sizeof xpu.id - 1);
    std::strncpy(xpu.hardware, real[x].hardware.c_str(), sizeof xpu.hardware - 1);
    xpu.discipline = static_cast<std::uint32_t>(discipline);
    xpu.levels = xpu::levels_of(spec, false);
    xpu.preempt_us = spec.preempt_us;
    std::strncpy(xpu.type, spec.type.c_str(), sizeof xpu.type - 1);
    const auto all = session.platform.xpus.begin();
    xpu.instance = static_cast<std::int32_t>(
        std::count_if(all, all + static_cast<std::ptrdiff_t>(x),
                      [&](const Xpu& other) { return other.type == spec.type; }));
  }
  return found;
}

Result<Json> ask_who_is_there(const std::string& path) {
  XAUTO_TRY(may_ask(path));
  return coord::ask_machine(path);
}

Result<std::map<std::string, coord::Record>> watch_machine(const std::string& path) {
  XAUTO_TRY(may_ask(path));
  XAUTO_ASSIGN(const UniqueFd socket, connect_path(path));
  const auto ask = static_cast<std::uint32_t>(SystemWord::kWatch);
  XAUTO_TRY(send_packet(socket.get(), &ask, sizeof ask));
  if (!wait_readable(socket.get(), kWatchMs))
    return fail(ErrorCode::kTimeout, "did not answer", path);
  std::string text(coord::kMaxStatusBytes, '\0');
  std::vector<UniqueFd> fds;
  XAUTO_ASSIGN(const std::size_t size,
               receive_packet(socket.get(), text.data(), text.size(), &fds));
  text.resize(size);
  const Json told = Json::parse(text).value_or(Json());
  if (!told.at("trusted").boolean().value_or(true))
    return fail(ErrorCode::kPermission, "runs of this user are not trusted there", path,
                "`xauto top` shows the shares of all");
  if (told.at("xpus").elements().size() != fds.size())
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", path,
                "use one build of XAuto");
  std::map<std::string, coord::Record> records;
  for (std::size_t i = 0; i < fds.size(); ++i) {
    XAUTO_ASSIGN(coord::Record record, coord::Record::map(fds[i].get(), false));
    records[told.at("xpus").elements()[i].text().value_or("?")] = std::move(record);
  }
  return records;
}

bool is_regulated(const std::string& path) {
  const auto told = ask_who_is_there(path);
  const Json* regulated = told ? told->find("you_are_regulated") : nullptr;
  return regulated != nullptr && regulated->boolean().value_or(false);
}

Result<SystemLease> SystemLease::ask(const LeaseRequest& request) {
  const std::int64_t until = now_ns() + kGiveBackNs;
  for (;;) {
    bool later = false;
    auto lease = ask_once(request, later);
    if (lease || !later || now_ns() > until) return lease;
    sleep_until_ns(now_ns() + kAgainNs);
  }
}

Result<SystemLease> SystemLease::ask_once(const LeaseRequest& request, bool& later) {
  std::string demand = request.demand;
  if (!request.tasks.empty())
    demand.assign(reinterpret_cast<const char*>(request.tasks.data()),
                  request.tasks.size() * sizeof(LeaseTask));
  if (demand.empty() || demand.size() > kMaxDemandBytes)
    return fail(ErrorCode::kInvalid,
                "the demand has " + std::to_string(demand.size()) + " bytes, not 1.." +
                    std::to_string(kMaxDemandBytes),
                request.app);
  if (request.xpus.size() > kMaxLeaseXpus)
    return fail(ErrorCode::kInvalid, "uses more than " + std::to_string(kMaxLeaseXpus) + " XPUs",
                request.app);
  SystemLease lease;
  lease.path_ = request.path;
  XAUTO_TRY(may_ask(request.path));
  XAUTO_ASSIGN(lease.socket_, connect_path(request.path));
  Join join{.num_xnodes = request.num_xnodes,
            .num_xpus = static_cast<std::uint32_t>(request.xpus.size()),
            .demand_bytes = static_cast<std::uint32_t>(demand.size()),
            .num_tasks = static_cast<std::uint32_t>(request.tasks.size())};
  std::strncpy(join.app, request.app.c_str(), sizeof join.app - 1);
  std::copy(request.xpus.begin(), request.xpus.end(), join.xpus);
  const int fd = lease.socket_.get();
  XAUTO_TRY(send_packet(fd, &join, sizeof join, {}, IfFull::kWait));
  for (std::size_t at = 0; at < demand.size(); at += kDemandPiece) {
    const std::size_t bytes = std::min(kDemandPiece, demand.size() - at);
    // Where it was refused meanwhile, the answer is there all the same.
    if (!send_packet(fd, demand.data() + at, bytes, {}, IfFull::kWait)) break;
  }
  if (!wait_readable(fd, kAnswerMs))
    return fail(ErrorCode::kTimeout, "did not answer within a minute", request.path);
  NotAdmitted answer;  // the larger of both
  XAUTO_ASSIGN(const std::size_t size, receive_packet(fd, &answer, sizeof answer));
  if (size == sizeof answer &&
      answer.kind == static_cast<std::uint32_t>(SystemWord::kNotAdmitted)) {
    answer.reason[sizeof answer.reason - 1] = '\0';
    later = answer.later == 1;
    return fail(ErrorCode::kInfeasible, std::string("is not admitted: ") + answer.reason,
                request.app, "`xauto top` shows who is there; `xauto solve --beside` plans for it");
  }
  Admitted admitted;
  if (size != sizeof admitted)
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", request.path);
  std::memcpy(&admitted, static_cast<const void*>(&answer), sizeof admitted);
  if (admitted.kind != static_cast<std::uint32_t>(SystemWord::kAdmitted))
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", request.path);
  lease.lease_ = {.number = admitted.lease,
                  .secret = admitted.secret,
                  .first_xnode = admitted.first_xnode,
                  .num_xnodes = admitted.num_xnodes};
  return lease;
}

std::string SystemLease::address(const std::string& hardware) const {
  return coord::Door{.path = path_, .name = hardware, .lease = lease_}.to_text();
}

}  // namespace xauto::launch
