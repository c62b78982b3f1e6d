// SPDX-License-Identifier: Apache-2.0
#include "processes/marks.h"

#include <algorithm>
#include <cstring>

#include <sys/stat.h>

#include "base/rt.h"
#include "base/socket.h"
#include "base/utf8.h"

namespace xauto::runtime {
namespace {

/// Of the process whose number begins the run's name.
std::string uid_of(const std::string& run) {
  const std::string pid = run.substr(0, run.find('-'));
  if (pid.empty() || pid.find_first_not_of("0123456789") != std::string::npos) return {};
  struct stat status {};
  if (stat(("/proc/" + pid).c_str(), &status) != 0) return {};
  // Its name would be asked of services, in the app's process.
  return std::to_string(status.st_uid);
}

}  // namespace

std::vector<std::string> hardware_of(const Platform& platform,
                                     const std::vector<Presence>& presence) {
  const std::vector<int> cores = rt::allowed_cores();
  std::vector<std::string> names(platform.xpus.size());
  for (std::size_t x = 0; x < names.size(); ++x) {
    if (!presence.empty() && presence[x] != Presence::kReal) continue;
    const Xpu& xpu = platform.xpus[x];
    const auto instance = static_cast<std::size_t>(
        std::count_if(platform.xpus.begin(), platform.xpus.begin() + static_cast<std::ptrdiff_t>(x),
                      [&](const Xpu& other) { return other.type == xpu.type; }));
    names[x] = xpu.type == "cpu" && instance < cores.size()
                   ? "core" + std::to_string(cores[instance])
                   : xpu.id;
  }
  return names;
}

std::vector<std::string> marks_of(const Session& session) {
  std::vector<std::string> marks;
  if (session.mode != Mode::kRun) return marks;
  for (const std::string& hardware : hardware_of(session.platform, session.presence))
    if (!hardware.empty()) marks.push_back(kMark + hardware);
  std::sort(marks.begin(), marks.end());
  marks.erase(std::unique(marks.begin(), marks.end()), marks.end());
  return marks;
}

std::string Holder::words() const {
  return "run " + run + (uid.empty() ? "" : " of uid " + uid);
}

std::string run_of_address(const std::string& address) {
  return address.substr(0, address.rfind('/') + 1);
}

std::vector<Holder> holders(const std::string& own) {
  std::vector<Holder> found;
  for (const std::string& address : abstract_names(kSocketPrefix)) {
    const std::size_t first = address.find('/', std::strlen(kSocketPrefix)),
                      last = address.rfind('/');
    if (first == std::string::npos || address.compare(last + 1, std::strlen(kMark), kMark) != 0)
      continue;
    if ((!own.empty() && run_of_address(address) == own) || for_terminal(address, false) != address)
      continue;
    const std::string run =
        address.substr(std::strlen(kSocketPrefix), first - std::strlen(kSocketPrefix));
    found.push_back({address.substr(last + 1 + std::strlen(kMark)), run, uid_of(run)});
  }
  return found;
}

}  // namespace xauto::runtime
