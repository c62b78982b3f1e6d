// SPDX-License-Identifier: Apache-2.0
// Runs a command, and all that it starts, on drivers of user space: on_devices nvgpu|rm|kfd|i915 STATE
// COMMAND... STATE is a file that says what they know, in a line of JSON, written anew many times a second.
// Ends as the command did.
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>

#include <sys/wait.h>
#include <unistd.h>

#include "i915.h"
#include "kernel.h"
#include "kfd.h"
#include "nvgpu.h"
#include "rm.h"

namespace {

struct Devices {
  devices::NvgpuState nvgpu;
  devices::RmState rm;
  devices::KfdState kfd;
  devices::I915State i915;

  [[nodiscard]] std::string json() const {
    int suspensions = rm.disables + kfd.taken_off + i915.preemptions;
    for (const auto& [id, tsg] : nvgpu.tsgs) suspensions += tsg.disables;
    const int queues =
        static_cast<int>(nvgpu.tsgs.size() + kfd.queues.size() + i915.contexts.size()) +
        rm.channels(false) + rm.channels(true);
    const int suspended = nvgpu.disabled() + rm.channels(true) +
                          static_cast<int>(kfd.queues.size()) - kfd.active() + i915.preempted();
    return "{\"queues\": " + std::to_string(queues) +
           ", \"suspended\": " + std::to_string(suspended) +
           ", \"suspensions\": " + std::to_string(suspensions) + "}\n";
  }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "on_devices nvgpu|rm|kfd|i915 STATE COMMAND...\n");
    return 2;
  }
  if (const std::string why = devices::Kernel::missing(); !why.empty()) {
    std::fprintf(stderr, "on_devices: %s\n", why.c_str());
    return 77;
  }
  Devices all;
  const std::string which = argv[1], state = argv[2];
  std::shared_ptr<devices::Driver> driver = std::make_shared<devices::Nvgpu>(all.nvgpu);
  if (which == "rm") driver = std::make_shared<devices::Rm>(all.rm);
  if (which == "kfd") driver = std::make_shared<devices::Kfd>(all.kfd);
  if (which == "i915") driver = std::make_shared<devices::I915>(all.i915);
  devices::Kernel kernel({driver});
  const pid_t child = kernel.fork([&] {
    execvp(argv[3], argv + 3);
    std::fprintf(stderr, "on_devices: cannot start %s: %s\n", argv[3], std::strerror(errno));
    _exit(127);
  });
  if (child < 0) return 1;
  for (;;) {
    int status = 0;
    const bool ended = waitpid(child, &status, WNOHANG) == child;
    kernel.settle();
    {
      const std::lock_guard lock(kernel.mutex());
      std::ofstream(state + ".new") << all.json();
    }
    std::rename((state + ".new").c_str(), state.c_str());
    if (ended) return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    usleep(5'000);
  }
}
