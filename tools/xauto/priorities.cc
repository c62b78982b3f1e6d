// SPDX-License-Identifier: Apache-2.0
#include "xauto/priorities.h"

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <linux/capability.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/xattr.h>
#include <unistd.h>

#include "base/log.h"
#include "base/memory_file.h"
#include "base/process.h"
#include "base/rt.h"
#include "runtime/priorities.h"

extern char** environ;

namespace xauto::cli {
namespace {

constexpr const char* kVariable = "XAUTO_GRANT";

Granted& outcome() {
  static Granted granted;
  return granted;
}

/// What xauto-grant would take from us: the ambient and inheritable ones, which whoever started us
/// has meant for us. CAP_WAKE_ALARM does not count: newer systemds give it to every login, and no
/// app of ours sets an alarm clock.
bool has_capabilities() {
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  __user_cap_data_struct words[2] = {};
  if (syscall(SYS_capget, &header, words) != 0) return true;
  const std::uint32_t first = words[0].permitted | words[0].inheritable;
  const std::uint32_t second = words[1].permitted | words[1].inheritable;
  return (first | (second & ~CAP_TO_MASK(CAP_WAKE_ALARM))) != 0;
}

/// By anybody who could start us; it changes nothing but what we say and the lowest priority that
/// we use.
bool was_told() {
  const char* text = std::getenv(kVariable);
  if (text == nullptr) return false;
  Granted& granted = outcome();
  int used = 0;
  if (std::sscanf(text, "%2d-%2d%n", &granted.lowest, &granted.highest, &used) != 2 ||
      granted.lowest < 0 || granted.lowest > granted.highest)
    granted = {};
  else if (granted.highest == 0 && text[used] == ' ')
    granted.why = std::string(text + used + 1).substr(0, 1000);
  unsetenv(kVariable);  // the app's own affair, should it start an xauto
  return true;
}

}  // namespace

const Granted& granted() {
  return outcome();
}

void obtain_priorities(char** argv) {
  if (was_told() || rt::may_use_fifo(runtime::kFifoHighest)) return;
  const std::string helper = program_directory() + "/xauto-grant";
  // Nobody has given it the capability: then there is nothing to ask for.
  if (getxattr(helper.c_str(), "security.capability", nullptr, 0) <= 0) return;
  if (has_capabilities()) {
    outcome().why = "not asked for a grant: this process has capabilities, which would be lost";
    return;
  }
  char program[4096];
  const ssize_t length = readlink("/proc/self/exe", program, sizeof program - 1);
  auto environment = make_memory_file("xauto-environment");
  if (length <= 0 || !environment) return;
  program[length] = '\0';
  if (access(program, X_OK) != 0) return;  // replaced while it runs: it could not come back
  std::string text;
  for (char** variable = environ; *variable != nullptr; ++variable)
    (text += *variable).push_back('\0');
  if (!write_memory_file(environment->get(), text) || fcntl(environment->get(), F_SETFD, 0) != 0)
    return;
  int death_signal = 0;
  prctl(PR_GET_PDEATHSIG, &death_signal);
  std::vector<std::string> words = {helper,
                                    "--exec",
                                    std::to_string(environment->get()),
                                    std::to_string(death_signal),
                                    std::to_string(getppid()),
                                    program};
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  for (char** word = argv; *word != nullptr; ++word) arguments.push_back(*word);
  arguments.push_back(nullptr);
  execv(helper.c_str(), arguments.data());
  outcome().why = "cannot start " + helper + ": " + strerror(errno);
}

}  // namespace xauto::cli
