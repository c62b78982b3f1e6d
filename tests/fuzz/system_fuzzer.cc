// SPDX-License-Identifier: Apache-2.0
// A hostile run, or worker, at the machine's socket: any packets, in any order. The service must neither die nor hang,
// keeps nobody who has said nonsense, and answers a run that comes after it.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <sys/socket.h>

#include "base/socket.h"
#include "coord/protocol.h"
#include "launch/system_service.h"

namespace {

using namespace xauto;
using namespace xauto::launch;

/// Of the two XPUs of good_join().
const std::string kDemand =
    R"({"schema":"xauto.demand","version":1,"ticks_per_us":1,"xpus":[)"
    R"({"id":"a","preemptive":true,"sequences":[{"period":9,"jobs":[{"release":0,"ready":0,"start":0,"key":5,"work":1}]}]},)"
    R"({"id":"b","preemptive":true,"sequences":[{"period":9,"jobs":[{"release":0,"ready":0,"start":0,"key":5,"work":1}]}]}]})";

/// Coordinators cannot be started: what is looked at ends before.
SystemService& service() {
  static SystemService one({.bin = "/nonexistent",
                            .listener = UniqueFd(),
                            .admission = [](const std::vector<Demand>& demands) -> Status {
                              static int asked = 0;
                              if (demands.size() > 1 || ++asked % 2 == 0) return {};
                              return fail(ErrorCode::kInfeasible, "odd", "XPU core0");
                            },
                            .trust = {.all = false, .nobody = false, .users = {}}});
  return one;
}

template <class Packet>
std::string over(Packet packet, const std::uint8_t* data, std::size_t size) {
  std::string text(sizeof packet, '\0');
  std::memcpy(text.data(), &packet, sizeof packet);
  // Pairs of where and what.
  for (std::size_t i = 0; i + 3 <= size; i += 3)
    text[(static_cast<std::size_t>(data[i]) << 8 | data[i + 1]) % text.size()] =
        static_cast<char>(data[i + 2]);
  return text;
}

Join good_join() {
  Join join{
      .num_xnodes = 3, .num_xpus = 2, .demand_bytes = static_cast<std::uint32_t>(kDemand.size())};
  std::strcpy(join.app, "app");
  for (std::uint32_t i = 0; i < 2; ++i) {
    join.xpus[i].id[0] = static_cast<char>('a' + i);
    join.xpus[i].hardware[0] = static_cast<char>('x' + i);
  }
  return join;
}

/// Of one that is not trusted, and what follows it.
Join regulated_join() {
  Join join{.num_xnodes = 3, .num_xpus = 1, .demand_bytes = 2 * sizeof(LeaseTask), .num_tasks = 2};
  std::strcpy(join.app, "app");
  std::strcpy(join.xpus[0].id, "a");
  std::strcpy(join.xpus[0].hardware, "core0");
  return join;
}
struct Tasks {
  LeaseTask of[2] = {
      {.task =
           {.xnode = 0, .period_ns = 9000, .window_ns = 500, .longest_ns = 500, .budget_ns = 100}},
      {.task = {
           .xnode = 1, .period_ns = 9000, .window_ns = 500, .longest_ns = 500, .budget_ns = 100}}};
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0) std::abort();
  const UniqueFd ours(ends[1]);
  fcntl(ours.get(), F_SETFL, O_NONBLOCK);
  const int theirs = service().adopt(UniqueFd(ends[0]), size > 0 && data[0] >= 128 ? 1000 : 0);
  if (theirs < 0) std::abort();
  bool kept = true;
  for (std::size_t at = 0; at + 2 <= size && kept;) {
    const std::size_t length = std::min<std::size_t>(data[at + 1], size - at - 2);
    const std::uint8_t* bytes = data + at + 2;
    std::string packet;
    switch (data[at] % 5) {
      case 0:
        packet.assign(reinterpret_cast<const char*>(bytes), length);
        break;
      case 1:
        packet = over(data[at] < 128 ? good_join() : regulated_join(), bytes, length);
        break;
      case 2:
        packet = over(coord::Attach{}, bytes, length);
        break;
      case 3:
        packet.assign(kDemandPiece, 'd');
        break;
      default:
        packet = data[at] < 128 ? kDemand : over(Tasks{}, bytes, length);
    }
    at += 2 + length;
    if (packet.empty() || !send_packet(ours.get(), packet.data(), packet.size())) continue;
    kept = service().hear(theirs);
  }
  if (kept) {
    shutdown(ours.get(), SHUT_RDWR);
    if (service().hear(theirs)) std::abort();
  }
  return 0;
}
