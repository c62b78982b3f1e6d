// SPDX-License-Identifier: Apache-2.0
#include "xauto/unseen.h"

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "xauto/asking.h"

namespace xauto::cli {
namespace {

constexpr const char* kCoordinator = "xauto-coordinat";  // as /proc/PID/comm cuts it

}  // namespace

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

std::string words_of(const Unseen& one) {
  const std::string text = fmt::format("coordinator pid {} of {}", one.pid, user_name(one.uid));
  if (one.elsewhere)
    return text + fmt::format(
                      " is in another network namespace; "
                      "`sudo nsenter -t {} -n xauto top --once` asks it",
                      one.pid);
  if (one.uid != geteuid())
    return text + " answers only that user and root; `sudo xauto top --once` asks it";
  return text + " did not answer";
}

}  // namespace xauto::cli
