// SPDX-License-Identifier: Apache-2.0
// libxauto_watch.so, see watch.h. A call goes on to libc's ioctl; what it has answered is read. It
// takes a lock only for the few calls that make or free objects. A child that forks has what its
// parent had.
#include <algorithm>
#include <atomic>
#include <cstdarg>
#include <map>
#include <utility>
#include <vector>

#include <dlfcn.h>
#include <linux/ioctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/mutex.h"
#include "kernel/descriptor.h"
#include "kernel/i915.h"
#include "kernel/kfd.h"
#include "kernel/rm.h"
#include "kernel/watch/watch.h"

namespace {

namespace i915 = xauto::kernel::i915;
namespace kfd = xauto::kernel::kfd;
namespace rm = xauto::kernel::rm;

using xauto::Lock;
using xauto::Mutex;
using xauto::kernel::leads_to;

/// The objects of RM that say what a channel is.
class Objects {
 public:
  void made(int fd, std::uint32_t client, std::uint32_t parent, std::uint32_t object,
            std::uint32_t type) {
    const bool root =
        type == rm::kRoot || type == rm::kRootNonPrivileged || type == rm::kRootClient;
    const bool channel = rm::is_channel(type);
    if (!root && !channel && type != rm::kDevice && type != rm::kSubdevice &&
        type != rm::kChannelGroup)
      return;
    if (root && !leads_to(fd, rm::kControlNode)) return;
    const Lock lock(mutex_);
    if (root) {
      clients_[object] = {.fd = fd};
      return;
    }
    if (const auto it = clients_.find(client); it != clients_.end())
      it->second.objects[object] = {parent, type, ++made_};
  }

  void freed(std::uint32_t client, std::uint32_t object) {
    const Lock lock(mutex_);
    if (client == object)
      clients_.erase(client);
    else if (const auto it = clients_.find(client); it != clients_.end())
      it->second.free(object);
  }

  std::size_t list(xauto_watched_channel* to, std::size_t room) {
    const Lock lock(mutex_);
    std::erase_if(clients_,
                  [](const auto& entry) { return !leads_to(entry.second.fd, rm::kControlNode); });
    std::size_t n = 0;
    for (const auto& [number, client] : clients_)
      for (const auto& [handle, object] : client.objects) {
        if (!rm::is_channel(object.type)) continue;
        const Object* parent = client.find(object.parent);
        const bool grouped = parent != nullptr && parent->type == rm::kChannelGroup;
        const std::uint32_t device = grouped ? parent->parent : object.parent;
        const auto subdevice =
            std::find_if(client.objects.begin(), client.objects.end(), [&](const auto& entry) {
              return entry.second.type == rm::kSubdevice && entry.second.parent == device;
            });
        if (subdevice == client.objects.end()) continue;
        if (n < room)
          to[n] = {client.fd,        number,
                   subdevice->first, grouped ? object.parent : handle,
                   handle,           grouped ? parent->made : object.made};
        ++n;
      }
    return n;
  }

 private:
  struct Object {
    std::uint32_t parent, type, made;
  };
  struct Client {
    int fd = -1;
    std::map<std::uint32_t, Object> objects = {};
    [[nodiscard]] const Object* find(std::uint32_t handle) const {
      const auto it = objects.find(handle);
      return it == objects.end() ? nullptr : &it->second;
    }
    /// With all that is below it.
    void free(std::uint32_t handle) {
      objects.erase(handle);
      std::vector<std::uint32_t> children;
      for (const auto& [child, object] : objects)
        if (object.parent == handle) children.push_back(child);
      for (const std::uint32_t child : children) free(child);
    }
  };
  Mutex mutex_;
  std::uint32_t made_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::map<std::uint32_t, Client> clients_ XAUTO_GUARDED_BY(mutex_);
};

/// Never destroyed: threads of other libraries call ioctl until the very end.
Objects& objects() {
  static Objects& objects = *new Objects;
  return objects;
}

template <class T>
void saw_alloc(int fd, const T& args) {
  if (args.status == rm::kOk) objects().made(fd, args.root, args.parent, args.object, args.type);
}

void saw_rm(int fd, unsigned number, std::size_t size, const void* argument) {
  if (number == rm::kTransfer && size == sizeof(rm::Transfer)) {
    const auto& transfer = *static_cast<const rm::Transfer*>(argument);
    if (transfer.command != rm::kTransfer)
      saw_rm(fd, transfer.command, transfer.size, reinterpret_cast<const void*>(transfer.argument));
  } else if (number == rm::kAlloc && size == sizeof(rm::Alloc)) {
    saw_alloc(fd, *static_cast<const rm::Alloc*>(argument));
  } else if (number == rm::kAlloc && size == sizeof(rm::AllocWithRights)) {
    saw_alloc(fd, *static_cast<const rm::AllocWithRights*>(argument));
  } else if (number == rm::kFree && size == sizeof(rm::Free)) {
    const auto& args = *static_cast<const rm::Free*>(argument);
    if (args.status == rm::kOk) objects().freed(args.root, args.object);
  }
}

/// What amdkfd was told of its queues.
class Queues {
 public:
  void made(int fd, const kfd::CreateQueue& args) {
    if (!leads_to(fd, kfd::kNode)) return;
    const Lock lock(mutex_);
    queues_[args.queue] = {
        fd, args.queue, args.ring_address, args.ring_size, args.percentage, args.priority,
        0,  ++made_};
  }

  void updated(const kfd::UpdateQueue& args) {
    const Lock lock(mutex_);
    const auto it = queues_.find(args.queue);
    if (it == queues_.end()) return;
    xauto_watched_kfd_queue& queue = it->second;
    queue = {queue.fd,        args.queue,    args.ring_address, args.ring_size,
             args.percentage, args.priority, queue.updates + 1, queue.made};
  }

  void destroyed(std::uint32_t queue) {
    const Lock lock(mutex_);
    queues_.erase(queue);
  }

  std::size_t list(xauto_watched_kfd_queue* to, std::size_t room) {
    const Lock lock(mutex_);
    std::erase_if(queues_,
                  [](const auto& entry) { return !leads_to(entry.second.fd, kfd::kNode); });
    std::size_t n = 0;
    for (const auto& [id, queue] : queues_) {
      if (n < room) to[n] = queue;
      ++n;
    }
    return n;
  }

 private:
  Mutex mutex_;
  std::uint32_t made_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::map<std::uint32_t, xauto_watched_kfd_queue> queues_ XAUTO_GUARDED_BY(mutex_);
};

Queues& queues() {
  static Queues& queues = *new Queues;
  return queues;
}

void saw_kfd(int fd, unsigned number, std::size_t size, const void* argument) {
  if (number == kfd::kCreateQueue && size >= sizeof(kfd::CreateQueue))
    queues().made(fd, *static_cast<const kfd::CreateQueue*>(argument));
  else if (number == kfd::kUpdateQueue && size >= sizeof(kfd::UpdateQueue))
    queues().updated(*static_cast<const kfd::UpdateQueue*>(argument));
  else if (number == kfd::kDestroyQueue && size >= sizeof(kfd::DestroyQueue))
    queues().destroyed(static_cast<const kfd::DestroyQueue*>(argument)->queue);
}

/// The contexts of i915's files. A file that is closed takes its own with it, and nobody is told:
/// what another file has got its number for is i915's or not by its link.
class Contexts {
 public:
  void made(int fd, std::uint32_t id) {
    xauto_watched_i915_context context{fd, id, 0, {}};
    const std::string_view node = xauto::kernel::link_of(fd, context.node, sizeof context.node);
    if (!node.starts_with(i915::kFolder) || !i915::is_i915(fd, ask)) return;
    context.node[node.size()] = 0;
    const Lock lock(mutex_);
    context.made = ++made_;
    contexts_[{fd, id}] = context;
  }

  void destroyed(int fd, std::uint32_t id) {
    const Lock lock(mutex_);
    contexts_.erase({fd, id});
  }

  std::size_t list(xauto_watched_i915_context* to, std::size_t room) {
    const Lock lock(mutex_);
    std::erase_if(contexts_,
                  [](const auto& entry) { return !leads_to(entry.second.fd, entry.second.node); });
    std::size_t n = 0;
    for (const auto& [key, context] : contexts_) {
      if (n < room) to[n] = context;
      ++n;
    }
    return n;
  }

 private:
  static long ask(int fd, unsigned long request, void* argument) {
    return syscall(SYS_ioctl, fd, request, argument);
  }
  Mutex mutex_;
  std::uint32_t made_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::map<std::pair<int, std::uint32_t>, xauto_watched_i915_context> contexts_
      XAUTO_GUARDED_BY(mutex_);
};

Contexts& contexts() {
  static Contexts& contexts = *new Contexts;
  return contexts;
}

void saw_drm(int fd, unsigned number, std::size_t size, const void* argument) {
  if (size < sizeof(i915::Context)) return;
  if (number == i915::kCreate)
    contexts().made(fd, static_cast<const i915::Context*>(argument)->id);
  else if (number == i915::kDestroy)
    contexts().destroyed(fd, static_cast<const i915::Context*>(argument)->id);
}

using Ioctl = int (*)(int, unsigned long, ...);

/// libc's, or who else stands before it.
Ioctl next_ioctl() {
  static std::atomic<Ioctl> next{nullptr};
  Ioctl found = next.load(std::memory_order_relaxed);
  if (found == nullptr) {
    found = reinterpret_cast<Ioctl>(dlsym(RTLD_NEXT, "ioctl"));
    next.store(found, std::memory_order_relaxed);
  }
  return found;
}

}  // namespace

extern "C" {

__attribute__((visibility("default"))) int ioctl(int fd, unsigned long request, ...) {
  va_list arguments;
  va_start(arguments, request);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  const Ioctl next = next_ioctl();
  const int result = next != nullptr ? next(fd, request, argument)
                                     : static_cast<int>(syscall(SYS_ioctl, fd, request, argument));
  // A foreign error's argument says nothing.
  if (result == 0 && _IOC_TYPE(request) == 'F' && _IOC_DIR(request) == (_IOC_READ | _IOC_WRITE))
    saw_rm(fd, _IOC_NR(request), _IOC_SIZE(request), argument);
  if (result == 0 && _IOC_TYPE(request) == kfd::kType)
    saw_kfd(fd, _IOC_NR(request), _IOC_SIZE(request), argument);
  if (result == 0 && _IOC_TYPE(request) == i915::kType)
    saw_drm(fd, _IOC_NR(request), _IOC_SIZE(request), argument);
  return result;
}

__attribute__((visibility("default"))) std::size_t xauto_watched_channels_1(
    xauto_watched_channel* to, std::size_t room) {
  return objects().list(to, room);
}

__attribute__((visibility("default"))) std::size_t xauto_watched_kfd_queues_1(
    xauto_watched_kfd_queue* to, std::size_t room) {
  return queues().list(to, room);
}

__attribute__((visibility("default"))) std::size_t xauto_watched_i915_contexts_1(
    xauto_watched_i915_context* to, std::size_t room) {
  return contexts().list(to, room);
}

__attribute__((visibility("default"))) void xauto_watched_client_is_gone_1(std::uint32_t client) {
  objects().freed(client, client);
}
}
