// SPDX-License-Identifier: Apache-2.0
// GPUs and DLAs behind NVIDIA's drivers: what `init` returned is opaque (a CUcontext, a
// cudlaDevHandle), but what it opened in the kernel is a descriptor of this process, and that is
// what xauto.ko suspends. So the TSGs and queues that appear while `init` runs are the handle's.
#include <algorithm>
#include <map>

#include <unistd.h>

#include "base/log.h"
#include "base/pi_mutex.h"
#include "kernel/queue_control.h"
#include "kernel/queue_files.h"
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

using kernel::QueueFile;
using kernel::QueueOp;
using kernel::QueueType;

/// Contexts are shared: an `init` may return one that an earlier `init`, of any worker, has made.
class KnownContexts {
 public:
  void add(const SchedHandle& handle, const std::vector<int>& fds) {
    const Guard lock(mutex_);
    fds_[handle.value()] = fds;
  }
  std::vector<int> find(const SchedHandle& handle) const {
    const Guard lock(mutex_);
    const auto it = fds_.find(handle.value());
    return it == fds_.end() ? std::vector<int>() : it->second;
  }

 private:
  mutable PiMutex mutex_;
  std::map<std::uintptr_t, std::vector<int>> fds_ XAUTO_GUARDED_BY(mutex_);
};

KnownContexts& known_contexts() {
  static KnownContexts contexts;
  return contexts;
}

class KernelQueue final : public Backend {
 public:
  KernelQueue(QueueType type, int instance, kernel::QueueControl control)
      : type_(type), instance_(instance), control_(std::move(control)) {}

  Status before_init() override {
    XAUTO_ASSIGN(before_, ours());
    return {};
  }

  Status attach(const SchedHandle& handle) override {
    const SchedHandle::Kind kind = type_ == QueueType::kGpuTsg ? SchedHandle::Kind::kCudaContext
                                                               : SchedHandle::Kind::kCudlaDevice;
    if (handle.kind() != kind)
      return fail(ErrorCode::kInvalid,
                  type_ == QueueType::kGpuTsg ? "the scheduling handle is no CUcontext"
                                              : "the scheduling handle is no cudlaDevHandle",
                  {}, "a preemptive GPU or DLA needs the handle behind which its work is queued");
    XAUTO_ASSIGN(std::vector<QueueFile> now, ours());
    std::vector<int> fds;
    for (const QueueFile& file : now)
      if (std::find(before_.begin(), before_.end(), file) == before_.end()) fds.push_back(file.fd);
    if (fds.empty()) fds = known_contexts().find(handle);
    if (fds.empty())
      return fail(ErrorCode::kNotFound,
                  "no TSG or DLA queue of this process appeared while `init` ran, and no earlier "
                  "`init` returned this handle",
                  {}, "create the context inside `init`");
    known_contexts().add(handle, fds);
    std::vector<std::uint32_t>& handles = handles_[handle.value()];
    handles.clear();
    for (const int fd : fds) {
      XAUTO_ASSIGN(const kernel::RegisteredQueue queue, control_.register_queue(type_, fd));
      handles.push_back(queue.handle);
    }
    return {};
  }

  Status preempt(const SchedHandle& handle) override { return act(handle, XAUTO_ACTION_SUSPEND); }
  Status restore(const SchedHandle& handle) override { return act(handle, XAUTO_ACTION_RESUME); }
  Status still_wanted() override { return control_.feed_watchdog(); }

 private:
  Result<std::vector<QueueFile>> ours() const {
    XAUTO_ASSIGN(std::vector<QueueFile> files, kernel::find_queue_files(getpid()));
    std::erase_if(files, [&](const QueueFile& file) {
      return file.type != type_ || (type_ == QueueType::kDla && file.instance != instance_);
    });
    return files;
  }

  Status act(const SchedHandle& handle, xauto_action action) {
    const auto it = handles_.find(handle.value());
    if (it == handles_.end())
      return fail(ErrorCode::kInternal, "suspending a context that was never attached");
    Status done = act_on(it->second, action);
    if (done || action == XAUTO_ACTION_RESUME) return done;
    // Half a context suspended is none, and what would resume it is never called.
    (void)act_on(it->second, XAUTO_ACTION_RESUME);
    if (!told_gated_ && any_gated(it->second)) {
      told_gated_ = true;
      log::warn(
          "a GPU context does not leave the engine in time and is not preempted any more: {}; "
          "split "
          "its kernels, or plan it with \"preemptive\": false",
          done.error().to_string());
    }
    return done;
  }

  Status act_on(const std::vector<std::uint32_t>& queues, xauto_action action) {
    ops_.clear();
    for (const std::uint32_t queue : queues) ops_.push_back({action, queue, 0});
    return control_.control(ops_);
  }

  bool any_gated(const std::vector<std::uint32_t>& queues) {
    return std::any_of(queues.begin(), queues.end(), [&](std::uint32_t queue) {
      const auto info = control_.query(queue);
      return info && info->gated;
    });
  }

  const QueueType type_;
  const int instance_;
  kernel::QueueControl control_;
  std::vector<QueueFile> before_;
  std::map<std::uintptr_t, std::vector<std::uint32_t>> handles_;
  std::vector<QueueOp> ops_;
  bool told_gated_ = false;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_kernel_queue(const XpuId& xpu) {
  XAUTO_ASSIGN(kernel::QueueControl control, kernel::QueueControl::open());
  const QueueType type = xpu.type == XPU::GPU ? QueueType::kGpuTsg : QueueType::kDla;
  return std::unique_ptr<Backend>(
      std::make_unique<KernelQueue>(type, xpu.index, std::move(control)));
}

}  // namespace xauto::xpu
