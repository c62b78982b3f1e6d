// SPDX-License-Identifier: Apache-2.0
// The numbers are written here again, as the facts of the drivers' source give them, and not taken
// from include/uapi: a test shall not agree with a mistake.
#include "nvgpu.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace devices {
namespace {

constexpr const char* kCtrl = "/dev/nvgpu/igpu0/ctrl";
constexpr const char* kDla = "/dev/nvhost-ctrl-nvdla0";
constexpr const char* kTsgNode = "/dev/nvgpu/igpu0/tsg";  ///< only found: nobody here opens it

unsigned type_of(unsigned command) {
  return command >> 8 & 0xff;
}
unsigned number_of(unsigned command) {
  return command & 0xff;
}
unsigned size_of(unsigned command) {
  return command >> 16 & 0x3fff;
}

/// gk20a_channel: closing it takes it off its TSG, which is enabled then.
class Channel final : public File {
 public:
  const int number;

  Channel(NvgpuState& state, int n) : number(n), state_(state) {}
  ~Channel() override {
    for (auto& [id, tsg] : state_.tsgs)
      if (tsg.channels.erase(number) > 0) tsg.enabled = true;
    std::erase_if(state_.tsgs, [](const auto& entry) {
      return entry.second.closed && entry.second.channels.empty();
    });
  }
  std::string link() const override {
    return "anon_inode:nvhost-ga10b-fd" + std::to_string(number);
  }
  long ioctl(Caller&, unsigned, std::uint64_t) override { return -ENOTTY; }

 private:
  NvgpuState& state_;
};

class Tsg final : public File {
 public:
  Tsg(NvgpuState& state, int id) : state_(state), id_(id) { state.tsgs[id]; }
  ~Tsg() override {
    NvgpuState::Tsg& tsg = state_.tsgs[id_];
    tsg.closed = true;
    if (tsg.channels.empty()) state_.tsgs.erase(id_);
  }
  /// By the number of its first descriptor, so that of another later.
  std::string link() const override { return "anon_inode:nvgpu-ga10b-tsg" + std::to_string(named); }
  int named = -1;

  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    NvgpuState::Tsg& tsg = state_.tsgs[id_];
    if (type_of(command) != 'T' || number_of(command) == 0 || number_of(command) > 21 ||
        size_of(command) > 24)
      return -EINVAL;
    switch (command) {
      case 0x40045401: {  // BIND_CHANNEL
        int fd = 0;
        if (!caller.read(argument, fd)) return -EFAULT;
        const auto channel = std::dynamic_pointer_cast<Channel>(caller.file(fd));
        if (channel == nullptr) return -EINVAL;
        tsg.channels.insert(channel->number);
        tsg.enabled = true;  // r36: ga10b_channel_bind enables all of the TSG
        return 0;
      }
      case 0x5403:  // ENABLE
        if (state_.gone || (state_.fail_enable > 0 && state_.fail_enable-- > 0)) return -ENODEV;
        tsg.enabled = true;
        return 0;
      case 0x5404:  // DISABLE
        if (state_.gone) return -ENODEV;
        tsg.enabled = false;
        ++tsg.disables;
        return 0;
      case 0x5405:  // PREEMPT
        if (state_.gone) return -ENODEV;
        ++tsg.preempts;
        if (tsg.channels.empty()) return 0;  // no runlist
        if (state_.pass_preempt > 0 && state_.pass_preempt-- > 0) return 0;
        return state_.fail_preempt > 0 && state_.fail_preempt-- > 0 ? -state_.preempt_error : 0;
      case 0x8008540a: {  // GET_TIMESLICE
        const std::uint32_t args[2] = {1024, 0};
        return caller.write(argument, args) ? 0 : -EFAULT;
      }
      default:
        return -ENOTTY;
    }
  }

 private:
  NvgpuState& state_;
  const int id_;
};

class Ctrl final : public File {
 public:
  explicit Ctrl(NvgpuState& state) : state_(state) {}
  std::string link() const override { return kCtrl; }
  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    if (command == 0xc0184709) {  // OPEN_TSG of r36; r35's size is another number
      std::uint32_t args[6];
      if (!caller.read(argument, args)) return -EFAULT;
      if (args[1] != 0 || args[2] != 0 || args[3] != 0 || args[4] != 0 || args[5] != 0)
        return -EINVAL;
      const auto tsg = std::make_shared<Tsg>(state_, ++state_.last);
      const int fd = caller.install(tsg);
      tsg->named = fd;
      return reply(caller, argument, fd);
    }
    if (command == 0xc004470b)  // OPEN_CHANNEL
      return reply(caller, argument,
                   caller.install(std::make_shared<Channel>(state_, ++state_.last)));
    return -ENOTTY;
  }

 private:
  static long reply(Caller& caller, std::uint64_t argument, int fd) {
    if (fd < 0) return fd;
    return caller.write(argument, fd) ? 0 : -EFAULT;
  }
  NvgpuState& state_;
};

/// nvdla_private: one queue at most.
class Dla final : public File {
 public:
  explicit Dla(NvgpuState& state) : state_(state) {}
  ~Dla() override { release(); }
  std::string link() const override { return kDla; }
  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    switch (command) {
      case 0x40084405: {  // SET_QUEUE_STATUS
        std::uint64_t status = 0;
        if (!caller.read(argument, status)) return -EFAULT;
        if (!slot_ || (status != 1 && status != 2)) return -EINVAL;
        if (state_.gone) return -ENODEV;
        ++state_.dla_commands;
        state_.slot_suspended[*slot_] = status == 1;
        return 0;
      }
      case 0xc0104407: {  // GET_QUEUE_STATUS
        struct {
          std::uint32_t id, reserved;
          std::uint64_t fence;
        } args{};
        const std::uint32_t fence[8] = {};
        if (!slot_) return -EINVAL;
        if (!caller.read(argument, args) || !caller.write(args.fence, fence)) return -EFAULT;
        args.id = static_cast<std::uint32_t>(*slot_);
        return caller.write(argument, args) ? 0 : -EFAULT;
      }
      case 0x4409: {  // ALLOC_QUEUE
        const auto free = std::find(state_.slot_used.begin(), state_.slot_used.end(), false);
        if (slot_ || free == state_.slot_used.end()) return slot_ ? -EINVAL : -EAGAIN;
        *free = true;
        slot_ = static_cast<std::size_t>(free - state_.slot_used.begin());
        return 0;
      }
      case 0x440a:  // RELEASE_QUEUE
        if (!slot_) return -EINVAL;
        release();
        return 0;
      default:
        return -ENOTTY;
    }
  }

 private:
  /// Without a RESUME: whether the firmware forgets is unknown, so it does not.
  void release() {
    if (slot_) state_.slot_used[*slot_] = false;
    slot_.reset();
  }
  NvgpuState& state_;
  std::optional<std::size_t> slot_;
};

}  // namespace

int NvgpuState::disabled() const {
  return static_cast<int>(
      std::count_if(tsgs.begin(), tsgs.end(), [](const auto& tsg) { return !tsg.second.enabled; }));
}

int NvgpuState::suspended_slots() const {
  return static_cast<int>(std::count(slot_suspended.begin(), slot_suspended.end(), true));
}

bool Nvgpu::has(const std::string& node) const {
  return node == kCtrl || node == kDla || node == kTsgNode;
}

std::shared_ptr<File> Nvgpu::open(const std::string& node) {
  if (state_.gone) return nullptr;
  if (node == kCtrl) return std::make_shared<Ctrl>(state_);
  return node == kDla ? std::make_shared<Dla>(state_) : nullptr;
}

}  // namespace devices
