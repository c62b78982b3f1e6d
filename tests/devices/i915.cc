// SPDX-License-Identifier: Apache-2.0
// Numbers and offsets are written here again, not taken from <drm/i915_drm.h>.
#include "i915.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace devices {
namespace {

constexpr const char* kDevice = "/sys/bus/pci/drivers/i915/0000:00:02.0";
constexpr const char* kNode = "/dev/dri/renderD128";

class RenderNode final : public File {
 public:
  explicit RenderNode(I915State& state) : state_(state) {}
  /// A file's contexts and requests go with it.
  ~RenderNode() override {
    for (auto* all : {&state_.contexts, &state_.requests})
      std::erase_if(*all, [&](const auto& entry) { return entry.first.first == this; });
  }
  std::string link() const override { return kNode; }

  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    // DRM takes other sizes than its own: what is missing is 0, what is more is not looked at.
    std::uint8_t args[128] = {};
    const std::size_t size = std::min<std::size_t>(command >> 16 & 0x3fff, sizeof args);
    if ((command >> 8 & 0xff) != 'd') return -ENOTTY;
    if (!caller.read(argument, args, size)) return -EFAULT;
    long done = -EINVAL;
    switch (command & 0xff) {
      case 0x00:
        done = version(caller, args);
        break;
      case 0x46: {
        const std::int32_t value = state_.scheduler;
        if (get<std::int32_t>(args, 0) == 41)
          done = caller.write(get<std::uint64_t>(args, 8), value) ? 0 : -EFAULT;
        break;
      }
      case 0x6d: {
        if ((get<std::uint32_t>(args, 4) & ~1u) != 0) break;
        std::uint32_t id = 1;
        while (state_.contexts.contains({this, id})) ++id;
        state_.contexts[{this, id}] = 0;
        std::memcpy(args, &id, sizeof id);
        done = 0;
        break;
      }
      case 0x6e:
        if (get<std::uint32_t>(args, 4) != 0) break;
        done = state_.contexts.erase({this, get<std::uint32_t>(args, 0)}) > 0 ? 0 : -ENOENT;
        break;
      case 0x69:
        done = queue(caller, args);
        break;
      case 0x6c:  // GEM_WAIT: the object's request is done, as far as this program goes
        done = state_.requests.erase({this, get<std::uint32_t>(args, 0)}) > 0 ? 0 : -ENOENT;
        break;
      case 0x74:
      case 0x75:
        done = parameter(args, (command & 0xff) == 0x75);
        break;
    }
    if (done == 0 && (command >> 31) != 0 && !caller.write(argument, args, size)) return -EFAULT;
    return done;
  }

 private:
  template <class T>
  static T get(const std::uint8_t* args, std::size_t at) {
    T value;
    std::memcpy(&value, args + at, sizeof value);
    return value;
  }

  static long version(Caller& caller, std::uint8_t* args) {
    constexpr char kName[] = "i915";
    constexpr std::uint64_t kSize = sizeof kName - 1;
    const auto room = get<std::uint64_t>(args, 16), to = get<std::uint64_t>(args, 24);
    if (to != 0 && !caller.write(to, kName, std::min(room, kSize))) return -EFAULT;
    std::memcpy(args + 16, &kSize, sizeof kSize);
    return 0;
  }

  int* priority(std::uint32_t context) {
    if (context == 0) return &default_;
    const auto it = state_.contexts.find({this, context});
    return it == state_.contexts.end() ? nullptr : &it->second;
  }

  long queue(Caller& caller, const std::uint8_t* args) {
    const int* const of = priority(get<std::uint32_t>(args, 48));
    std::uint32_t object = 0;
    if (of == nullptr) return -ENOENT;
    if (get<std::uint32_t>(args, 8) == 0) return -EINVAL;
    if (!caller.read(get<std::uint64_t>(args, 0), object)) return -EFAULT;
    const bool below = std::any_of(state_.requests.begin(), state_.requests.end(),
                                   [&](const auto& entry) { return entry.second < *of; });
    const bool above = std::any_of(state_.requests.begin(), state_.requests.end(),
                                   [&](const auto& entry) { return entry.second >= *of; });
    state_.preemptions += below && !above ? 1 : 0;
    state_.requests[{this, object}] = *of;
    return 0;
  }

  long parameter(std::uint8_t* args, bool set) {
    int* const of = priority(get<std::uint32_t>(args, 0));
    if (of == nullptr) return -ENOENT;
    if (get<std::uint64_t>(args, 8) != 6) return -EINVAL;
    const std::int64_t now = *of, value = get<std::int64_t>(args, 16);
    if (!set) {
      std::memset(args + 4, 0, 4);
      std::memcpy(args + 16, &now, sizeof now);
      return 0;
    }
    if (state_.fail > 0 && state_.fail-- > 0) return -state_.error;
    if (get<std::uint32_t>(args, 4) != 0) return -EINVAL;
    if ((state_.scheduler & 2) == 0) return -ENODEV;
    if (value > 1023 || value < -1023) return -EINVAL;
    if (value > 0 && !state_.nice) return -EPERM;
    ++state_.changes;
    *of = static_cast<int>(value);
    return 0;
  }

  I915State& state_;
  int default_ = 0;
};

}  // namespace

int I915State::preempted() const {
  int most = -1024;
  for (const auto& [name, priority] : requests) most = std::max(most, priority);
  return static_cast<int>(std::count_if(requests.begin(), requests.end(),
                                        [&](const auto& entry) { return entry.second < most; }));
}

bool I915::has(const std::string& node) const {
  return node == kDevice || node == kNode;
}

std::shared_ptr<File> I915::open(const std::string& node) {
  return node == kNode ? std::make_shared<RenderNode>(state_) : nullptr;
}

}  // namespace devices
