// SPDX-License-Identifier: Apache-2.0
// xauto-grant: the one program of XAuto that may hold a right that its caller has not. It raises
// its own RLIMIT_RTPRIO to what /etc/xauto/grants.json grants the caller, gives every capability
// away, and becomes the program that it was given: the xauto tool, which goes through here at its
// start (tools/xauto/priorities.h). All that the tool starts inherits the limit, and the kernel
// enforces it. docs/adr/006-grants.md says why it is a program of its own.
//
//   setcap cap_sys_resource=p xauto-grant       permitted, not effective: raised for one call
//
// It is run by anybody with any arguments, environment and descriptors, so: only
// CAP_SYS_RESOURCE is kept, and that not effective, until the limit is set; until then nothing is
// read that is not root's; the environment is never used; the arguments are looked at afterwards,
// except to tell the two forms apart. No limit but its own is changed: there is no process number
// that could be somebody else's by the time it is used.
#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <grp.h>
#include <linux/capability.h>
#include <pwd.h>
#include <sys/auxv.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "model/grants.h"

namespace {

using xauto::ErrorCode;
using xauto::fail;
using xauto::Result;
using xauto::Status;

constexpr const char* kFile = XAUTO_SYSCONFDIR "/xauto/grants.json";
constexpr std::size_t kMaxEnvironment = 8u << 20;  // the kernel's own limit is below
constexpr std::size_t kMaxReason = 500;
constexpr std::uint32_t kRight = 1u << CAP_SYS_RESOURCE;

// ---- capabilities ----

struct Capabilities {
  __user_cap_data_struct words[2] = {};

  static Capabilities mine() {
    Capabilities found;
    __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
    if (syscall(SYS_capget, &header, found.words) != 0) std::abort();
    return found;
  }
  [[nodiscard]] bool set() const {
    __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
    return syscall(SYS_capset, &header, words) == 0;
  }
};

/// Whether we had it. Afterwards it is all that we have, and only permitted.
bool keep_the_one_right() {
  Capabilities kept = Capabilities::mine();
  const bool there = (kept.words[0].permitted & kRight) != 0;
  kept = {};
  kept.words[0].permitted = there ? kRight : 0;
  if (prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0) != 0 || !kept.set()) std::abort();
  return there;
}

void give_all_away() {
  if (!Capabilities{}.set()) std::abort();
  const Capabilities left = Capabilities::mine();
  for (const auto& word : left.words)
    if ((word.permitted | word.effective | word.inheritable) != 0) std::abort();
}

// ---- who gets what ----

xauto::Identity::Id group_of(gid_t gid) {
  std::vector<char> memory(64 * 1024);
  group entry{}, *found = nullptr;
  if (getgrgid_r(gid, &entry, memory.data(), memory.size(), &found) != 0 || found == nullptr)
    return {gid, {}};
  return {gid, found->gr_name};
}

xauto::Identity caller() {
  xauto::Identity who;
  who.user.number = getuid();
  std::vector<char> memory(64 * 1024);
  passwd entry{}, *found = nullptr;
  if (getpwuid_r(getuid(), &entry, memory.data(), memory.size(), &found) == 0 && found != nullptr)
    who.user.name = found->pw_name;
  std::vector<gid_t> groups(static_cast<std::size_t>(std::max(0, getgroups(0, nullptr))));
  const int count = getgroups(static_cast<int>(groups.size()), groups.data());
  groups.resize(static_cast<std::size_t>(std::max(0, count)));
  groups.push_back(getgid());
  for (const gid_t gid : groups) who.groups.push_back(group_of(gid));
  const xauto::UniqueFd file(open("/proc/self/cgroup", O_RDONLY | O_CLOEXEC));
  std::string text(64 * 1024, '\0');
  const ssize_t got = file ? read(file.get(), text.data(), text.size()) : 0;
  text.resize(static_cast<std::size_t>(std::max<ssize_t>(0, got)));
  who.cgroup = xauto::cgroup_of(text);
  return who;
}

std::string to_string(const xauto::Identity& who) {
  return "user " + (who.user.name.empty() ? std::to_string(who.user.number) : who.user.name) +
         (who.cgroup.empty() ? "" : " in cgroup " + who.cgroup);
}

Result<xauto::Grant> find(const std::string& path, uid_t owner, const xauto::Identity& who) {
  XAUTO_ASSIGN(const xauto::Grants grants, xauto::load_grants(path, owner));
  const xauto::Grant* grant = grants.find(who);
  if (grant == nullptr)
    return fail(ErrorCode::kPermission, "grants nothing to " + to_string(who), path);
  return *grant;
}

std::string no_right() {
  char path[4096];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  return "xauto-grant has no right to raise limits: `setcap cap_sys_resource=p " +
         std::string(path, length > 0 ? static_cast<std::size_t>(length) : 0) +
         "` as root, where no container or service forbids it";
}

/// Only upwards: who has more already keeps it.
Status raise(const xauto::FifoRange& range) {
  rlimit limit{};
  if (getrlimit(RLIMIT_RTPRIO, &limit) != 0) return fail(ErrorCode::kIo, "getrlimit");
  const auto highest = static_cast<rlim_t>(range.highest);
  const rlimit wanted{std::max(limit.rlim_cur, highest), std::max(limit.rlim_max, highest)};
  Capabilities raised = Capabilities::mine();
  raised.words[0].effective = raised.words[0].permitted & kRight;
  if (!raised.set()) return fail(ErrorCode::kPermission, "capset");
  const int error = setrlimit(RLIMIT_RTPRIO, &wanted) == 0 ? 0 : errno;
  give_all_away();
  if (error != 0) return fail(ErrorCode::kPermission, std::string("setrlimit: ") + strerror(error));
  if (getrlimit(RLIMIT_RTPRIO, &limit) != 0 || limit.rlim_cur != wanted.rlim_cur ||
      limit.rlim_max != wanted.rlim_max)
    return fail(ErrorCode::kPermission, "the limit was accepted but not set");
  return {};
}

/// "LOWEST-HIGHEST", or "0-0 " and why.
std::string grant(bool right) {
  if (!right) return "0-0 " + no_right();
  auto found = find(kFile, 0, caller());
  if (found) {
    const Status raised = raise(found->range);
    if (raised)
      return std::to_string(found->range.lowest) + "-" + std::to_string(found->range.highest);
    found = tl::unexpected<xauto::Error>(raised.error());
  }
  std::string why = found.error().to_string().substr(0, kMaxReason);
  for (char& c : why)
    if (static_cast<unsigned char>(c) < 0x20) c = ' ';
  return "0-0 " + why;
}

// ---- without any right, from here on ----

int complain(const std::string& what) {
  std::fprintf(stderr, "xauto-grant: %s\n", what.c_str());
  return 2;
}

bool number(const char* text, long low, long high, int& value) {
  char* end = nullptr;
  errno = 0;
  const long read = std::strtol(text, &end, 10);
  if (errno != 0 || end == text || *end != '\0' || read < low || read > high) return false;
  value = static_cast<int>(read);
  return true;
}

/// The caller's environment, of which the loader has taken away what a program with rights must not
/// see, and the next one needs: texts with a NUL after each.
bool read_environment(int fd, std::string& text) {
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode) ||
      static_cast<std::size_t>(status.st_size) > kMaxEnvironment)
    return false;
  text.resize(static_cast<std::size_t>(status.st_size));
  for (std::size_t done = 0; done < text.size();) {
    const ssize_t got = pread(fd, text.data() + done, text.size() - done, static_cast<off_t>(done));
    if (got <= 0) return false;
    done += static_cast<std::size_t>(got);
  }
  return text.empty() || text.back() == '\0';
}

int become(const std::string& outcome, int argc, char** argv) {
  int environment_fd = -1, death_signal = 0, parent = 0;
  if (argc < 7 || !number(argv[2], 3, 1'000'000, environment_fd) ||
      !number(argv[3], 0, 64, death_signal) || !number(argv[4], 0, INT32_MAX, parent))
    return complain("--exec is between the xauto tool and this program");
  std::string text;
  if (!read_environment(environment_fd, text)) return complain("no environment");
  close(environment_fd);
  std::string told = "XAUTO_GRANT=" + outcome;
  std::vector<char*> environment = {told.data()};
  for (std::size_t at = 0; at < text.size(); at += std::strlen(text.data() + at) + 1)
    if (std::strncmp(text.data() + at, "XAUTO_GRANT=", 12) != 0)
      environment.push_back(text.data() + at);
  environment.push_back(nullptr);
  // The kernel has forgotten it when it gave us the capability.
  if (death_signal != 0) {
    if (prctl(PR_SET_PDEATHSIG, death_signal) != 0) return complain("PR_SET_PDEATHSIG");
    if (getppid() != parent) return 128 + death_signal;  // it died before we asked to be told
  }
  execve(argv[5], argv + 6, environment.data());
  return complain(std::string("cannot start ") + argv[5] + ": " + strerror(errno));
}

int query(bool right, int argc, char** argv) {
  const bool own_file = argc == 3;
  if (own_file && getauxval(AT_SECURE) != 0)
    return complain(std::string("with rights of its own it reads ") + kFile + " only");
  const xauto::Identity who = caller();
  const auto found = own_file ? find(argv[2], getuid(), who) : find(kFile, 0, who);
  if (!found) {
    const xauto::Error& error = found.error();
    std::printf("nothing: %s\n", error.to_string().c_str());
    return 1;
  }
  std::printf("SCHED_FIFO %d to %d for %s, by %s\n", found->range.lowest, found->range.highest,
              to_string(who).c_str(), found->to_string().c_str());
  if (right || own_file) return 0;
  std::printf("but %s\n", no_right().c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  prctl(PR_SET_DUMPABLE, 0);
  if (getuid() != geteuid() || getgid() != getegid())
    return complain("must not be set-user-ID or set-group-ID: " + no_right());
  const bool right = keep_the_one_right();
  const std::string form = argc > 1 ? argv[1] : "";
  if (form == "--exec") {
    const std::string outcome = grant(right);
    give_all_away();
    return become(outcome, argc, argv);
  }
  if (form == "--query" && argc <= 3) {
    give_all_away();
    return query(right, argc, argv);
  }
  give_all_away();
  return complain(
      "raises the real-time limit of the xauto tool as " + std::string(kFile) +
      " says; started by it.\n  xauto-grant --query          what that file grants you");
}
