// SPDX-License-Identifier: Apache-2.0
// Everything at once, for XAUTO_TORTURE_S seconds (5): several apps with TSGs and DLA queues at
// work, several owners each that suspend, resume, register and unregister them, starve, close and
// are killed, while the drivers refuse now and then and a platform device changes its driver. Afterwards nothing is suspended, all work
// finishes, and (read by run-kmod when the module unloads) no object of the module is left.
#include <csignal>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "emu/driver_queue.h"
#include "kernel/queue_control.h"
#include "kernel/queue_files.h"

#include "raw.h"

using xauto::emu::DriverQueue;
using xauto::kernel::QueueControl;
using xauto::kernel::QueueOp;
using xauto::kernel::QueueType;

namespace {

/// One owner: registers what it finds in a process, and does what comes to its mind until it is
/// killed.
[[noreturn]] void own(pid_t app, std::uint64_t seed) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::mt19937_64 random(seed);
  const auto below = [&](int limit) {
    return static_cast<int>(random() % static_cast<std::uint64_t>(limit));
  };
  for (;;) {
    auto control = QueueControl::open();
    const auto files = xauto::kernel::find_queue_files(app);
    if (!control || !files || files->empty()) {
      usleep(2000);
      continue;
    }
    (void)control->set_watchdog(10 + static_cast<std::uint32_t>(below(100)));
    std::vector<std::uint32_t> handles;
    for (const auto& file : *files) {
      auto fd = xauto::kernel::take_descriptor(app, file.fd);
      if (!fd) continue;
      if (auto queue = control->register_queue(file.type, fd->get(), app))
        handles.push_back(queue->handle);
    }
    for (int i = below(60); i > 0 && !handles.empty(); --i) {
      const std::uint32_t handle =
          handles[static_cast<std::size_t>(below(static_cast<int>(handles.size())))];
      switch (below(12)) {
        case 0:
          (void)control->unregister(handle);
          break;
        case 1:
          usleep(static_cast<useconds_t>(below(3000)));
          break;
        case 2:
          (void)control->list();
          break;
        case 3:
          (void)control->query(handle);
          break;
        case 4:
          usleep(static_cast<useconds_t>(below(60000)));
          break;  // the watchdog may bite
        case 5: {
          const QueueOp op{XAUTO_ACTION_SET_TIMESLICE, handle,
                           1000 + static_cast<std::uint32_t>(below(4000))};
          (void)control->control({&op, 1});
          break;
        }
        default: {
          const QueueOp ops[] = {
              {below(2) ? XAUTO_ACTION_SUSPEND : XAUTO_ACTION_RESUME, handle},
              {below(2) ? XAUTO_ACTION_SUSPEND : XAUTO_ACTION_RESUME, handles[0]}};
          (void)control->control(ops);
        }
      }
    }
    if (below(4) == 0) _exit(0);  // with whatever it holds
  }
}

/// An app: keeps a TSG and a DLA queue busy with short work, and does now and then what makes the
/// drivers forget that they are suspended.
[[noreturn]] void app(int instance) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::mt19937_64 random(static_cast<std::uint64_t>(getpid()));
  auto tsg = DriverQueue::open_gpu();
  auto dla = DriverQueue::open_dla(instance % 2);
  if (!tsg || !dla) _exit(2);
  for (;;) {
    (void)tsg->submit(std::chrono::microseconds(300));
    (void)dla->submit(std::chrono::microseconds(300));
    (void)tsg->wait(50);
    (void)dla->wait(50);
    nvgpu_preemption_mode_args mode{};
    switch (random() % 16) {
      case 0: {
        const raw::UniqueFd another = raw::channel();  // closed again at once
        int fd = another.get();
        (void)raw::call(tsg->descriptor(), NVGPU_TSG_IOCTL_BIND_CHANNEL, &fd);
        break;
      }
      case 1:
        (void)raw::call(tsg->channel(), NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE, &mode);
        break;
      case 2:
        (void)raw::call(dla->descriptor(), NVDLA_IOCTL_RELEASE_QUEUE);
        (void)raw::call(dla->descriptor(), NVDLA_IOCTL_ALLOC_QUEUE);
        break;
      default:
        break;
    }
  }
}

/// A platform device without which a guest goes on, as DRIVER/DEVICE; empty: there is none.
std::string spare_device() {
  for (const char* name : {"alarmtimer", "rtc_cmos", "pcspkr", "reg-dummy", "efivars"}) {
    const std::string driver = std::string("/sys/bus/platform/drivers/") + name;
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(driver, error))
      if (entry.is_symlink() && std::filesystem::exists(entry.path() / "driver", error))
        return entry.path();
  }
  return {};
}

/// Devices lose and get their drivers, as on any machine: the module reads them while it looks for those
/// of a queue's file.
[[noreturn]] void rebind(const std::filesystem::path& device) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  for (;;) {
    guest::write(device.parent_path() / "unbind", device.filename());
    guest::write(device.parent_path() / "bind", device.filename());
  }
}

}  // namespace

int main() {
  const char* seconds_text = getenv("XAUTO_TORTURE_S");
  const int seconds = seconds_text != nullptr ? atoi(seconds_text) : 5;
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(3);
  std::mt19937_64 random(7);
  constexpr std::size_t kApps = 3, kOwners = 6;
  std::vector<pid_t> apps(kApps, 0), owners(kOwners, 0);
  long owner_lives = 0, app_lives = 0, faults = 0;
  const auto start_app = [&](std::size_t i) {
    ++app_lives;
    const pid_t pid = fork();
    if (pid == 0) app(static_cast<int>(i));
    apps[i] = pid;
  };
  const auto start_owner = [&](std::size_t i) {
    ++owner_lives;
    const std::uint64_t seed = random();
    const pid_t target = apps[random() % kApps];
    const pid_t pid = fork();
    if (pid == 0) own(target, seed);
    owners[i] = pid;
  };
  const std::string spare = spare_device();
  const pid_t binder = spare.empty() ? 0 : fork();
  if (!spare.empty() && binder == 0) rebind(spare);
  for (std::size_t i = 0; i < kApps; ++i) start_app(i);
  for (std::size_t i = 0; i < kOwners; ++i) start_owner(i);
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(seconds);
  while (std::chrono::steady_clock::now() < end) {
    usleep(static_cast<useconds_t>(random() % 8000));
    if (random() % 3 == 0) kill(owners[random() % kOwners], SIGKILL);
    if (random() % 40 == 0) kill(apps[random() % kApps], SIGKILL);
    if (random() % 20 == 0) {
      ++faults;
      guest::gpu_fault(random() % 2 ? "fail_preempt" : "fail_enable", 1);
      guest::dla_fault(random() % 2 ? "fail_suspend" : "fail_resume", 1);
    }
    for (std::size_t i = 0; i < kApps; ++i)
      if (waitpid(apps[i], nullptr, WNOHANG) == apps[i]) start_app(i);
    for (std::size_t i = 0; i < kOwners; ++i)
      if (waitpid(owners[i], nullptr, WNOHANG) == owners[i]) start_owner(i);
  }
  for (const pid_t pid : owners) {
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
  }
  for (const char* fault : {"fail_preempt", "fail_enable"}) guest::gpu_fault(fault, 0);
  for (const char* fault : {"fail_suspend", "fail_resume"}) guest::dla_fault(fault, 0);
  if (binder > 0) {
    kill(binder, SIGKILL);
    waitpid(binder, nullptr, 0);
    guest::write(std::filesystem::path(spare).parent_path() / "bind",
                 std::filesystem::path(spare).filename());
  }
  ksft_print_msg("%d s: %ld owners, %ld apps, %ld faults, bound again and again: %s\n", seconds,
                 owner_lives, app_lives, faults, spare.empty() ? "nothing" : spare.c_str());
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "nothing is suspended once the owners are gone\n");
  for (const pid_t pid : apps) {
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
  }
  ksft_test_result(guest::eventually([] {
                     auto control = QueueControl::open();
                     auto list = control ? control->list() : decltype(control->list())();
                     return list && list->empty() && guest::count(guest::gpu_state(), "tsg=") == 0;
                   }),
                   "nothing is registered once the apps are gone\n");
  ksft_test_result(owner_lives > static_cast<long>(kOwners) && faults > 0,
                   "owners died and drivers refused on the way\n");
  ksft_finished();
}
