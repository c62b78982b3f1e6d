// SPDX-License-Identifier: Apache-2.0
// xauto.ko over the emulators: what each command does, and what each refusal says.
#include <array>
#include <atomic>
#include <csignal>
#include <filesystem>
#include <string>
#include <vector>

#include <fcntl.h>
#include <kselftest.h>
#include <linux/genetlink.h>
#include <linux/netlink.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

#include "emu/driver_queue.h"
#include "kernel/queue_control.h"
#include "kernel/queue_files.h"

#include "guest.h"
#include "queue_events.h"

using namespace std::chrono_literals;
using guest::has, guest::QueueEvents, guest::text_of;
using xauto::emu::DriverQueue;
using xauto::kernel::QueueControl;
using xauto::kernel::QueueOp;
using xauto::kernel::QueueType;

namespace {

DriverQueue gpu() {
  auto queue = DriverQueue::open_gpu();
  if (!queue) ksft_exit_fail_msg("no GPU: %s\n", queue.error().to_string().c_str());
  return std::move(*queue);
}
DriverQueue dla(int instance = 0) {
  auto queue = DriverQueue::open_dla(instance);
  if (!queue) ksft_exit_fail_msg("no DLA: %s\n", queue.error().to_string().c_str());
  return std::move(*queue);
}
QueueControl control() {
  auto control = QueueControl::open();
  if (!control) ksft_exit_fail_msg("no xauto.ko: %s\n", control.error().to_string().c_str());
  return std::move(*control);
}
std::uint32_t registered(QueueControl& control, const DriverQueue& queue, QueueType type) {
  auto handle = control.register_queue(type, queue.descriptor());
  if (!handle) ksft_exit_fail_msg("not registered: %s\n", handle.error().to_string().c_str());
  return handle->handle;
}
int finished(const DriverQueue& queue) {
  return static_cast<int>(queue.finished().value_or(99));
}

void refusals() {
  QueueControl c = control();
  DriverQueue tsg = gpu(), queue = dla();
  const int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR);
  const int channel = open("/dev/nvgpu/igpu0/channel", O_RDWR);
  auto text = [&](QueueType type, int fd) { return text_of(c.register_queue(type, fd)); };
  ksft_test_result(has(text(QueueType::kGpuTsg, 999), "no such file descriptor"),
                   "a closed descriptor is refused\n");
  ksft_test_result(has(text(QueueType::kGpuTsg, 0), "not of a GPU driver"),
                   "a file of another driver is no TSG\n");
  ksft_test_result(has(text(QueueType::kGpuTsg, channel), "not a TSG"), "a channel is no TSG\n");
  ksft_test_result(has(text(QueueType::kGpuTsg, ctrl), "not a TSG"), "a ctrl node is no TSG\n");
  ksft_test_result(has(text(QueueType::kGpuTsg, queue.descriptor()), "not of a GPU driver"),
                   "a DLA queue is no TSG\n");
  ksft_test_result(has(text(QueueType::kDla, tsg.descriptor()), "not of a DLA driver"),
                   "a TSG is no DLA queue\n");
  ksft_test_result(has(text_of(c.suspend(1)), "nothing is registered"),
                   "a socket that registered nothing owns nothing\n");
  const auto handle = registered(c, tsg, QueueType::kGpuTsg);
  ksft_test_result(has(text_of(c.suspend(handle + 7)), "no such handle"),
                   "an unknown handle is refused\n");
  ksft_test_result(has(text_of(c.register_queue(QueueType::kGpuTsg, tsg.descriptor(), 999999)),
                       "no such process"),
                   "an unknown process is refused\n");
  ksft_test_result(has(text_of(c.set_watchdog(3)), "10 to 60000"),
                   "a watchdog below the least is refused\n");
  ksft_test_result(!text_of(c.set_watchdog(99999)).empty(),
                   "a watchdog above the greatest is refused\n");
  const std::vector<QueueOp> none, many(65, QueueOp{XAUTO_ACTION_SUSPEND, handle});
  ksft_test_result(has(text_of(c.control(none)), "XAUTO_A_OPS is missing"),
                   "an empty batch is refused\n");
  ksft_test_result(has(text_of(c.control(many)), "1 to 64"), "a batch of 65 is refused\n");
  ksft_test_result(guest::suspended() == 0, "a refused batch did nothing\n");
  const QueueOp slice{XAUTO_ACTION_SET_TIMESLICE, handle, 100};
  ksft_test_result(has(text_of(c.control({&slice, 1})), "1000..50000"),
                   "a time slice that nvgpu refuses is explained\n");
  const QueueOp level{XAUTO_ACTION_SET_INTERLEAVE, handle, 3};
  ksft_test_result(has(text_of(c.control({&level, 1})), "0..2"),
                   "an interleave level that nvgpu refuses is explained\n");
  const auto dla_handle = registered(c, queue, QueueType::kDla);
  const QueueOp dla_slice{XAUTO_ACTION_SET_TIMESLICE, dla_handle, 2000};
  ksft_test_result(has(text_of(c.control({&dla_slice, 1})), "neither time slice"),
                   "a DLA queue has no time slice\n");
  const QueueOp batch[] = {{XAUTO_ACTION_SUSPEND, dla_handle}, {XAUTO_ACTION_SUSPEND, 77}};
  const auto failed = c.control(batch);
  ksft_test_result(!failed && has(failed.error().where, "operation 2 of 2"),
                   "a batch's error names the operation\n");
  ksft_test_result(guest::suspended() == 1, "what came before it stays done\n");
  close(ctrl);
  close(channel);
}

void gpu_priority() {
  QueueControl c = control();
  DriverQueue low = gpu(), high = gpu();
  const auto l = registered(c, low, QueueType::kGpuTsg),
             h = registered(c, high, QueueType::kGpuTsg);
  ksft_test_result(l != h && registered(c, low, QueueType::kGpuTsg) == l,
                   "registering again gives the same handle\n");
  (void)low.submit(300ms);
  ksft_test_result(c.suspend(l).has_value(), "a running TSG is suspended\n");
  ksft_test_result(has(guest::gpu_state(), "enabled=0 current=0"),
                   "it is disabled and off the engine\n");
  (void)high.submit(50ms);
  ksft_test_result(high.wait(10000).value_or(false) && finished(low) == 0,
                   "the more urgent one finishes first\n");
  guest::sleep_ms(400);
  ksft_test_result(finished(low) == 0, "no work of a suspended TSG runs\n");
  const QueueOp swap[] = {{XAUTO_ACTION_SUSPEND, h}, {XAUTO_ACTION_RESUME, l}};
  const auto costs = c.control_timed(swap);
  ksft_test_result(costs && costs->size() == 2 && (*costs)[0] > 0,
                   "a batch suspends one and resumes the other, with costs\n");
  ksft_test_result(low.wait(10000).value_or(false) && finished(low) == 1, "resumed, it finishes\n");
  ksft_test_result(c.suspend(h).has_value() && c.resume(l).has_value(),
                   "suspending twice and resuming twice are no errors\n");
  const auto info = c.query(l);
  ksft_test_result(info && info->suspends == 1 && info->resumes == 1 &&
                       info->suspended_ns > 300'000'000 && !info->suspended,
                   "the statistics tell what happened\n");
  const QueueOp slice{XAUTO_ACTION_SET_TIMESLICE, l, 5000};
  ksft_test_result(c.control({&slice, 1}).has_value() && c.query(l).value().timeslice_us == 5000,
                   "a time slice is set, and read back from the driver\n");
  const QueueOp level{XAUTO_ACTION_SET_INTERLEAVE, h, 2};
  ksft_test_result(c.control({&level, 1}).has_value() && has(guest::gpu_state(), "level=2"),
                   "an interleave level is set\n");
  ksft_test_result(c.unregister(h).has_value() && guest::suspended() == 0,
                   "unregistering resumes\n");
}

void dla_queues() {
  QueueControl c = control();
  DriverQueue low = dla(), high = dla();
  const auto l = registered(c, low, QueueType::kDla);
  (void)low.submit(100ms);
  (void)low.submit(100ms);
  ksft_test_result(c.suspend(l).has_value(), "a DLA queue is suspended\n");
  (void)high.submit(30ms);
  ksft_test_result(high.wait(10000).value_or(false) && finished(low) == 1,
                   "its running task completes, then the other queue's runs\n");
  guest::sleep_ms(200);
  ksft_test_result(finished(low) == 1, "no task of a suspended queue is started\n");
  ksft_test_result(c.resume(l).has_value() && low.wait(10000).value_or(false) && finished(low) == 2,
                   "resumed, it goes on\n");
}

void faults() {
  QueueControl c = control();
  DriverQueue tsg = gpu();
  const auto handle = registered(c, tsg, QueueType::kGpuTsg);
  (void)tsg.submit(50ms);
  guest::gpu_fault("fail_preempt", 1);
  const auto refused = c.suspend(handle);
  ksft_test_result(!refused && refused.error().code == xauto::ErrorCode::kTimeout &&
                       has(refused.error().what, "runs again"),
                   "a TSG that does not leave the engine is an error\n");
  ksft_test_result(guest::suspended() == 0 && tsg.wait(10000).value_or(false),
                   "and it runs again\n");
  ksft_test_result(guest::eventually([&] { return c.suspend(handle).has_value(); }),
                   "after a while it is tried again\n");
  guest::gpu_fault("fail_enable", 3);
  ksft_test_result(has(text_of(c.resume(handle)), "tries again"),
                   "a driver that does not resume is an error\n");
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "the sweeper resumes it\n");
  (void)c.suspend(handle);
  guest::gpu_fault("fail_enable", 2);
  (void)c.unregister(handle);
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "also when nobody has it registered any more\n");
}

void owners() {
  DriverQueue tsg = gpu();
  auto first = std::make_unique<QueueControl>(control());
  auto second = std::make_unique<QueueControl>(control());
  const auto a = registered(*first, tsg, QueueType::kGpuTsg),
             b = registered(*second, tsg, QueueType::kGpuTsg);
  (void)first->suspend(a);
  (void)second->suspend(b);
  (void)first->resume(a);
  ksft_test_result(guest::suspended() == 1, "one owner's resume does not undo another's suspend\n");
  (void)first->suspend(a);
  second.reset();
  guest::sleep_ms(100);
  ksft_test_result(guest::suspended() == 1, "nor does another's end\n");
  first.reset();
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "the last owner's end resumes\n");

  QueueControl starved = control();
  const auto handle = registered(starved, tsg, QueueType::kGpuTsg);
  (void)starved.set_watchdog(1000);  // the host may hold the guest up for a tenth of a second
  (void)starved.suspend(handle);
  for (int i = 0; i < 13; ++i) {
    guest::sleep_ms(100);
    (void)starved.feed_watchdog();
  }
  ksft_test_result(guest::suspended() == 1, "a watchdog that is fed does not bite\n");
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "one that starves resumes\n");
  ksft_test_result(
      has(text_of(starved.feed_watchdog()), "had expired") && starved.feed_watchdog().has_value(),
      "and says so, once\n");
}

void power() {
  QueueControl c = control();
  DriverQueue tsg = gpu(), raw = gpu();
  const auto handle = registered(c, tsg, QueueType::kGpuTsg);
  (void)c.suspend(handle);
  guest::sleep_ms(400);
  ksft_test_result(has(guest::gpu_state(), "powered=1"),
                   "the GPU keeps its power while a context without work is suspended\n");
  (void)tsg.submit(10ms);
  guest::sleep_ms(200);
  ksft_test_result(finished(tsg) == 0, "so the suspension lasts\n");
  (void)c.resume(handle);
  ksft_test_result(tsg.wait(10000).value_or(false) &&
                       guest::eventually([] { return has(guest::gpu_state(), "powered=0"); }),
                   "and the GPU sleeps afterwards\n");
  // The emulator must be able to forget, or the test above could not fail.
  ioctl(raw.descriptor(), NVGPU_IOCTL_TSG_DISABLE);
  (void)guest::eventually([] { return has(guest::gpu_state(), "powered=0"); });
  (void)raw.submit(10ms);
  ksft_test_result(raw.wait(10000).value_or(false),
                   "one disabled behind the module's back runs then\n");
}

/// Runs `body` in a child of the given user; its exit status, or -1.
int as_user(uid_t user, const std::function<int()>& body) {
  const pid_t child = fork();
  if (child == 0) {
    if (setgid(user) != 0 || setuid(user) != 0) _exit(99);
    const int status = body();
    fflush(stdout);
    _exit(status);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

void permissions() {
  DriverQueue roots = gpu();
  ksft_test_result(
      as_user(1000,
              [&] {
                auto c = QueueControl::open();
                return c && has(text_of(c->register_queue(QueueType::kGpuTsg, roots.descriptor())),
                                "another user")
                           ? 0
                           : 1;
              }) == 0,
      "a user cannot register what another user opened\n");
  ksft_test_result(
      as_user(1000,
              [&] {
                auto c = QueueControl::open();
                auto own = DriverQueue::open_gpu();
                if (!own) ksft_print_msg("%s\n", own.error().to_string().c_str());
                if (!c || !own) return 2;
                auto handle = c->register_queue(QueueType::kGpuTsg, own->descriptor());

                return handle && c->suspend(handle->handle) && c->resume(handle->handle) ? 0 : 1;
              }) == 0,
      "a user suspends what the same user opened\n");
  ksft_test_result(
      as_user(1000,
              [&] {
                auto c = QueueControl::open();
                auto own = DriverQueue::open_gpu();
                if (!c || !own) return 2;
                return has(text_of(c->register_queue(QueueType::kGpuTsg, own->descriptor(), 1)),
                           "not the user's")
                           ? 0
                           : 1;
              }) == 0,
      "nor say that it is another user's process's\n");
  QueueControl c = control();
  (void)registered(c, roots, QueueType::kGpuTsg);
  ksft_test_result(as_user(1000,
                           [&] {
                             auto other = QueueControl::open();
                             auto list = other ? other->list() : decltype(other->list())();
                             return list && list->empty() ? 0 : 1;
                           }) == 0,
                   "a user does not see another's queues\n");
  ksft_test_result(c.list().value().size() == 1 && c.list().value()[0].pid == getpid(),
                   "root does, with its process\n");
  ksft_test_result(
      as_user(1000,
              [&] {
                auto other = QueueControl::open();
                auto own = DriverQueue::open_gpu();
                if (!other || !own || !other->register_queue(QueueType::kGpuTsg, own->descriptor()))
                  return 2;
                return has(text_of(other->set_watchdog(0)), "CAP_SYS_NICE") ? 0 : 1;
              }) == 0,
      "going without a watchdog is not for everybody\n");
  ksft_test_result(as_user(1000, [] { return QueueEvents::subscribe() ? 1 : 0; }) == 0,
                   "nor are the events, which tell of all\n");
}

void other_process() {
  QueueControl c = control();
  int ready[2];
  if (pipe(ready) != 0) ksft_exit_fail_msg("pipe\n");
  const pid_t app = fork();
  if (app == 0) {
    DriverQueue tsg = gpu(), queue = dla(1);
    (void)tsg.submit(10s);
    (void)!write(ready[1], "x", 1);
    pause();
    _exit(0);
  }
  char byte = 0;
  (void)!read(ready[0], &byte, 1);
  auto events = QueueEvents::subscribe();
  const auto files = xauto::kernel::find_queue_files(app);
  int tsg_fd = -1, dla_fd = -1;
  for (const auto& file : files ? *files : std::vector<xauto::kernel::QueueFile>())
    (file.type == QueueType::kGpuTsg ? tsg_fd : dla_fd) = file.fd;
  ksft_test_result(files && files->size() == 2 && tsg_fd >= 0 && dla_fd >= 0,
                   "a process's TSG and DLA queue are found among its descriptors\n");
  auto fd = xauto::kernel::take_descriptor(app, tsg_fd);
  if (!fd) ksft_exit_fail_msg("%s\n", fd.error().to_string().c_str());
  const auto handle = c.register_queue(QueueType::kGpuTsg, fd->get(), app);
  if (!handle) ksft_exit_fail_msg("%s\n", handle.error().to_string().c_str());
  fd->reset();
  ksft_test_result(handle && c.suspend(handle->handle).has_value() && guest::suspended() == 1,
                   "its TSG is suspended\n");
  ksft_test_result(c.query(handle->handle).value().pid == app, "and known by its process\n");
  kill(app, SIGKILL);
  waitpid(app, nullptr, 0);
  ksft_test_result(guest::eventually([] { return guest::count(guest::gpu_state(), "tsg=") == 0; }),
                   "a process that dies while suspended is cleaned up\n");
  ksft_test_result(has(text_of(c.suspend(handle->handle)), "process is gone"),
                   "its handle says so\n");
  std::vector<xauto_kevent> seen;
  for (;;) {
    const auto event = events->next(200);
    if (!event || !*event) break;
    if ((*event)->pid == app && (*event)->kind != XAUTO_KEV_ESCAPED)
      seen.push_back((*event)->kind);  // an earlier owner may still be on its way out
  }
  const std::vector<xauto_kevent> want = {XAUTO_KEV_REGISTER, XAUTO_KEV_SUSPEND, XAUTO_KEV_RESUME,
                                          XAUTO_KEV_TARGET_GONE};
  ksft_test_result(seen == want, "the events tell it in order\n");
  close(ready[0]);
  close(ready[1]);
}

/// A dump read by hand, a part at a time; what the class reads is bigger and faster.
class Dump {
 public:
  explicit Dump(xauto::UniqueFd asked) : fd_(std::move(asked)) {}
  explicit Dump(int family, bool addressed = false)
      : fd_(socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_GENERIC)) {
    struct {
      nlmsghdr header;
      genlmsghdr generic;
    } request{};
    request.header.nlmsg_len = sizeof request;
    request.header.nlmsg_type = static_cast<std::uint16_t>(family);
    request.header.nlmsg_flags = NLM_F_REQUEST | NLM_F_DUMP;
    request.generic.cmd = XAUTO_CMD_GET;
    request.generic.version = XAUTO_FAMILY_VERSION;
    sockaddr_nl kernel{};
    kernel.nl_family = AF_NETLINK;
    if (sendto(fd_.get(), &request, sizeof request, 0, reinterpret_cast<sockaddr*>(&kernel),
               addressed ? sizeof kernel : 0) < 0)
      ksft_exit_fail_msg("no dump\n");
  }
  [[nodiscard]] int descriptor() const { return fd_.get(); }
  /// The next part; false at the end.
  bool part() {
    alignas(nlmsghdr) std::array<char, 4096> buffer;
    const ssize_t got = recv(fd_.get(), buffer.data(), buffer.size(), 0);
    if (got <= 0) ksft_exit_fail_msg("the dump has no end\n");
    ++parts;
    auto left = static_cast<unsigned>(got);
    for (auto* m = reinterpret_cast<nlmsghdr*>(buffer.data()); NLMSG_OK(m, left);
         m = NLMSG_NEXT(m, left)) {
      interrupted = interrupted || (m->nlmsg_flags & NLM_F_DUMP_INTR) != 0;
      if (m->nlmsg_type == NLMSG_DONE) return false;
      ++queues;
    }
    return true;
  }
  int parts = 0, queues = 0;
  bool interrupted = false;

 private:
  xauto::UniqueFd fd_;
};

/// A user asks for a dump longer than one part, and gives the socket to who may more.
void read_by_root() {
  constexpr int kQueues = 60;
  for (const bool addressed : {false, true}) {
    int there[2], asked[2];
    if (pipe(there) != 0 || pipe(asked) != 0) ksft_exit_fail_msg("pipe\n");
    const pid_t user = fork();
    if (user == 0) {
      if (setgid(1000) != 0 || setuid(1000) != 0) _exit(9);
      QueueControl c = control();
      std::vector<xauto::UniqueFd> files;
      for (int i = 0; i < kQueues; ++i) {
        files.emplace_back(open("/dev/nvgpu/igpu0/tsg", O_RDWR | O_CLOEXEC));
        if (!c.register_queue(QueueType::kGpuTsg, files.back().get())) _exit(8);
      }
      char byte = 0;
      (void)!write(asked[1], &byte, 1);
      (void)!read(there[0], &byte, 1);  // root has queues behind them by now
      const Dump dump(c.family(), addressed);
      const int descriptor = dump.descriptor();
      (void)!write(asked[1], &descriptor, sizeof descriptor);
      pause();
    }
    char byte = 0;
    (void)!read(asked[0], &byte, 1);
    QueueControl c = control();
    std::vector<DriverQueue> own;
    for (int i = 0; i < 10; ++i) {
      own.push_back(gpu());
      (void)registered(c, own.back(), QueueType::kGpuTsg);
    }
    (void)!write(there[1], &byte, 1);
    int descriptor = -1;
    (void)!read(asked[0], &descriptor, sizeof descriptor);
    auto fd = xauto::kernel::take_descriptor(user, descriptor);
    if (!fd) ksft_exit_fail_msg("%s\n", fd.error().to_string().c_str());
    Dump dump(std::move(*fd));
    while (dump.part()) {
    }
    ksft_test_result(
        dump.parts > 2 && dump.queues == kQueues,
        "a dump that a user asked for%s tells root, who reads it, the user's queues (%d of %d)\n",
        addressed ? " by address" : "", dump.queues, kQueues);
    kill(user, SIGKILL);
    waitpid(user, nullptr, 0);
    for (const int each : {there[0], there[1], asked[0], asked[1]}) close(each);
  }
}

void dumps() {
  constexpr std::size_t kQueues = 120;  // many times what fits into one part
  QueueControl c = control(), other = control();
  std::vector<xauto::UniqueFd> files;
  std::vector<std::uint32_t> handles;
  while (files.size() < kQueues) {
    files.emplace_back(open("/dev/nvgpu/igpu0/tsg", O_RDWR | O_CLOEXEC));
    const auto handle = c.register_queue(QueueType::kGpuTsg, files.back().get());
    if (!handle) ksft_exit_fail_msg("not registered: %s\n", handle.error().to_string().c_str());
    handles.push_back(handle->handle);
  }
  Dump quiet(c.family());
  while (quiet.part()) {
  }
  ksft_test_result(quiet.parts > 3 && quiet.queues == kQueues && !quiet.interrupted,
                   "a long dump comes in parts, and is whole while nothing changes\n");

  Dump shrunk(c.family());
  (void)shrunk.part();
  (void)c.unregister(handles.back());
  while (shrunk.part()) {
  }
  ksft_test_result(shrunk.interrupted, "a dump during which a queue goes is told as interrupted\n");

  Dump grown(c.family());
  (void)grown.part();
  (void)c.register_queue(QueueType::kGpuTsg, files.back().get());
  while (grown.part()) {
  }
  ksft_test_result(grown.interrupted, "and one during which a queue comes\n");

  Dump closed(c.family());
  (void)closed.part();
  files.back().reset();  // nobody but the module holds it: the sweeper gives it back
  const auto listed = [&] {
    const auto list = c.list();
    return list ? list->size() : 0;
  };
  ksft_test_result(guest::eventually([&] { return listed() == kQueues - 1; }),
                   "a queue whose process closed it leaves the list\n");
  while (closed.part()) {
  }
  ksft_test_result(closed.interrupted, "which interrupts a dump as well\n");

  // Another owner's queue comes and goes: a list that is read once meets that sooner or later,
  // one that is read again becomes whole. However slow the machine is, most readings are quiet.
  const auto begin = std::chrono::steady_clock::now();
  for (int i = 0; i < 10; ++i) (void)listed();
  const auto ten_lists = std::chrono::steady_clock::now() - begin;
  std::atomic<bool> stop{false};
  std::thread churn([&] {
    const DriverQueue queue = dla(1);
    while (!stop) {
      const auto handle = other.register_queue(QueueType::kDla, queue.descriptor());
      if (handle) (void)other.unregister(handle->handle);
      std::this_thread::sleep_for(ten_lists);
    }
  });
  const bool told = guest::eventually(
      [&] { return has(text_of(c.list(1)), "came or went each time that it was read, 1 times"); },
      20000);
  ksft_test_result(told, "a list read once says when it changed meanwhile\n");
  int whole = 0;
  for (int i = 0; i < 50; ++i) {
    const auto list = c.list();
    if (!list) ksft_print_msg("%s\n", list.error().what.c_str());
    whole += list && list->size() >= kQueues - 1;
  }
  ksft_test_result(whole == 50, "read again it is whole, each of 50 times (%d)\n", whole);
  stop = true;
  churn.join();
}

/// The module's threads that sleep as the hung-task detector's victims do, after 120 s; -1: it has none.
int threads_that_look_hung() {
  int threads = 0, hung = 0;
  for (const auto& process : std::filesystem::directory_iterator("/proc")) {
    const std::string stat = guest::slurp(process.path() / "stat");  // "7 (xauto/ioctl0) S ..."
    threads += has(stat, "(xauto/ioctl");
    hung += has(stat, "(xauto/ioctl") && has(stat, ") D ");
  }
  return threads == 0 ? -1 : hung;
}

void unload() {
  DriverQueue tsg = gpu(), queue = dla();
  QueueControl c = control();
  (void)c.suspend(registered(c, tsg, QueueType::kGpuTsg));
  (void)c.suspend(registered(c, queue, QueueType::kDla));
  ksft_test_result(guest::suspended() == 2, "a TSG and a DLA queue are suspended\n");
  ksft_test_result(system("rmmod xauto") == 0, "the module unloads\n");
  ksft_test_result(guest::suspended() == 0, "and has resumed both\n");
  ksft_test_result(system("insmod /modules/xauto.ko") == 0, "it loads again\n");
  ksft_test_result(guest::eventually([] { return threads_that_look_hung() == 0; }),
                   "its threads, which nobody has called yet, do not look hung\n");
}

}  // namespace

int main() {
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(79);
  refusals();
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "nothing is left suspended by the refusals\n");
  gpu_priority();
  dla_queues();
  faults();
  owners();
  power();
  permissions();
  other_process();
  dumps();
  read_by_root();
  unload();
  ksft_finished();
}
