// SPDX-License-Identifier: Apache-2.0
// Numbers and offsets are written here again, from the driver's source: a test shall not agree with
// a mistake of lib/kernel/rm.h.
#include "rm.h"

#include <cerrno>
#include <cstring>
#include <vector>

namespace devices {
namespace {

constexpr std::uint32_t kInvalidArgument = 0x1f, kInsufficientPermissions = 0x1b,
                        kInvalidClient = 0x23, kInvalidObjectHandle = 0x33, kNotSupported = 0x56,
                        kObjectNotFound = 0x57, kGpuIsLost = 0xf;

using Bytes = std::vector<std::uint8_t>;

std::uint32_t get32(const Bytes& from, std::size_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, from.data() + at, sizeof value);
  return value;
}
std::uint64_t get64(const Bytes& from, std::size_t at) {
  std::uint64_t value = 0;
  std::memcpy(&value, from.data() + at, sizeof value);
  return value;
}
void put32(Bytes& to, std::size_t at, std::uint32_t value) {
  std::memcpy(to.data() + at, &value, sizeof value);
}

class Control final : public File {
 public:
  explicit Control(RmState& state) : state_(state) {}
  /// rm_cleanup_file_private: its clients go with it.
  ~Control() override {
    std::erase_if(state_.clients, [&](const auto& entry) { return entry.second.file == this; });
  }
  std::string link() const override { return "/dev/nvidiactl"; }

  long ioctl(Caller& caller, unsigned command, std::uint64_t argument) override {
    unsigned number = command & 0xff;
    std::size_t size = command >> 16 & 0x3fff;
    if ((command >> 8 & 0xff) != 'F') return -EINVAL;
    if (number == 211) {  // NV_ESC_IOCTL_XFER_CMD
      Bytes transfer(16);
      if (size != 16) return -EINVAL;
      if (!caller.read(argument, transfer.data(), 16)) return -EFAULT;
      number = get32(transfer, 0);
      size = get32(transfer, 4);
      argument = get64(transfer, 8);
      if (size > 16384) return -EINVAL;
    }
    Bytes args(size);
    if (!caller.read(argument, args.data(), size)) return -EFAULT;
    long result = -EINVAL;  // an unknown number, or a size that is another's
    if (number == 0x2b && (size == 32 || size == 48)) {
      put32(args, size == 32 ? 28 : 40, alloc(args));
      result = 0;
    } else if (number == 0x29 && size == 16) {
      put32(args, 12, free(get32(args, 0), get32(args, 8)));
      result = 0;
    } else if (number == 0x2a && size == 32) {
      put32(args, 28, control(caller, args));
      result = 0;
    }
    return caller.write(argument, args.data(), size) ? result : -EFAULT;
  }

 private:
  std::uint32_t alloc(Bytes& args) {
    const std::uint32_t type = get32(args, 12);
    if (type == 0x0 || type == 0x1 || type == 0x41) {
      const std::uint32_t client = ++state_.last;
      state_.clients[client].file = this;
      put32(args, 8, client);
      return 0;
    }
    RmState::Client* client = nullptr;
    if (const std::uint32_t status = find(get32(args, 0), client)) return status;
    const std::uint32_t parent = get32(args, 4);
    if (parent != get32(args, 0) && !client->objects.contains(parent)) return kObjectNotFound;
    const std::uint32_t wanted = get32(args, 8), made = wanted != 0 ? wanted : ++state_.last;
    if (client->objects.contains(made)) return kInvalidArgument;
    client->objects[made] = {parent, type};
    put32(args, 8, made);
    return 0;
  }

  std::uint32_t free(std::uint32_t client_handle, std::uint32_t object) {
    RmState::Client* client = nullptr;
    if (const std::uint32_t status = find(client_handle, client)) return status;
    if (object == client_handle) {
      state_.clients.erase(client_handle);
      return 0;
    }
    if (client->objects.erase(object) == 0) return kObjectNotFound;
    std::vector<std::uint32_t> children;
    for (const auto& [handle, child] : client->objects)
      if (child.parent == object) children.push_back(handle);
    for (const std::uint32_t child : children) (void)free(client_handle, child);
    return 0;
  }

  /// Strict: a client answers on the file that made it alone.
  std::uint32_t find(std::uint32_t handle, RmState::Client*& client) {
    const auto it = state_.clients.find(handle);
    if (it == state_.clients.end()) return kInvalidObjectHandle;
    client = &it->second;
    return it->second.file == this ? 0 : kInvalidClient;
  }

  std::uint32_t control(Caller& caller, const Bytes& args) {
    RmState::Client* client = nullptr;
    if (const std::uint32_t status = find(get32(args, 0), client)) return status;
    const auto object = client->objects.find(get32(args, 4));
    if (object == client->objects.end()) return kObjectNotFound;
    if (get32(args, 8) != 0x2080110b || object->second.type != 0x2080) return kNotSupported;
    if (get32(args, 24) != 536) return kInvalidArgument;
    Bytes params(536);
    if (!caller.read(get64(args, 16), params.data(), params.size())) return kInvalidArgument;
    return disable_channels(params, object->second.parent);
  }

  /// All of them or none: what the firmware does with half a list is not known.
  std::uint32_t disable_channels(const Bytes& params, std::uint32_t device) {
    const bool disable = params[0] != 0, only_scheduling = params[8] != 0;
    ++state_.calls;
    if (get64(params, 16) != 0) return kInsufficientPermissions;
    if (state_.no_gsp) return kNotSupported;
    if (state_.lost) return kGpuIsLost;
    int& fail = disable ? state_.fail_disable : state_.fail_enable;
    if (fail > 0 && fail-- > 0) return state_.status;
    const std::uint32_t count = get32(params, 4);
    if (count == 0 || count > 64 || (disable && only_scheduling)) return kInvalidArgument;
    std::vector<RmState::Object*> channels;
    for (std::uint32_t i = 0; i < count; ++i) {
      const auto client = state_.clients.find(get32(params, 24 + 4 * i));
      if (client == state_.clients.end()) return kInvalidObjectHandle;
      const auto channel = client->second.objects.find(get32(params, 280 + 4 * i));
      if (channel == client->second.objects.end() || (channel->second.type & 0xff) != 0x6f)
        return kObjectNotFound;
      if (!below(client->second, channel->second, device)) return kInvalidArgument;
      channels.push_back(&channel->second);
    }
    for (RmState::Object* channel : channels) channel->disabled = disable;
    state_.disables += disable ? 1 : 0;
    return 0;
  }

  static bool below(const RmState::Client& client, const RmState::Object& object,
                    std::uint32_t device) {
    if (object.parent == device) return true;
    const auto parent = client.objects.find(object.parent);
    return parent != client.objects.end() && below(client, parent->second, device);
  }

  RmState& state_;
};

}  // namespace

int RmState::channels(bool disabled) const {
  int n = 0;
  for (const auto& [handle, client] : clients)
    for (const auto& [number, object] : client.objects)
      n += (object.type & 0xff) == 0x6f && object.disabled == disabled ? 1 : 0;
  return n;
}

bool Rm::has(const std::string& node) const {
  return node == "/dev/nvidiactl";
}

std::shared_ptr<File> Rm::open(const std::string&) {
  return std::make_shared<Control>(state_);
}

}  // namespace devices
