// SPDX-License-Identifier: Apache-2.0
// The emulators behave as nvgpu's and nvdla's source says (kmod/README.md, "The drivers"), also where
// that is not what one would like. xauto.ko has no part in this.
#include <chrono>
#include <thread>

#include "raw.h"

using raw::UniqueFd;

namespace {

using Clock = std::chrono::steady_clock;

long ms_since(Clock::time_point begin) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(Clock::now() - begin).count();
}

int suspend(const UniqueFd& tsg) {
  const int error = raw::call(tsg.get(), NVGPU_IOCTL_TSG_DISABLE);
  return error != 0 ? error : raw::call(tsg.get(), NVGPU_IOCTL_TSG_PREEMPT);
}

/// A TSG with one channel that has long work and is suspended.
struct Suspended {
  UniqueFd tsg = raw::tsg(), channel = raw::channel();
  Suspended() {
    if (raw::bind(tsg, channel) != 0 || raw::work(channel, 100) != 0 || suspend(tsg) != 0)
      ksft_exit_fail_msg("not suspended\n");
  }
  [[nodiscard]] bool runs() const { return raw::idle(channel, 10000); }
};

bool on_r36(bool r36) {
  nvgpu_gpu_open_tsg_args_r35 old{};
  nvgpu_gpu_open_tsg_args args{};
  const int said_old = raw::call(raw::ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG_R35, &old);
  const int said = raw::call(raw::ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG, &args);
  if (said_old == 0) close(static_cast<int>(old.tsg_fd));
  if (said == 0) close(static_cast<int>(args.tsg_fd));
  return said_old == (r36 ? ENOTTY : 0) && said == (r36 ? 0 : ENOTTY);
}

void what_enables() {
  {
    const Suspended s;
    guest::sleep_ms(300);
    ksft_test_result(!raw::idle(s.channel), "a disabled TSG does not run\n");
    ksft_test_result(raw::call(s.tsg.get(), NVGPU_IOCTL_TSG_ENABLE) == 0 && s.runs(),
                     "and runs when it is enabled\n");
  }
  {
    const Suspended s;
    const UniqueFd other = raw::channel();
    ksft_test_result(raw::bind(s.tsg, other) == 0 && s.runs(),
                     "a new channel enables all of the TSG\n");
  }
  {
    UniqueFd other = raw::channel();
    const Suspended s;
    (void)raw::bind(s.tsg, other);
    (void)suspend(s.tsg);
    other.reset();
    ksft_test_result(s.runs(), "so does a channel that is closed\n");
  }
  {
    const Suspended s;
    nvgpu_preemption_mode_args mode{};
    ksft_test_result(
        raw::call(s.channel.get(), NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE, &mode) == 0 && s.runs(),
        "and another preemption mode\n");
  }
  const UniqueFd tsg = raw::tsg(), channel = raw::channel();
  (void)raw::bind(tsg, channel);
  (void)suspend(tsg);
  ksft_test_result(guest::eventually([] { return guest::has(guest::gpu_state(), "powered=0"); }),
                   "a TSG without work does not keep the GPU powered\n");
  (void)raw::work(channel, 10);
  ksft_test_result(raw::idle(channel, 10000), "and power that comes back enables it\n");
}

void system_sleep() {
  const char* const name = "and a system sleep";
  const std::string why = guest::cannot_sleep();
  if (!why.empty()) return ksft_test_result_skip("%s: %s\n", name, why.c_str());
  const Suspended s;
  ksft_test_result(guest::system_sleep() && s.runs(), "%s\n", name);
}

void runlists() {
  const UniqueFd tsg = raw::tsg(), compute = raw::channel(), copies = raw::channel(1);
  ksft_test_result(raw::bind(tsg, compute) == 0 && raw::bind(tsg, copies) == EINVAL,
                   "a TSG has channels of one runlist\n");
  const UniqueFd second = raw::tsg();
  ksft_test_result(raw::bind(second, copies) == 0 && raw::work(copies, 50) == 0 &&
                       raw::work(compute, 50) == 0 && raw::idle(copies, 10000) &&
                       raw::idle(compute, 10000),
                   "so a context has a second one for its copies\n");
}

void preempt() {
  const UniqueFd tsg = raw::tsg(), channel = raw::channel();
  (void)raw::bind(tsg, channel);
  raw::gpu_parameter("yield_us", "650000");
  (void)raw::work(channel, 10000);
  if (!guest::eventually([] { return guest::has(guest::gpu_state(), "current=1"); }))
    ksft_exit_fail_msg("it does not run\n");
  const auto begin = Clock::now();
  const int said = raw::call(tsg.get(), NVGPU_IOCTL_TSG_PREEMPT);
  const long took = ms_since(begin);
  ksft_test_result(
      said == EBUSY && took >= 100,
      "PREEMPT of a context that does not leave says EBUSY, not before 100 ms (%d, %ld ms)\n", said,
      took);
  (void)raw::call(tsg.get(), NVGPU_IOCTL_TSG_DISABLE);
  ksft_test_result(guest::eventually([] { return !guest::has(guest::gpu_state(), "current=1"); }),
                   "the request stays: it leaves later\n");
  ksft_test_result(guest::has(guest::gpu_state(), "stuck_ms=600"), "what it took adds up\n");
  for (int i = 0; i < 20 && !guest::has(guest::gpu_state(), "killed=1"); ++i) {
    (void)raw::call(tsg.get(), NVGPU_IOCTL_TSG_ENABLE);
    (void)guest::eventually([] { return guest::has(guest::gpu_state(), "current=1"); });
    (void)raw::call(tsg.get(), NVGPU_IOCTL_TSG_PREEMPT);
    (void)raw::call(tsg.get(), NVGPU_IOCTL_TSG_DISABLE);
    (void)guest::eventually([] { return !guest::has(guest::gpu_state(), "current=1"); });
  }
  ksft_test_result(guest::has(guest::gpu_state(), "killed=1") && raw::work(channel, 1) == EIO,
                   "above 3 s in all the context is killed\n");
  raw::gpu_parameter("yield_us", "0");
  guest::gpu_fault("fail_preempt", 1);
  ksft_test_result(raw::call(tsg.get(), NVGPU_IOCTL_TSG_PREEMPT) == EBUSY &&
                       raw::call(tsg.get(), NVGPU_IOCTL_TSG_PREEMPT) == 0,
                   "a fault on demand says the same\n");
  ksft_test_result(
      raw::call(tsg.get(), _IO('T', 40)) == EINVAL && raw::call(tsg.get(), _IO('T', 12)) == ENOTTY,
      "an ioctl that is not the TSG's is EINVAL, one that is unknown ENOTTY\n");
}

void sharing() {
  const Suspended s;
  nvgpu_tsg_get_share_token_args token{1, 1, 0};
  nvgpu_gpu_open_tsg_args args{};
  args.share_token = 7;
  ksft_test_result(raw::call(raw::ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG, &args) == EINVAL,
                   "a token without the flag is refused\n");
  (void)raw::call(s.tsg.get(), NVGPU_TSG_IOCTL_GET_SHARE_TOKEN, &token);
  args = {0, NVGPU_GPU_IOCTL_OPEN_TSG_FLAGS_SHARE, 1, token.share_token};
  const int said = raw::call(raw::ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG, &args);
  const UniqueFd second(said == 0 ? static_cast<int>(args.tsg_fd) : -1);
  ksft_test_result(said == 0 && raw::call(second.get(), NVGPU_IOCTL_TSG_ENABLE) == 0 && s.runs(),
                   "two files may be one TSG\n");
}

void sched_node() {
  const UniqueFd sched = raw::sched(), ctrl = raw::ctrl();
  ksft_test_result(open("/dev/nvhost-sched-gpu", O_RDWR | O_CLOEXEC) < 0 && errno == EBUSY,
                   "the sched node is one's at a time, under both names\n");
  UniqueFd first = raw::tsg(), channel = raw::channel();
  const UniqueFd second = raw::tsg();
  ksft_test_result(raw::tsgs_of(sched, static_cast<std::uint64_t>(getpid())) == 2 &&
                       raw::tsgs_of(sched, 1) == 0 && raw::tsgs_of(sched, 0) == 0,
                   "it knows a process's TSGs\n");
  std::uint64_t word = 0;
  nvgpu_sched_get_tsgs_by_pid_args small{1, sizeof word, reinterpret_cast<std::uintptr_t>(&word)};
  nvgpu_sched_get_tsgs_args nowhere{4096, 0};
  ksft_test_result(raw::call(sched.get(), NVGPU_SCHED_IOCTL_GET_TSGS_BY_PID, &small) == ENOSPC &&
                       small.size == 32 &&
                       raw::call(sched.get(), NVGPU_SCHED_IOCTL_GET_TSGS, &nowhere) == ENOSPC &&
                       nowhere.size == 32,
                   "of too small a buffer it says the size that it wants\n");
  ksft_test_result(raw::call(sched.get(), _IO('T', 3)) == EINVAL &&
                       raw::call(sched.get(), _IO('S', 12)) == EINVAL,
                   "an ioctl that is not the sched node's is EINVAL\n");
  (void)raw::bind(first, channel);
  (void)raw::work(channel, 300);
  (void)suspend(first);
  first.reset();
  guest::sleep_ms(500);
  ksft_test_result(raw::tsgs_of(sched, static_cast<std::uint64_t>(getpid())) == 2 &&
                       guest::suspended() == 1 && !raw::idle(channel),
                   "a TSG outlives its file while a channel is bound, suspended if it was\n");
  channel.reset();
  ksft_test_result(
      raw::tsgs_of(sched, static_cast<std::uint64_t>(getpid())) == 1 && guest::suspended() == 0,
      "and goes with the channel\n");
}

void dla_queues() {
  const UniqueFd a = raw::dla(), b = raw::dla(), other = raw::dla(1);
  nvdla_get_fw_ver_args version{};
  ksft_test_result(raw::call(a.get(), NVDLA_IOCTL_GET_FIRMWARE_VERSION, &version) == 0 &&
                       raw::slot(a) == -EINVAL &&
                       raw::set_status(a, NVDLA_SET_QUEUE_SUSPEND) == EINVAL,
                   "a file without a queue has a firmware version, and no queue's status\n");
  (void)raw::call(a.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  const int slot = raw::slot(a);
  (void)raw::task(a, 300);  // which keeps the DLA powered
  ksft_test_result(slot >= 0 && raw::set_status(a, NVDLA_SET_QUEUE_SUSPEND) == 0 &&
                       raw::set_status(a, 3) == EINVAL && raw::set_status(a, 0) == EINVAL,
                   "a queue is suspended by one bit\n");
  (void)raw::call(a.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  (void)raw::call(b.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  ksft_test_result(raw::slot(b) == slot && guest::has(guest::dla_state(), "suspended=1"),
                   "a slot that was released while suspended is the next one's, suspended\n");
  (void)raw::set_status(b, NVDLA_SET_QUEUE_RESUME);
  (void)raw::set_status(b, NVDLA_SET_QUEUE_SUSPEND);
  raw::dla_parameter("flush_resumes", "1");
  (void)raw::call(b.get(), NVDLA_IOCTL_RELEASE_QUEUE);
  (void)raw::call(b.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  ksft_test_result(raw::slot(b) == slot && !guest::has(guest::dla_state(), "suspended=1"),
                   "unless flushing the queue resumes it, which nobody knows\n");
  raw::dla_parameter("flush_resumes", "0");

  (void)raw::set_status(b, NVDLA_SET_QUEUE_SUSPEND);
  ksft_test_result(
      guest::eventually([] { return !guest::has(guest::dla_state(), "suspended=1"); }) ||
          (guest::has(guest::dla_state(), "powered=0") && raw::task(b, 1) == 0 &&
           raw::idle(b, 10000)),
      "a queue without tasks loses its suspension with the power\n");

  (void)raw::call(other.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  raw::dla_parameter("command_us", "400000");
  std::thread command([&] { (void)raw::set_status(b, NVDLA_SET_QUEUE_RESUME); });
  guest::sleep_ms(50);
  auto begin = Clock::now();
  (void)raw::task(other, 1);
  const long elsewhere = ms_since(begin);
  begin = Clock::now();
  const long behind = raw::task(b, 1) == 0 ? ms_since(begin) : -1;
  command.join();
  ksft_test_result(
      behind > elsewhere,
      "a submit waits for a command of the same DLA (%ld ms), not of the other (%ld ms)\n", behind,
      elsewhere);
  raw::dla_parameter("command_us", "1000001");
  ksft_test_result(raw::set_status(b, NVDLA_SET_QUEUE_RESUME) == ETIMEDOUT,
                   "a command that takes more than a second is given up\n");
  raw::dla_parameter("command_us", "50");
}

bool loaded_as(const char* release) {
  const std::string load = std::string("rmmod xauto_nvgpu_emu xauto_nvdla_emu && ") +
                           "insmod /modules/xauto_nvgpu_emu.ko release=" + release + " && " +
                           "insmod /modules/xauto_nvdla_emu.ko release=" + release;
  return system(load.c_str()) == 0;
}

void release_35() {
  if (!loaded_as("r35")) ksft_exit_fail_msg("the emulators do not load as r35\n");
  ksft_test_result(on_r36(false), "r35 opens a TSG with 8 bytes\n");
  {
    const Suspended s;
    const UniqueFd other = raw::channel();
    ksft_test_result(raw::bind(s.tsg, other) == 0 && raw::work(other, 10) == 0 &&
                         guest::has(guest::gpu_state(), "channels=2 on=1"),
                     "there a new channel alone is enabled\n");
    const UniqueFd dla = raw::dla();
    ksft_test_result(raw::call(dla.get(), NVDLA_IOCTL_ALLOC_QUEUE) == 0 && raw::slot(dla) >= 0 &&
                         system("rmmod xauto_nvdla_emu 2>/dev/null") != 0,
                     "its nvdla has no module's files, and still cannot be unloaded under them\n");
  }
  if (!loaded_as("r36")) ksft_exit_fail_msg("the emulators do not load as r36\n");
}

}  // namespace

int main() {
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(36);
  ksft_test_result(on_r36(true), "r36 opens a TSG with 24 bytes\n");
  what_enables();
  system_sleep();
  runlists();
  preempt();
  sharing();
  sched_node();
  dla_queues();
  release_35();
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "nothing is left suspended\n");
  ksft_finished();
}
