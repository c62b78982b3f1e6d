// SPDX-License-Identifier: Apache-2.0
// Whoever suspends may die at any moment: nothing stays suspended. A coordinator suspends and
// resumes an app's TSG and DLA queue as fast as it can and is killed, or closes its socket, or
// stops feeding its watchdog, or the module is unloaded under it, at random moments; after each,
// the hardware's state is read.
#include <csignal>
#include <random>

#include <kselftest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "emu/driver_queue.h"
#include "kernel/queue_control.h"
#include "kernel/queue_files.h"

#include "guest.h"

using xauto::emu::DriverQueue;
using xauto::kernel::QueueControl;
using xauto::kernel::QueueOp;
using xauto::kernel::QueueType;

namespace {

std::mt19937_64 random_source(20261121);

int below(int limit) {
  return static_cast<int>(random_source() % static_cast<std::uint64_t>(limit));
}

enum class Manner { kKill, kClose, kStarve, kOwnerDies };

/// The coordinator's life, in a child. It takes the queues' descriptors from its parent by fork;
/// what it registered is not bound to them.
[[noreturn]] void coordinate(const DriverQueue& tsg, const DriverQueue& dla, Manner manner) {
  auto control = QueueControl::open();
  if (!control) _exit(2);
  auto gpu_handle = control->register_queue(QueueType::kGpuTsg, tsg.descriptor());
  auto dla_handle = control->register_queue(QueueType::kDla, dla.descriptor());
  if (!gpu_handle || !dla_handle) _exit(3);
  if (manner == Manner::kStarve) {
    (void)control->set_watchdog(20);
    (void)control->suspend(gpu_handle->handle);
    (void)control->suspend(dla_handle->handle);
    for (;;) pause();
  }
  const QueueOp both[] = {{XAUTO_ACTION_SUSPEND, gpu_handle->handle},
                          {XAUTO_ACTION_SUSPEND, dla_handle->handle}};
  const QueueOp swap[] = {{XAUTO_ACTION_RESUME, gpu_handle->handle},
                          {XAUTO_ACTION_RESUME, dla_handle->handle}};
  const int rounds = manner == Manner::kClose ? static_cast<int>(getpid() % 3) + 1 : 1 << 30;
  for (int i = 0; i < rounds; ++i) {
    (void)control->control(both);
    if (manner == Manner::kClose && i + 1 == rounds) break;
    (void)control->control(swap);
  }
  _exit(0);  // with both suspended
}

int stuck = 0, lives = 0, refused = 0;

void one_life(const DriverQueue& tsg, const DriverQueue& dla, Manner manner) {
  const pid_t child = fork();
  if (child == 0) {
    if (manner == Manner::kOwnerDies) {
      // The one that registers dies while a child of its own holds the socket.
      auto control = QueueControl::open();
      if (!control) _exit(2);
      auto handle = control->register_queue(QueueType::kGpuTsg, tsg.descriptor());
      if (!handle) _exit(3);
      (void)control->set_watchdog(60000);
      (void)control->suspend(handle->handle);
      if (fork() == 0) {
        guest::sleep_ms(400);
        _exit(0);
      }
      _exit(0);
    }
    coordinate(tsg, dla, manner);
  }
  if (manner == Manner::kKill) {
    usleep(static_cast<useconds_t>(below(12000)));
    kill(child, SIGKILL);
  } else if (manner == Manner::kStarve) {
    guest::sleep_ms(60);
    // Still alive, and still suspended only if the watchdog did not bite.
    if (!guest::eventually([] { return guest::suspended() == 0; })) ++stuck;
    kill(child, SIGKILL);
  }
  int status = 0;
  waitpid(child, &status, 0);
  if (WIFEXITED(status) && WEXITSTATUS(status) != 0) ++refused;
  if (!guest::eventually([] { return guest::suspended() == 0; })) ++stuck;
  ++lives;
}

void many(const char* what, Manner manner, int times) {
  auto tsg = DriverQueue::open_gpu();
  auto dla = DriverQueue::open_dla(0);
  if (!tsg || !dla) ksft_exit_fail_msg("no emulators\n");
  stuck = lives = refused = 0;
  for (int i = 0; i < times; ++i) one_life(*tsg, *dla, manner);
  ksft_test_result(stuck == 0 && refused == 0 && lives == times,
                   "%s: %d times, %d left something suspended, %d failed to start\n", what, lives,
                   stuck, refused);
}

void unloading(int times) {
  auto tsg = DriverQueue::open_gpu();
  auto dla = DriverQueue::open_dla(0);
  if (!tsg || !dla) ksft_exit_fail_msg("no emulators\n");
  int bad = 0;
  for (int i = 0; i < times; ++i) {
    const pid_t child = fork();
    if (child == 0) coordinate(*tsg, *dla, Manner::kKill);
    usleep(static_cast<useconds_t>(below(30000)));
    bad += system("rmmod xauto") != 0;
    bad += guest::suspended() != 0;
    bad += system("insmod /modules/xauto.ko") != 0;
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
  }
  ksft_test_result(bad == 0, "unloading the module under a coordinator at work: %d times, %d bad\n",
                   times, bad);
}

void app_dies(int times) {
  int bad = 0;
  for (int i = 0; i < times; ++i) {
    const pid_t app = fork();
    if (app == 0) {
      auto tsg = DriverQueue::open_gpu();
      auto control = QueueControl::open();
      if (!tsg || !control) _exit(2);
      auto handle = control->register_queue(QueueType::kGpuTsg, tsg->descriptor());
      (void)tsg->submit(std::chrono::seconds(5));
      (void)control->suspend(handle->handle);
      for (;;) pause();
    }
    usleep(static_cast<useconds_t>(below(20000)));
    kill(app, SIGKILL);
    waitpid(app, nullptr, 0);
    bad += !guest::eventually([] { return guest::count(guest::gpu_state(), "tsg=") == 0; });
  }
  ksft_test_result(bad == 0, "an app killed with its own TSG suspended: %d times, %d TSGs left\n",
                   times, bad);
}

}  // namespace

int main() {
  const char* scale = getenv("XAUTO_KILLS");
  const int kills = scale != nullptr ? atoi(scale) : 200;
  const char* unloads = getenv("XAUTO_UNLOADS");
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(6);
  many("coordinator killed", Manner::kKill, kills);
  many("socket closed by exit", Manner::kClose, 30);
  many("watchdog starved", Manner::kStarve, 10);
  many("owner dead, socket inherited", Manner::kOwnerDies, 5);
  app_dies(30);
  unloading(unloads != nullptr ? atoi(unloads) : 6);
  ksft_finished();
}
