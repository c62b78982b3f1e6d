// SPDX-License-Identifier: Apache-2.0
// Numbers and offsets are written here again, not taken from <linux/kfd_ioctl.h>.
#include "kfd.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace devices {
namespace {

class Node final : public File {
 public:
  explicit Node(KfdState& state) : state_(state) {}
  /// Its process is gone, and so are its queues.
  ~Node() override {
    std::erase_if(state_.queues, [&](const auto& entry) { return entry.second.file == this; });
  }
  std::string link() const override { return "/dev/kfd"; }

  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    // Sizes may differ: what is missing is 0, what is more is not looked at.
    std::uint8_t args[128] = {};
    const std::size_t size = std::min<std::size_t>(command >> 16 & 0x3fff, sizeof args);
    if ((command >> 8 & 0xff) != 'K') return -EINVAL;
    if (!caller.read(argument, args, size)) return -EFAULT;
    switch (command & 0xff) {
      case 0x02: {
        std::uint32_t id = 0;  // the first that is free
        while (state_.queues.contains(id)) ++id;
        KfdState::Queue& queue = state_.queues[id];
        queue.file = this;
        queue.address = get<std::uint64_t>(args, 0);
        queue.size = get<std::uint32_t>(args, 32);
        queue.percentage = get<std::uint32_t>(args, 44);
        queue.priority = get<std::uint32_t>(args, 48);
        map(queue);
        std::memcpy(args + 52, &id, sizeof id);
        return caller.write(argument, args, size) ? 0 : -EFAULT;
      }
      case 0x03:
        return state_.queues.erase(get<std::uint32_t>(args, 0)) > 0 ? 0 : -EINVAL;
      case 0x07:
        return update(args);
      default:
        return -EINVAL;
    }
  }

 private:
  template <class T>
  static T get(const std::uint8_t* args, std::size_t at) {
    T value;
    std::memcpy(&value, args + at, sizeof value);
    return value;
  }
  static void map(KfdState::Queue& queue) {
    queue.active = queue.address != 0 && queue.size != 0 && queue.percentage != 0;
  }

  long update(const std::uint8_t* args) {
    const auto address = get<std::uint64_t>(args, 0);
    const auto id = get<std::uint32_t>(args, 8), percentage = get<std::uint32_t>(args, 16),
               priority = get<std::uint32_t>(args, 20);
    const auto ring = get<std::uint32_t>(args, 12);
    ++state_.updates;
    if ((percentage & 0xff) > 100 || priority > 15) return -EINVAL;
    if ((ring & (ring - 1)) != 0) return -EINVAL;
    const auto it = state_.queues.find(id);
    if (it == state_.queues.end() || it->second.file != this) return -EFAULT;
    KfdState::Queue& queue = it->second;
    // The ring must be mapped on the GPU, in its whole length.
    if (address != 0 && ring != 0 && (address != queue.address || ring != queue.size))
      return -EFAULT;
    // The properties are written before the hardware is asked.
    queue.address = address;
    queue.size = ring;
    queue.percentage = percentage;
    queue.priority = priority;
    int& fail = percentage == 0 ? state_.fail_off : state_.fail_on;
    if (fail > 0 && fail-- > 0) return -state_.error;
    state_.taken_off += queue.active && percentage == 0 ? 1 : 0;
    map(queue);
    return 0;
  }

  KfdState& state_;
};

}  // namespace

int KfdState::active() const {
  return static_cast<int>(std::count_if(queues.begin(), queues.end(),
                                        [](const auto& queue) { return queue.second.active; }));
}

bool Kfd::has(const std::string& node) const {
  return node == "/dev/kfd";
}

std::shared_ptr<File> Kfd::open(const std::string&) {
  return std::make_shared<Node>(state_);
}

}  // namespace devices
