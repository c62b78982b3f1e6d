// SPDX-License-Identifier: Apache-2.0
#include "processes/marks.h"

#include <algorithm>
#include <cstring>

#include <sys/stat.h>

#include "base/rt.h"
#include "base/socket.h"
#include "graph/graph.h"
#include "processes/address.h"

namespace xauto::runtime {
namespace {

constexpr const char* kSharedMark = "+";  ///< behind the hardware's name

bool uses(const Session& session, int xpu) {
  if (session.scheduling == Scheduling::kRos2) return true;
  for (std::size_t t = 0; t < session.num_tables(); ++t)
    for (const PriorityPlacement& placed : session.of_table(t).placements)
      if (placed.xpu == xpu) return true;
  return false;
}

std::string uid_of(pid_t process) {
  struct stat status {};
  if (stat(("/proc/" + std::to_string(process)).c_str(), &status) != 0) return {};
  // Its name would be asked of services, in the app's process.
  return std::to_string(status.st_uid);
}

}  // namespace

std::vector<RealXpu> real_xpus_of(const Session& session) {
  const std::vector<int> cores = rt::allowed_cores();
  std::vector<RealXpu> found(session.platform.xpus.size());
  for (std::size_t x = 0; x < found.size(); ++x) {
    const int at = static_cast<int>(x);
    if (session.presence_of(at) != Presence::kReal || !uses(session, at)) continue;
    const XpuId id = xpu_id(session.platform, at);
    const auto instance = static_cast<std::size_t>(id.index);
    if (session.platform.xpus[x].type == "cpu" && instance < cores.size())
      found[x] = {"core" + std::to_string(cores[instance]), cores[instance]};
    else
      found[x] = {session.platform.xpus[x].id, -1};
    found[x].shared = session.shares(session.platform.xpus[x].id);
  }
  return found;
}

std::vector<std::string> marks_of(const Session& session) {
  std::vector<std::string> marks;
  if (session.mode != Mode::kRun) return marks;
  for (const RealXpu& xpu : real_xpus_of(session))
    if (!xpu.hardware.empty())
      marks.push_back(kMark + xpu.hardware + (xpu.shared ? kSharedMark : ""));
  std::sort(marks.begin(), marks.end());
  marks.erase(std::unique(marks.begin(), marks.end()), marks.end());
  return marks;
}

std::string Holder::words() const {
  return "run " + run + (uid.empty() ? "" : " of uid " + uid);
}

std::vector<Holder> holders(const std::string& own) {
  std::vector<Holder> found;
  for (const std::string& address : abstract_names(kSocketPrefix)) {
    const auto parsed = parse_address(address);
    if (!parsed || !parsed->name.starts_with(kMark) || (!own.empty() && stem_of(address) == own))
      continue;
    std::string hardware = parsed->name.substr(std::strlen(kMark));
    const bool shared = hardware.ends_with(kSharedMark);
    if (shared) hardware.resize(hardware.size() - std::strlen(kSharedMark));
    found.push_back({std::move(hardware), parsed->run, uid_of(parsed->pid), shared});
  }
  return found;
}

}  // namespace xauto::runtime
