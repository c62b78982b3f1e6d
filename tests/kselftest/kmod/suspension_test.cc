// SPDX-License-Identifier: Apache-2.0
// A suspension holds although the drivers do not keep it: nvgpu enables a TSG whenever something else
// needed it off, nvdla forgets with the queue or the power, and a context may not leave its engine.
// What must happen is told by order, not by time: something is so again while something else that
// takes long still goes on.
#include <algorithm>
#include <csignal>
#include <functional>
#include <thread>
#include <vector>

#include <linux/genetlink.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>

#include "emu/driver_queue.h"
#include "kernel/queue_control.h"

#include "queue_events.h"
#include "raw.h"

using namespace std::chrono_literals;
using guest::eventually, guest::has, guest::QueueEvents, guest::text_of;
using raw::UniqueFd;
using xauto::ErrorCode;
using xauto::kernel::QueueControl;
using xauto::kernel::QueueInfo;
using xauto::kernel::QueueOp;
using xauto::kernel::QueueType;

namespace {

QueueControl control() {
  auto control = QueueControl::open();
  if (!control) ksft_exit_fail_msg("no xauto.ko: %s\n", control.error().to_string().c_str());
  (void)control->set_watchdog(60000);
  return std::move(*control);
}
std::uint32_t registered(QueueControl& control, QueueType type, const UniqueFd& fd) {
  auto handle = control.register_queue(type, fd.get());
  if (!handle) ksft_exit_fail_msg("not registered: %s\n", handle.error().to_string().c_str());
  (void)control.set_watchdog(60000);
  return handle->handle;
}
QueueInfo info(QueueControl& control, std::uint32_t handle) {
  const auto info = control.query(handle);
  return info ? *info : QueueInfo{};
}
void reload(const char* parameters) {
  const std::string load = std::string("rmmod xauto && insmod /modules/xauto.ko ") + parameters;
  if (system(load.c_str()) != 0)
    ksft_exit_fail_msg("xauto.ko does not load with '%s'\n", parameters);
}

/// All events of a kind that come within the time; the others are dropped.
std::vector<guest::QueueEvent> events_of(QueueEvents& events, xauto_kevent kind,
                                         int quiet_ms = 200) {
  std::vector<guest::QueueEvent> found;
  for (;;) {
    const auto event = events.next(quiet_ms);
    if (!event || !*event) return found;
    if ((*event)->kind == kind) found.push_back(**event);
  }
}

/// A TSG that always has work, suspended by the module.
struct Held {
  QueueControl owner = control();
  UniqueFd tsg = raw::tsg(), channel = raw::channel();
  std::uint32_t handle = 0;
  Held() {
    if (raw::bind(tsg, channel) != 0 || raw::work(channel, 60000) != 0)
      ksft_exit_fail_msg("no work\n");
    handle = registered(owner, QueueType::kGpuTsg, tsg);
    const auto done = owner.suspend(handle);
    if (!done) ksft_exit_fail_msg("not suspended: %s\n", done.error().what.c_str());
  }
  [[nodiscard]] bool off() const {
    return has(guest::gpu_state(), "enabled=0 current=0") && !has(guest::gpu_state(), "current=1");
  }
};

void escapes() {
  auto events = QueueEvents::subscribe();
  if (!events) ksft_exit_fail_msg("no events\n");
  // The sign of an escape is that the context has to be waited for; this guest may stall as long as
  // a context usually takes.
  raw::gpu_parameter("save_us", "20000");
  Held held;
  UniqueFd other = raw::channel();
  nvgpu_preemption_mode_args mode{};
  const struct {
    const char* what;
    std::function<int()> act;
    bool again = false;  ///< it can be done twice
  } ways[] = {
      {"a new channel", [&] { return raw::bind(held.tsg, other); }},
      {"a channel that is closed", [&] { return other.reset(), 0; }},
      {"another preemption mode",
       [&] {
         return raw::call(held.channel.get(), NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE, &mode);
       },
       true},
      {"ENABLE", [&] { return raw::call(held.tsg.get(), NVGPU_IOCTL_TSG_ENABLE); }, true},
  };
  std::uint64_t known = info(held.owner, held.handle).escapes;
  for (const auto& way : ways) {
    const auto counted = [&] {
      return held.off() && info(held.owner, held.handle).escapes > known;
    };
    bool good = way.act() == 0 && eventually(counted, way.again ? 500 : 5000);
    // A sweep that comes at once finds nothing that had run: that is no escape.
    for (int i = 0; i < 40 && !good && way.again; ++i)
      good = way.act() == 0 && eventually(counted, 500);
    ksft_test_result(good, "a TSG that %s enabled is suspended again, and counted\n", way.what);
    known = info(held.owner, held.handle).escapes;
  }
  const auto told = events_of(*events, XAUTO_KEV_ESCAPED);
  ksft_test_result(told.size() == known && known >= 4 && told.back().escapes == known &&
                       told.back().time_ns > told.front().time_ns && told.back().pid == getpid(),
                   "each escape is told, with its time and the count (%zu of %llu)\n", told.size(),
                   static_cast<unsigned long long>(known));
  guest::sleep_ms(300);
  ksft_test_result(info(held.owner, held.handle).escapes == known,
                   "a suspension that holds is no escape\n");

  const UniqueFd idle = raw::tsg(), nothing = raw::channel();
  (void)raw::bind(idle, nothing);
  const auto handle = registered(held.owner, QueueType::kGpuTsg, idle);
  (void)held.owner.suspend(handle);
  (void)raw::call(idle.get(), NVGPU_IOCTL_TSG_ENABLE);
  ksft_test_result(eventually([] { return guest::count(guest::gpu_state(), "enabled=0") == 2; }) &&
                       info(held.owner, handle).escapes == 0,
                   "one that had no work is suspended again, and did not escape\n");

  // A TSG may have a second file, which another owner has registered: no driver's word tells that.
  nvgpu_tsg_get_share_token_args token{1, 1, 0};
  (void)raw::call(held.tsg.get(), NVGPU_TSG_IOCTL_GET_SHARE_TOKEN, &token);
  nvgpu_gpu_open_tsg_args shared{0, NVGPU_GPU_IOCTL_OPEN_TSG_FLAGS_SHARE, 1, token.share_token};
  if (raw::call(raw::ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG, &shared) != 0)
    ksft_exit_fail_msg("not shared\n");
  const UniqueFd second(static_cast<int>(shared.tsg_fd));
  QueueControl another = control();
  const auto same = registered(another, QueueType::kGpuTsg, second);
  known = info(held.owner, held.handle).escapes;
  ksft_test_result(
      another.suspend(same) && another.resume(same) &&
          eventually([&] { return held.off() && info(held.owner, held.handle).escapes > known; }),
      "another owner's resume through a second file of the TSG is an escape as well\n");
  raw::gpu_parameter("save_us", "100");
}

void repeated() {
  reload("sweep_ms=1000");
  {
    Held held;
    int good = 0;
    for (int i = 0; i < 5; ++i) {
      (void)raw::call(held.tsg.get(), NVGPU_IOCTL_TSG_ENABLE);
      (void)eventually([] { return has(guest::gpu_state(), "current=1"); });
      good += held.owner.suspend(held.handle).has_value() && held.off();
    }
    ksft_test_result(good == 5,
                     "a repeated vote suspends a TSG again that the driver enabled (%d of 5)\n",
                     good);
    ksft_test_result(held.owner.resume(held.handle).has_value() && guest::suspended() == 0,
                     "and one resume is enough\n");
  }
  reload("");
}

void dla_released() {
  raw::dla_parameter("flush_resumes", "1");
  auto events = QueueEvents::subscribe();
  QueueControl owner = control();
  const UniqueFd dla = raw::dla();
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  const auto handle = registered(owner, QueueType::kDla, dla);
  (void)owner.suspend(handle);
  (void)raw::call(dla.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  guest::sleep_ms(2000);
  ksft_test_result(
      info(owner, handle).errors == 0 && info(owner, handle).escapes == 1,
      "a DLA queue that its process released is no driver error (%llu), and told once\n",
      static_cast<unsigned long long>(info(owner, handle).errors));
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  (void)raw::task(dla, 10);
  ksft_test_result(eventually([&] {
                     return has(guest::dla_state(), "suspended=1") &&
                            info(owner, handle).escapes == 2;
                   }),
                   "one that is allocated again is suspended again\n");
  const auto told = events_of(*events, XAUTO_KEV_ESCAPED);
  ksft_test_result(told.size() == 2 && told[0].error == ENODATA && told[1].error == 0,
                   "both are told, in words of their own\n");
  (void)raw::call(dla.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  ksft_test_result(eventually([] { return has(guest::dla_state(), "suspended=1"); }),
                   "also where that was too quick to be seen\n");
  const std::uint64_t before = info(owner, handle).errors;
  guest::dla_fault("fail_suspend", 1000);
  guest::sleep_ms(2000);
  guest::dla_fault("fail_suspend", 0);
  const std::uint64_t errors = info(owner, handle).errors - before;
  ksft_test_result(errors >= 1 && errors <= 10,
                   "a firmware that refuses is asked ever more rarely (%llu times in 2 s)\n",
                   static_cast<unsigned long long>(errors));
  (void)raw::call(dla.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  ksft_test_result(has(text_of(owner.suspend(handle)), "released"),
                   "suspending a released one says so\n");
  ksft_test_result(owner.resume(handle).has_value() && !info(owner, handle).suspended,
                   "and its resume has nothing to do\n");
  raw::dla_parameter("flush_resumes", "0");
}

void dla_slots() {
  (void)eventually([] { return !has(guest::dla_state(), "queue="); });
  QueueControl owner = control();
  const UniqueFd bare = raw::dla();
  ksft_test_result(has(text_of(owner.register_queue(QueueType::kDla, bare.get())), "has no queue"),
                   "a ctrl node without a queue is none, whatever its firmware version\n");
  UniqueFd first = raw::dla(), keeper = raw::dla();
  (void)raw::call(keeper.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  (void)raw::call(first.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  (void)raw::task(keeper, 60000);  // so that the firmware forgets nothing
  const auto handle = registered(owner, QueueType::kDla, first);
  (void)owner.suspend(handle);
  const int slot = raw::slot(first);
  (void)raw::call(first.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  const UniqueFd second = raw::dla();
  (void)raw::call(second.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  if (raw::slot(second) != slot) ksft_exit_fail_msg("the slot is not used again\n");
  ksft_test_result(has(guest::dla_state(), "suspended=1"),
                   "a slot that was released while suspended comes suspended to the next one\n");
  QueueControl another = control();
  (void)registered(another, QueueType::kDla, second);
  ksft_test_result(!has(guest::dla_state(), "suspended=1"), "which runs once it is registered\n");
  int good = 0;
  for (int i = 0; i < 20; ++i) good += !owner.suspend(handle).has_value();
  ksft_test_result(good == 20 && !has(guest::dla_state(), "suspended=1"),
                   "a late suspend of the first one does not hit the second\n");
}

void system_sleeps() {
  const char* const names[] = {"the system sleeps with a TSG and a DLA queue suspended",
                               "both are suspended again, and told"};
  if (const std::string why = guest::cannot_sleep(); !why.empty()) {
    for (const char* name : names) ksft_test_result_skip("%s: %s\n", name, why.c_str());
    return;
  }
  auto events = QueueEvents::subscribe();
  Held held;
  const UniqueFd dla = raw::dla();
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  const auto handle = registered(held.owner, QueueType::kDla, dla);
  (void)held.owner.suspend(handle);
  (void)events_of(*events, XAUTO_KEV_SUSPEND);
  ksft_test_result(guest::system_sleep(), "%s\n", names[0]);
  const bool off = eventually([&] {
    return held.off() && has(guest::dla_state(), "suspended=1") &&
           info(held.owner, handle).escapes == 1 && info(held.owner, held.handle).escapes >= 1;
  });
  const auto told = events_of(*events, XAUTO_KEV_ESCAPED);
  ksft_test_result(off && told.size() >= 2, "%s (%llu and %llu, %zu events)\n", names[1],
                   static_cast<unsigned long long>(info(held.owner, held.handle).escapes),
                   static_cast<unsigned long long>(info(held.owner, handle).escapes), told.size());
}

void stuck() {
  auto events = QueueEvents::subscribe();
  QueueControl owner = control();
  const UniqueFd tsg = raw::tsg(), channel = raw::channel();
  (void)raw::bind(tsg, channel);
  const auto handle = registered(owner, QueueType::kGpuTsg, tsg);
  raw::gpu_parameter("yield_us", "300000");
  (void)raw::work(channel, 60000);
  (void)eventually([] { return has(guest::gpu_state(), "current=1"); });
  const auto first = owner.suspend(handle);
  ksft_test_result(
      !first && first.error().code == ErrorCode::kTimeout && has(first.error().what, "runs again"),
      "a context that does not leave within 100 ms is a time-out\n");
  const QueueInfo after = info(owner, handle);
  const auto second = owner.suspend(handle);
  ksft_test_result(!second && second.error().code == ErrorCode::kUnavailable &&
                       has(second.error().what, "not tried") && after.stuck_ms >= 500 &&
                       !after.gated && info(owner, handle).errors == after.errors,
                   "asked again at once, the driver is left alone (%u ms)\n", after.stuck_ms);
  int tries = 0;
  (void)eventually(
      [&] {
        (void)eventually([] { return has(guest::gpu_state(), "current=1"); });
        ++tries;
        (void)owner.suspend(handle);
        return info(owner, handle).gated;
      },
      30000);
  const QueueInfo at_end = info(owner, handle);
  ksft_test_result(at_end.gated && at_end.stuck_ms >= 1500 && at_end.errors <= 4,
                   "it is tried ever more rarely, and then given up (%llu of %d)\n",
                   static_cast<unsigned long long>(at_end.errors), tries);
  const auto told = events_of(*events, XAUTO_KEV_GATED);
  ksft_test_result(told.size() == 1 && told[0].pid == getpid(), "which is told, once\n");
  guest::sleep_ms(3500);
  ksft_test_result(!owner.suspend(handle) && info(owner, handle).errors == at_end.errors &&
                       has(guest::gpu_state(), "killed=0") && !has(guest::gpu_state(), "killed=1"),
                   "for ever, and the driver does not kill it\n");
  (void)owner.unregister(handle);
  QueueControl another = control();
  const auto anew = registered(another, QueueType::kGpuTsg, tsg);
  const auto again = another.suspend(anew);
  ksft_test_result(
      info(another, anew).gated && !again && again.error().code == ErrorCode::kUnavailable,
      "also where another owner registers it\n");
  raw::gpu_parameter("yield_us", "0");
}

/// Runs `body` in a child. What it owns ends with it, so one that shall go on owning pauses.
pid_t child(const std::function<void()>& body) {
  const pid_t pid = fork();
  if (pid == 0) {
    body();
    _exit(0);
  }
  return pid;
}
bool lives(pid_t pid) {
  return waitpid(pid, nullptr, WNOHANG) == 0;
}
void reap(pid_t pid) {
  kill(pid, SIGKILL);
  waitpid(pid, nullptr, 0);
}

void devices() {
  const UniqueFd tsg = raw::tsg(), channel = raw::channel(), dla = raw::dla();
  (void)raw::bind(tsg, channel);
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  // The owner is killed while it is in a DLA command of its own.
  raw::dla_parameter("command_us", "1");
  const pid_t owner = child([&] {
    QueueControl c = control();
    const auto g = registered(c, QueueType::kGpuTsg, tsg), d = registered(c, QueueType::kDla, dla);
    (void)c.suspend(g);
    raw::dla_parameter("command_us", "1000000");
    (void)c.suspend(d);  // its life tells how long the command takes
  });
  if (!eventually([] { return guest::count(guest::gpu_state(), "enabled=0") == 1; }))
    ksft_exit_fail_msg("not suspended\n");
  guest::sleep_ms(100);
  QueueControl observer = control();
  auto begin = std::chrono::steady_clock::now();
  const auto ms = [&] {
    return static_cast<long>((std::chrono::steady_clock::now() - begin) / 1ms);
  };
  const auto list = observer.list();
  ksft_test_result(
      list && list->size() == 2 && !has(guest::dla_state(), "suspended=1") && lives(owner),
      "a list does not wait for a DLA command (%ld ms)\n", ms());
  begin = std::chrono::steady_clock::now();
  kill(owner, SIGKILL);
  const bool resumed =
      eventually([] { return guest::count(guest::gpu_state(), "enabled=0") == 0; });
  const long took = ms();
  ksft_test_result(resumed && lives(owner),
                   "a dead owner's TSG runs again while its DLA command goes on (%ld ms)\n", took);
  reap(owner);
  raw::dla_parameter("command_us", "50");
  ksft_test_result(eventually([] { return guest::suspended() == 0; }), "and then the DLA queue\n");

  // The owner is killed while somebody else is in a command of that DLA.
  const UniqueFd others = raw::dla();
  (void)raw::call(others.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  const pid_t second = child([&] {
    QueueControl c = control();
    const auto d = registered(c, QueueType::kDla, dla), g = registered(c, QueueType::kGpuTsg, tsg);
    (void)c.suspend(d);
    (void)c.suspend(g);
    pause();
  });
  if (!eventually([] { return guest::suspended() == 2; })) ksft_exit_fail_msg("not suspended\n");
  raw::dla_parameter("command_us", "1000000");
  const pid_t busy = child([&] { (void)raw::set_status(others, NVDLA_SET_QUEUE_RESUME); });
  guest::sleep_ms(100);
  begin = std::chrono::steady_clock::now();
  reap(second);
  const bool again = eventually([] { return guest::count(guest::gpu_state(), "enabled=0") == 0; });
  const long waited = ms();
  ksft_test_result(again && has(guest::dla_state(), "suspended=1"),
                   "a dead owner's TSG does not wait for its DLA queue (%ld ms)\n", waited);
  raw::dla_parameter("command_us", "50");
  reap(busy);
  ksft_test_result(eventually([] { return guest::suspended() == 0; }), "whose turn comes, too\n");

  // One that waits for another's driver call can be killed.
  raw::dla_parameter("command_us", "1000000");
  const pid_t first = child([&] {
    QueueControl c = control();
    (void)c.suspend(registered(c, QueueType::kDla, dla));
  });
  guest::sleep_ms(300);  // it registers, which resumes, and suspends: two commands
  const pid_t behind = child([&] {
    QueueControl c = control();
    (void)c.suspend(registered(c, QueueType::kDla, dla));
  });
  guest::sleep_ms(300);
  kill(behind, SIGKILL);
  const bool died = eventually([&] { return !lives(behind); }, 10000);
  ksft_test_result(died && lives(first), "who waits behind a driver call can be killed\n");
  raw::dla_parameter("command_us", "50");
  waitpid(first, nullptr, 0);
  ksft_test_result(eventually([] { return guest::suspended() == 0; }),
                   "and leaves nothing suspended\n");
}

void release_35() {
  if (system("rmmod xauto xauto_nvgpu_emu xauto_nvdla_emu && insmod /modules/xauto_nvgpu_emu.ko "
             "release=r35 && insmod /modules/xauto_nvdla_emu.ko release=r35 && "
             "insmod /modules/xauto.ko") != 0)
    ksft_exit_fail_msg("the emulators do not load as r35\n");
  {
    Held held;
    const UniqueFd other = raw::channel();
    (void)raw::bind(held.tsg, other);
    (void)raw::work(other, 60000);
    ksft_test_result(eventually([] { return has(guest::gpu_state(), "channels=2 on=0"); }),
                     "r35: a new channel of a suspended TSG is suspended, too\n");
    const UniqueFd dla = raw::dla();
    (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
    const auto handle = held.owner.register_queue(QueueType::kDla, dla.get());
    ksft_test_result(handle && held.owner.suspend(handle->handle),
                     "r35: a queue of the driver that is built in is suspended: %s\n",
                     text_of(handle).c_str());
    guest::sleep_ms(400);
    ksft_test_result(has(guest::dla_state(), "powered=1") && has(guest::dla_state(), "suspended=1"),
                     "r35: its DLA keeps its power\n");
    (void)held.owner.resume(handle ? handle->handle : 1);
    ksft_test_result(eventually([] { return !has(guest::dla_state(), "powered=1"); }),
                     "r35: and gives it back\n");
  }
  if (system("rmmod xauto xauto_nvgpu_emu xauto_nvdla_emu && insmod /modules/xauto_nvgpu_emu.ko && "
             "insmod /modules/xauto_nvdla_emu.ko && "
             "insmod /modules/xauto.ko gpu_drivers=kernel,xauto_nvgpu_emu") != 0)
    ksft_exit_fail_msg("the emulators do not load as r36\n");
  QueueControl c = control();
  const UniqueFd files[] = {raw::node("/dev/null"), UniqueFd(eventfd(0, 0)),
                            UniqueFd(memfd_create("nvgpu-ga10b-tsg1", 0)),
                            UniqueFd(open("/tmp/nvgpu-ga10b-tsg1", O_RDWR | O_CREAT, 0600)),
                            UniqueFd(open("/tmp/nvhost-ctrl-nvdla0", O_RDWR | O_CREAT, 0600))};
  int refused = 0;
  for (const auto& file : files)
    for (const QueueType type : {QueueType::kGpuTsg, QueueType::kDla})
      refused += has(text_of(c.register_queue(type, file.get())), "the file is not of") ||
                 has(text_of(c.register_queue(type, file.get())), "not a TSG");
  ksft_test_result(refused == 10,
                   "built-in files with other names, or kinds, are none (%d of 10)\n", refused);
  reload("");
}

/// The user ids of a user namespace are not its user's. Returns how many owners three of them have.
int owners_in_a_namespace(uid_t user) {
  int ready[2], mapped[2], made[2];
  if (pipe(ready) != 0 || pipe(mapped) != 0 || pipe(made) != 0) ksft_exit_fail_msg("pipe\n");
  const pid_t container = child([&] {
    if (setgid(user) != 0 || setuid(user) != 0 || unshare(CLONE_NEWUSER) != 0) _exit(9);
    char byte = 0;
    (void)!write(ready[1], &byte, 1);
    (void)!read(mapped[0], &byte, 1);
    for (uid_t inside = 1; inside <= 3; ++inside)
      child([&] {
        if (setuid(inside) != 0 || prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) _exit(9);
        const UniqueFd tsg = raw::node("/dev/nvgpu/igpu0/tsg");
        std::vector<QueueControl> owners;
        for (;;) {
          auto c = QueueControl::open();
          if (!c || !c->register_queue(QueueType::kGpuTsg, tsg.get())) break;
          (void)c->set_watchdog(60000);
          owners.push_back(std::move(*c));
        }
        const auto count = static_cast<int>(owners.size());
        (void)!write(made[1], &count, sizeof count);
        pause();
      });
    pause();
  });
  char byte = 0;
  (void)!read(ready[0], &byte, 1);
  for (const char* map : {"uid_map", "gid_map"})
    guest::write("/proc/" + std::to_string(container) + "/" + map, "0 100000 65536");
  (void)!write(mapped[1], &byte, 1);
  int total = 0, most = 0;
  for (int i = 0; i < 3; ++i) {
    int count = 0;
    (void)!read(made[0], &count, sizeof count);
    total += count;
    most = std::max(most, count);
  }
  if (most == 0) ksft_print_msg("nobody in the namespace has an owner\n");
  reap(container);
  for (const int fd : {ready[0], ready[1], mapped[0], mapped[1], made[0], made[1]}) close(fd);
  return total;
}

void fair_shares() {
  constexpr int kEach = 128, kAll = 1024, kReserve = 64;
  int ready[2], hold[2];
  if (pipe(ready) != 0 || pipe(hold) != 0) ksft_exit_fail_msg("pipe\n");
  std::vector<pid_t> users;
  int total = 0, most = 0;
  std::string why;
  for (uid_t user = 1000; user < 1008; ++user) {
    users.push_back(child([&] {
      if (setgid(user) != 0 || setuid(user) != 0) _exit(9);
      const UniqueFd tsg = raw::node("/dev/nvgpu/igpu0/tsg");
      std::vector<QueueControl> owners;
      int made = 0;
      std::string text;
      for (; made < kAll; ++made) {
        auto c = QueueControl::open();
        if (!c) break;
        text = text_of(c->register_queue(QueueType::kGpuTsg, tsg.get()));
        if (!text.empty()) break;
        (void)c->set_watchdog(60000);
        owners.push_back(std::move(*c));
      }
      const bool told = has(text, "too many owners");
      if (!told) made = -1;
      (void)!write(ready[1], &made, sizeof made);
      pause();
    }));
    int made = 0;
    (void)!read(ready[0], &made, sizeof made);
    total += made;
    most = std::max(most, made);
  }
  ksft_test_result(most == kEach, "one user has at most %d owners (%d)\n", kEach, most);
  ksft_test_result(total == kAll - kReserve, "all users together leave %d of %d (%d)\n", kReserve,
                   kAll, total);
  QueueControl root = control();
  const UniqueFd tsg = raw::tsg();
  ksft_test_result(root.register_queue(QueueType::kGpuTsg, tsg.get()).has_value(),
                   "which are for who has CAP_SYS_NICE\n");
  for (const pid_t user : users) reap(user);
  ksft_test_result(eventually([&] { return root.list().value().size() == 1; }), "they leave\n");
  const int inside = owners_in_a_namespace(1010);
  ksft_test_result(inside == kEach,
                   "all ids of a user namespace together have one user's share (%d)\n", inside);
  for (const int fd : {ready[0], ready[1], hold[0], hold[1]}) close(fd);
}

/// What a netlink client says without this project's classes, and what it is answered.
struct Said {
  nlmsghdr header{};
  genlmsghdr generic{};
  nlattr attribute{};
};
struct SaidSuspend : Said {
  nlattr op{NLA_HDRLEN + 16, 1 | NLA_F_NESTED}, action_is{8, XAUTO_OP_ACTION};
  std::uint32_t action = XAUTO_ACTION_SUSPEND;
  nlattr handle_is{8, XAUTO_OP_HANDLE};
  std::uint32_t handle = 0;
};
struct SaidWatchdog : Said {
  std::uint32_t timeout_ms = 60000;
};
template <class T>
void say(QueueControl& c, T& message, std::uint8_t command, std::uint16_t attribute,
         std::uint32_t number) {
  message.header = {sizeof message, static_cast<std::uint16_t>(c.family()),
                    NLM_F_REQUEST | NLM_F_ACK, number, 0};
  message.generic = {command, XAUTO_FAMILY_VERSION, 0};
  message.attribute = {sizeof message - NLMSG_HDRLEN - GENL_HDRLEN, attribute};
  if (send(c.descriptor(), &message, sizeof message, 0) < 0)
    ksft_exit_fail_msg("nothing is said\n");
}
/// 0 or an errno.
int answer(QueueControl& c, std::uint32_t number) {
  for (;;) {
    alignas(nlmsghdr) char buffer[4096];
    if (recv(c.descriptor(), buffer, sizeof buffer, 0) < 0) ksft_exit_fail_msg("no answer\n");
    const auto* header = reinterpret_cast<const nlmsghdr*>(buffer);
    if (header->nlmsg_seq == number)
      return -static_cast<const nlmsgerr*>(NLMSG_DATA(header))->error;
  }
}

/// The watchdog bites while a suspend is in the driver: the end of the older vote waits behind it.
void younger_than_the_bite() {
  const UniqueFd dla = raw::dla();
  (void)raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  QueueControl sleepy = control(), other = control();
  const auto handle = registered(sleepy, QueueType::kDla, dla);
  const auto second = registered(other, QueueType::kDla, dla);
  (void)sleepy.suspend(handle);
  auto events = QueueEvents::subscribe();
  raw::dla_parameter("command_us", "1000000");
  (void)sleepy.set_watchdog(100);
  std::thread wakes([&] {
    SaidSuspend suspend;
    suspend.handle = handle;
    say(sleepy, suspend, XAUTO_CMD_CONTROL, XAUTO_A_OPS | NLA_F_NESTED, 1);
  });
  const bool bit = eventually([&] { return !events_of(*events, XAUTO_KEV_WATCHDOG, 1).empty(); });
  SaidWatchdog longer;  // else it bites once more, rightly, where this machine stalls
  say(sleepy, longer, XAUTO_CMD_WATCHDOG, XAUTO_A_TIMEOUT_MS, 2);
  wakes.join();
  raw::dla_parameter("command_us", "50");
  const int error = answer(sleepy, 1);
  (void)other.suspend(second);  // behind what waited for the queue
  const auto votes = info(other, second).votes;
  ksft_test_result(bit && ((error == 0 && votes == 2) || (error == ETIMEDOUT && votes == 1)),
                   "a suspend after the bite holds if it is answered so (errno %d, %u votes)\n",
                   error, votes);
}

void undone() {
  const UniqueFd tsg = raw::tsg(), channel = raw::channel();
  (void)raw::bind(tsg, channel);
  QueueControl stays = control();
  const auto mine = registered(stays, QueueType::kGpuTsg, tsg);
  const auto set = [](QueueControl& c, std::uint32_t handle, std::uint32_t us) {
    const QueueOp ops[] = {{XAUTO_ACTION_SET_TIMESLICE, handle, us},
                           {XAUTO_ACTION_SET_INTERLEAVE, handle, 2}};
    return c.control(ops).has_value();
  };
  const pid_t owner = child([&] {
    QueueControl c = control();
    (void)set(c, registered(c, QueueType::kGpuTsg, tsg), 5000);
    pause();
  });
  const bool were = eventually([] { return has(guest::gpu_state(), "level=2 timeslice_us=5000"); });
  reap(owner);
  ksft_test_result(
      were && eventually([] { return has(guest::gpu_state(), "level=0 timeslice_us=1024"); }),
      "time slice and interleave level do not outlive their owner\n");
  const bool again = set(stays, mine, 3000);
  ksft_test_result(again && stays.unregister(mine).has_value() &&
                       has(guest::gpu_state(), "level=0 timeslice_us=1024"),
                   "nor a registration\n");
}

/// nvgpu keeps a TSG while a channel is bound to it; nobody but the module could still resume it.
void outlives_its_file() {
  auto events = QueueEvents::subscribe();
  for (const bool refused : {false, true}) {
    QueueControl c = control();
    UniqueFd tsg = raw::tsg();
    const UniqueFd channel = raw::channel();
    (void)raw::bind(tsg, channel);
    const auto handle = registered(c, QueueType::kGpuTsg, tsg);
    (void)raw::work(channel, 10);
    (void)c.suspend(handle);
    if (refused) guest::gpu_fault("fail_enable", 4);
    tsg.reset();
    ksft_test_result(
        eventually([] { return guest::suspended() == 0; }) && raw::idle(channel, 10000),
        "a TSG whose last file is closed is resumed%s\n",
        refused ? ", also by a driver that refuses at first" : ": its channels live on");
    guest::gpu_fault("fail_enable", 0);
    ksft_test_result(!events_of(*events, XAUTO_KEV_TARGET_GONE).empty(), "and told as gone\n");
  }
}

void unload_is_told() {
  auto events = QueueEvents::subscribe();
  const UniqueFd tsg = raw::tsg(), channel = raw::channel();
  (void)raw::bind(tsg, channel);
  QueueControl c = control();
  (void)c.suspend(registered(c, QueueType::kGpuTsg, tsg));
  (void)events_of(*events, XAUTO_KEV_REGISTER);
  if (system("rmmod xauto") != 0) ksft_exit_fail_msg("rmmod\n");
  const auto told = events_of(*events, XAUTO_KEV_RESUME);
  ksft_test_result(told.size() == 1 && told[0].error == 0,
                   "what unloading the module resumes is told (%zu)\n", told.size());
  if (system("insmod /modules/xauto.ko") != 0) ksft_exit_fail_msg("insmod\n");
}

}  // namespace

int main() {
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(55);
  escapes();
  repeated();
  dla_released();
  system_sleeps();
  dla_slots();
  stuck();
  devices();
  release_35();
  fair_shares();
  younger_than_the_bite();
  undone();
  outlives_its_file();
  unload_is_told();
  ksft_test_result(eventually([] { return guest::suspended() == 0; }),
                   "nothing is left suspended\n");
  ksft_finished();
}
