// SPDX-License-Identifier: Apache-2.0
// Netlink messages and ioctls that nobody should send: random bytes, and valid messages with random
// damage. The kernel must answer each refused message with a text, and stay well (run-kmod reads
// its log). The seed is printed; XAUTO_FUZZ sets the number.
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include <fcntl.h>
#include <kselftest.h>
#include <linux/genetlink.h>
#include <linux/netlink.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <uapi/xauto/emu.h>
#include <uapi/xauto/nvdla.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

#include "emu/driver_queue.h"
#include "kernel/queue_control.h"

#include "guest.h"

using xauto::emu::DriverQueue;
using xauto::kernel::QueueControl;
using xauto::kernel::QueueType;

namespace {

std::mt19937_64 random_source;

std::uint32_t below(std::uint32_t limit) {
  return static_cast<std::uint32_t>(random_source() % limit);
}

/// A netlink message under construction; attributes may lie about their length.
class Message {
 public:
  Message(int family, std::uint8_t command, std::uint16_t flags) {
    nlmsghdr header{};
    header.nlmsg_type = static_cast<std::uint16_t>(family);
    header.nlmsg_flags = static_cast<std::uint16_t>(NLM_F_REQUEST | NLM_F_ACK | flags);
    header.nlmsg_seq = 1;
    append(&header, sizeof header);
    genlmsghdr generic{};
    generic.cmd = command;
    generic.version = 1;
    append(&generic, sizeof generic);
  }
  std::size_t open(int type) {
    const std::size_t at = bytes_.size();
    nlattr attr{NLA_HDRLEN, static_cast<std::uint16_t>(type)};
    append(&attr, sizeof attr);
    return at;
  }
  void close(std::size_t at) {
    const auto length = static_cast<std::uint16_t>(bytes_.size() - at);
    std::memcpy(&bytes_[at], &length, sizeof length);
    while (bytes_.size() % 4 != 0) bytes_.push_back(0);
  }
  void put(int type, const void* data, std::size_t size) {
    const std::size_t at = open(type);
    append(data, size);
    close(at);
  }
  void put32(int type, std::uint32_t value) { put(type, &value, sizeof value); }
  std::vector<unsigned char>& finish() {
    const auto length = static_cast<std::uint32_t>(bytes_.size());
    std::memcpy(bytes_.data(), &length, sizeof length);
    return bytes_;
  }

 private:
  void append(const void* data, std::size_t size) {
    if (size == 0) return;
    bytes_.resize(bytes_.size() + size);
    std::memcpy(bytes_.data() + bytes_.size() - size, data, size);
  }
  std::vector<unsigned char> bytes_;
};

std::uint32_t interesting() {
  static const std::uint32_t values[] = {0,     1,     2,     3,          4,          5,
                                         10,    64,    255,   256,        1000,       32767,
                                         50000, 60000, 65535, 0x7fffffff, 0x80000000, 0xffffffff};
  return below(3) == 0 ? static_cast<std::uint32_t>(random_source())
                       : values[below(std::size(values))];
}

/// A message that makes sense, or nearly.
Message plausible(int family, int tsg, std::uint32_t handle) {
  switch (below(6)) {
    case 0: {
      Message message(family, XAUTO_CMD_REGISTER, 0);
      message.put32(XAUTO_A_TYPE, 1 + below(2));
      message.put32(XAUTO_A_FD, below(4) ? static_cast<std::uint32_t>(tsg) : below(12));
      if (below(4) == 0) message.put32(XAUTO_A_PID, below(200));
      return message;
    }
    case 1: {
      Message message(family, XAUTO_CMD_UNREGISTER, 0);
      message.put32(XAUTO_A_HANDLE, handle);
      return message;
    }
    case 2: {
      Message message(family, XAUTO_CMD_WATCHDOG, 0);
      if (below(2)) message.put32(XAUTO_A_TIMEOUT_MS, interesting());
      return message;
    }
    case 3: {
      const bool dump = below(2) != 0;
      Message message(family, XAUTO_CMD_GET, dump ? NLM_F_DUMP : 0);
      if (!dump) message.put32(XAUTO_A_HANDLE, handle);
      return message;
    }
    default: {
      Message message(family, XAUTO_CMD_CONTROL, below(2) ? NLM_F_ECHO : 0);
      const std::size_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
      for (std::uint32_t n = below(4) + 1; n > 0; --n) {
        const std::size_t op = message.open(static_cast<int>(n) | NLA_F_NESTED);
        message.put32(XAUTO_OP_ACTION, 1 + below(4));
        message.put32(XAUTO_OP_HANDLE, handle);
        message.put32(XAUTO_OP_VALUE, below(3) ? 1000 + below(49000) : below(3));
        message.close(op);
      }
      message.close(ops);
      return message;
    }
  }
}

std::vector<unsigned char> damaged(int family, int tsg, std::uint32_t handle) {
  const auto command =
      static_cast<std::uint8_t>(below(10) == 0 ? below(256) : below(XAUTO_CMD_MAX + 1));
  static const std::uint16_t flags[] = {0, NLM_F_ECHO, NLM_F_DUMP, NLM_F_ROOT, NLM_F_EXCL};
  Message message(family, command, flags[below(std::size(flags))]);
  for (std::uint32_t i = below(6); i > 0; --i) {
    const int type = static_cast<int>(below(12) == 0 ? below(65536) : below(XAUTO_A_MAX + 2));
    switch (below(5)) {
      case 0:
        message.put32(type, interesting());
        break;
      case 1:
        message.put32(XAUTO_A_FD, below(2) ? static_cast<std::uint32_t>(tsg) : interesting());
        break;
      case 2:
        message.put32(XAUTO_A_TYPE, below(4));
        break;
      case 3: {
        const std::size_t ops = message.open(XAUTO_A_OPS | (below(2) ? NLA_F_NESTED : 0));
        for (std::uint32_t n = below(70); n > 0; --n) {
          const std::size_t op = message.open(static_cast<int>(n) | (below(4) ? NLA_F_NESTED : 0));
          if (below(8)) message.put32(XAUTO_OP_ACTION, below(8) ? below(6) : interesting());
          if (below(8)) message.put32(XAUTO_OP_HANDLE, below(3) ? handle : interesting());
          if (below(2)) message.put32(XAUTO_OP_VALUE, interesting());
          message.close(op);
        }
        message.close(ops);
        break;
      }
      default: {
        unsigned char noise[64];
        for (auto& byte : noise) byte = static_cast<unsigned char>(random_source());
        message.put(type, noise, below(sizeof noise));
      }
    }
  }
  std::vector<unsigned char> bytes = message.finish();
  for (std::uint32_t i = below(4); i > 0 && bytes.size() > sizeof(nlmsghdr); --i)
    bytes[sizeof(nlmsghdr) + below(static_cast<std::uint32_t>(bytes.size() - sizeof(nlmsghdr)))] ^=
        static_cast<unsigned char>(1u << below(8));
  return bytes;
}

struct Tally {
  long sent = 0, accepted = 0, refused = 0, without_text = 0, silent = 0;
  long not_ours = 0;  ///< genetlink's own answer to a command or mode that no family has
  int first_silent_errno = 0;
};

void read_answers(int fd, Tally& tally) {
  alignas(nlmsghdr) char buffer[32768];
  bool answered = false;
  for (;;) {
    const ssize_t size = recv(fd, buffer, sizeof buffer, MSG_DONTWAIT);
    if (size <= 0) break;
    auto left = static_cast<unsigned>(size);
    for (auto* h = reinterpret_cast<nlmsghdr*>(buffer); NLMSG_OK(h, left);
         h = NLMSG_NEXT(h, left)) {
      if (h->nlmsg_type == NLMSG_DONE) answered = true;
      if (h->nlmsg_type != NLMSG_ERROR) continue;
      answered = true;
      const auto* error = static_cast<const nlmsgerr*>(NLMSG_DATA(h));
      if (error->error == 0) {
        ++tally.accepted;
        continue;
      }
      ++tally.refused;
      const std::string raw(reinterpret_cast<char*>(h), h->nlmsg_len);
      bool text = false;
      if ((h->nlmsg_flags & NLM_F_ACK_TLVS) != 0) {
        const std::size_t echoed =
            (h->nlmsg_flags & NLM_F_CAPPED) != 0 ? sizeof(nlmsghdr) : error->msg.nlmsg_len;
        for (std::size_t at = NLMSG_HDRLEN + NLMSG_ALIGN(sizeof(int) + echoed);
             at + 4 <= raw.size();) {
          nlattr attr{};
          std::memcpy(&attr, &raw[at], sizeof attr);
          text |= attr.nla_type == NLMSGERR_ATTR_MSG;
          at += NLA_ALIGN(attr.nla_len < 4 ? 4 : attr.nla_len);
        }
      }
      if (!text && error->error == -EOPNOTSUPP)
        ++tally.not_ours;
      else if (!text && ++tally.without_text == 1)
        tally.first_silent_errno = -error->error;
    }
  }
  tally.silent += !answered;
}

void netlink(int messages) {
  auto control = QueueControl::open();
  auto tsg = DriverQueue::open_gpu();
  if (!control || !tsg) ksft_exit_fail_msg("no module\n");
  const int yes = 1;
  for (const int option : {NETLINK_EXT_ACK, NETLINK_CAP_ACK})
    setsockopt(control->descriptor(), SOL_NETLINK, option, &yes, sizeof yes);
  Tally tally;
  std::uint32_t last_handle = 1;
  for (int i = 0; i < messages; ++i) {
    // So that most messages meet an owner with a queue.
    if (i % 16 == 0)
      if (const auto queue = control->register_queue(QueueType::kGpuTsg, tsg->descriptor()))
        last_handle = queue->handle;
    const std::uint32_t handle = last_handle + below(3) - 1;
    const auto bytes = below(2) ? plausible(control->family(), tsg->descriptor(), handle).finish()
                                : damaged(control->family(), tsg->descriptor(), handle);
    if (send(control->descriptor(), bytes.data(), bytes.size(), 0) < 0) continue;
    ++tally.sent;
    read_answers(control->descriptor(), tally);
  }
  ksft_test_result(
      tally.sent > messages * 9 / 10 && tally.accepted > messages / 10,
      "%ld netlink messages: %ld accepted, %ld refused, %ld of them by genetlink itself, %ld "
      "unanswered\n",
      tally.sent, tally.accepted, tally.refused, tally.not_ours, tally.silent);
  ksft_test_result(tally.refused > messages / 4 && tally.without_text == 0,
                   "every refusal has a text (%ld have none; the first is errno %d)\n",
                   tally.without_text, tally.first_silent_errno);
}

void ioctls(int calls) {
  const int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR);
  int done = 0, accepted = 0;
  for (int round = 0; done < calls; ++round) {
    const int tsg = open("/dev/nvgpu/igpu0/tsg", O_RDWR),
              channel = open("/dev/nvgpu/igpu0/channel", O_RDWR);
    const int dla = open("/dev/nvhost-ctrl-nvdla0", O_RDWR);
    const int files[] = {ctrl, tsg, channel, dla};
    const char magics[] = {'T', 'G', 'D', 'X'};
    for (int i = 0; i < 200; ++i, ++done) {
      alignas(8) unsigned char argument[64];
      for (auto& byte : argument)
        byte = below(3) == 0 ? static_cast<unsigned char>(random_source()) : 0;
      std::uint32_t words[2] = {below(2) ? static_cast<std::uint32_t>(channel) : interesting(), 0};
      std::memcpy(argument, words, sizeof words);
      if (below(4) == 0) {
        const std::uint64_t task = reinterpret_cast<std::uintptr_t>(argument + 32),
                            duration = 1 + below(100000);
        std::memcpy(argument, &task, sizeof task);
        const std::uint16_t count = static_cast<std::uint16_t>(below(18));
        std::memcpy(argument + 8, &count, sizeof count);
        const std::uint32_t version = below(8) ? 1 : interesting();
        argument[10] = argument[11] = 0;
        std::memcpy(argument + 12, &version, sizeof version);
        std::memcpy(argument + 32, &duration, sizeof duration);
      }
      static const unsigned sizes[] = {0, 4, 8, 16, 24, 1, 64};
      const unsigned long command =
          _IOC(below(4), magics[below(4)], below(24), sizes[below(std::size(sizes))]);
      static const unsigned long real[] = {NVGPU_GPU_IOCTL_OPEN_TSG,
                                           NVGPU_GPU_IOCTL_OPEN_CHANNEL,
                                           NVGPU_TSG_IOCTL_BIND_CHANNEL,
                                           NVGPU_IOCTL_TSG_ENABLE,
                                           NVGPU_IOCTL_TSG_DISABLE,
                                           NVGPU_IOCTL_TSG_PREEMPT,
                                           NVGPU_IOCTL_TSG_SET_RUNLIST_INTERLEAVE,
                                           NVGPU_IOCTL_TSG_SET_TIMESLICE,
                                           NVGPU_IOCTL_TSG_GET_TIMESLICE,
                                           XAUTO_EMU_IOCTL_SUBMIT,
                                           NVDLA_IOCTL_PING,
                                           NVDLA_IOCTL_SET_QUEUE_STATUS,
                                           NVDLA_IOCTL_GET_FIRMWARE_VERSION,
                                           NVDLA_IOCTL_EMU_TASK_SUBMIT,
                                           NVDLA_IOCTL_ALLOC_QUEUE,
                                           NVDLA_IOCTL_RELEASE_QUEUE};
      const unsigned long number = below(3) ? real[below(std::size(real))] : command;
      void* pointer = below(20) == 0
                          ? reinterpret_cast<void*>(static_cast<std::uintptr_t>(interesting()))
                          : argument;
      accepted += ioctl(files[below(4)], number, pointer) == 0;
    }
    close(tsg);
    close(channel);
    close(dla);
    // What OPEN_TSG and OPEN_CHANNEL gave.
    for (int fd = ctrl + 1; fd < 512; ++fd) close(fd);
  }
  ksft_test_result(done >= calls && accepted > calls / 20 && accepted < calls,
                   "%d ioctls: %d accepted\n", done, accepted);
}

}  // namespace

int main() {
  const char* seed = getenv("XAUTO_SEED");
  const char* scale = getenv("XAUTO_FUZZ");
  const unsigned long start = seed != nullptr ? strtoul(seed, nullptr, 0) : 1;
  const int count = scale != nullptr ? atoi(scale) : 8000;
  random_source.seed(start);
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(4);
  ksft_print_msg("seed %lu, %d netlink messages and as many ioctls (XAUTO_SEED, XAUTO_FUZZ)\n",
                 start, count);
  netlink(count);
  ioctls(count);
  ksft_test_result(guest::eventually([] { return guest::suspended() == 0; }),
                   "nothing is left suspended\n");
  ksft_finished();
}
