// SPDX-License-Identifier: Apache-2.0
#include "xpu/driver_queues.h"

#include <algorithm>
#include <map>

#include "base/clock.h"
#include "base/log.h"
#include "base/pi_mutex.h"
#include "xpu/contexts.h"

namespace xauto::xpu {
namespace {

using kernel::QueueFile;
using kernel::QueueType;

/// What a complete context opens is looked for so often at most: a look costs some 20 us.
constexpr std::int64_t kLookAgainNs = 250'000'000;

class DriverQueues final : public Backend {
 public:
  DriverQueues(QueueType type, int instance, std::unique_ptr<QueueDoor> door)
      : which_{type, type == QueueType::kDla ? instance : -1},
        again_ms_(door->again_ms()),
        door_(std::move(door)) {}

  ~DriverQueues() override { all_.leave(this); }

  void count_in(ContextCounts& counts) override { counts_ = &counts; }

  Result<Init> before_init() override {
    const auto making = std::make_shared<Contexts::Making>(all_);
    making_ = making;
    return making;
  }

  Status attach(const SchedHandle& handle) override {
    const SchedHandle::Kind kind = which_.type == QueueType::kDla ? SchedHandle::Kind::kCudlaDevice
                                                                  : SchedHandle::Kind::kCudaContext;
    if (handle.kind() != kind)
      return fail(ErrorCode::kInvalid,
                  which_.type == QueueType::kDla ? "the scheduling handle is no cudlaDevHandle"
                                                 : "the scheduling handle is no CUcontext",
                  {}, "a preemptive GPU or DLA needs the handle behind which its work is queued");
    const auto making = making_.lock();
    if (making == nullptr) return fail(ErrorCode::kInternal, "nobody looked before `init`");
    XAUTO_TRY(all_.made(*making, which_, handle.value(), this));
    const Guard lock(mutex_);
    Context& context = contexts_[handle.value()];
    if (context.stages == 0 && all_.assumed(handle.value())) count(&ContextCounts::assumed, 1);
    if (context.complete()) count(&ContextCounts::incomplete, 1);
    ++context.stages;
    return take_what_is_new();
  }

  Status preempt(const SchedHandle& handle) override {
    const Guard lock(mutex_);
    const auto it = contexts_.find(handle.value());
    if (it == contexts_.end())
      return fail(ErrorCode::kInternal, "suspending a context that was never attached");
    Context& context = it->second;
    XAUTO_TRY(refuse(handle.value(), context));
    // Looked at for the first time when it has run, it could lack what it has opened by now.
    if (!context.complete()) count(&ContextCounts::unclaimed, all_.look(which_));
    if (generation_ != all_.generation()) XAUTO_TRY(take_what_is_new());
    ++context.unseen;
    Status done = door_->suspend(handles(context));
    // One that was closed is gone, also where another has its number by now.
    if (!done && done.error().code == ErrorCode::kUnavailable &&
        renew(handle.value(), context).value_or(false))
      done = door_->suspend(handles(context));
    context.suspended = done.has_value();
    if (done) return done;
    // Half a context suspended is none, and what would resume it is never called.
    (void)door_->resume(handles(context));
    if (!context.gated && any_gated(context)) {
      context.gated = true;
      count(&ContextCounts::gated, 1);
      log::warn(
          "a GPU context does not leave the engine in time and is not preempted any more: {}; "
          "split its kernels, or plan it with \"preemptive\": false",
          done.error().to_string());
    }
    return done;
  }

  Status restore(const SchedHandle& handle) override {
    const Guard lock(mutex_);
    const auto it = contexts_.find(handle.value());
    if (it == contexts_.end())
      return fail(ErrorCode::kInternal, "resuming a context that was never attached");
    it->second.suspended = false;
    return door_->resume(handles(it->second));
  }

  Status level(const SchedHandle& handle, int level) override {
    const Guard lock(mutex_);
    const auto it = contexts_.find(handle.value());
    if (it == contexts_.end())
      return fail(ErrorCode::kInternal, "a level for a context that was never attached");
    Context& context = it->second;
    XAUTO_TRY(refuse(handle.value(), context));
    if (generation_ != all_.generation()) XAUTO_TRY(take_what_is_new());
    context.level = level;
    Status done = door_->level(handles(context), level);
    if (!done && done.error().code == ErrorCode::kUnavailable &&
        renew(handle.value(), context).value_or(false))
      done = door_->level(handles(context), level);
    return done;
  }

  Status still_wanted() override {
    const Guard lock(mutex_);
    Status wanted = door_->still_wanted();
    if (wanted || wanted.error().code != ErrorCode::kTimeout) return wanted;
    for (const auto& [value, context] : contexts_)
      if (context.suspended) XAUTO_TRY(door_->suspend(handles(context)));
    return wanted;
  }

  int again_ms(bool suspended) override {
    const Guard lock(mutex_);
    return suspended || door_->owes() ? again_ms_ : -1;
  }

  void admitted(const SchedHandle& handle, bool first) override {
    count(&ContextCounts::unclaimed, all_.begin(which_, handle.value(), first));
  }

  void finishing(const SchedHandle& handle, bool first) override {
    const std::int64_t now = now_ns();
    const bool look = first || now - looked_ns_ >= kLookAgainNs;
    if (look) looked_ns_ = now;
    count(&ContextCounts::unclaimed, all_.end(which_, handle.value(), look));
    if (!look && generation_ == all_.generation()) return;
    const Guard lock(mutex_);
    if (const Status taken = take_what_is_new(); !taken)
      log::warn("what a context has opened is not suspended with it: {}",
                taken.error().to_string());
    if (look)
      for (auto& [value, context] : contexts_) context.unseen = 0;  // they left nothing out
    Context& context = contexts_[handle.value()];
    if (first && ++context.ran == context.stages) count(&ContextCounts::incomplete, -1);
  }

 private:
  struct Queue {
    QueueFile file;
    QueueDoor::Handle handle = 0;
  };
  struct Context {
    std::vector<Queue> queues;
    int stages = 0, ran = 0;  ///< whose `init` returned it; that have run once
    int level = -1;           ///< that was told, of a driver that has levels
    int unseen = 0;           ///< suspensions since the last look at what it has opened
    bool suspended = false;
    bool gated = false, shared = false;  ///< told
    [[nodiscard]] bool complete() const { return ran >= stages; }
  };

  void count(std::atomic<std::uint32_t> ContextCounts::*what, std::int64_t by) {
    if (counts_ != nullptr && by != 0) (counts_->*what) += static_cast<std::uint32_t>(by);
  }

  Status take_what_is_new() XAUTO_REQUIRES(mutex_) {
    generation_ = all_.generation();
    Status taken;
    for (auto& [value, context] : contexts_)
      if (Status status = take_for(value, context); !status) taken = std::move(status);
    return taken;
  }

  /// What was opened while its work is suspended is suspended with it.
  Status take_for(Contexts::Value value, Context& context) XAUTO_REQUIRES(mutex_) {
    for (const QueueFile& file : all_.of(value)) {
      const bool known = std::any_of(context.queues.begin(), context.queues.end(),
                                     [&](const Queue& queue) { return queue.file == file; });
      if (known || !kernel::is_open(file)) continue;
      XAUTO_ASSIGN(const QueueDoor::Handle handle, door_->take(file));
      context.queues.push_back({file, handle});
      // It may have been there already when they came.
      count(&ContextCounts::partial, context.unseen);
      context.unseen = 0;
      if (context.suspended) XAUTO_TRY(door_->suspend({handle}));
      if (context.level >= 0) XAUTO_TRY(door_->level({handle}, context.level));
    }
    return {};
  }

  /// False: nothing has changed.
  Result<bool> renew(Contexts::Value value, Context& context) XAUTO_REQUIRES(mutex_) {
    std::vector<Queue> before = std::move(context.queues);
    context.queues.clear();
    context.unseen = 0;  // a closed one refuses at once: none succeeded since
    XAUTO_TRY(take_for(value, context));
    // Registering what is registered gives the handle that it has.
    bool changed = before.size() != context.queues.size();
    for (const Queue& queue : before) {
      const bool stays =
          std::any_of(context.queues.begin(), context.queues.end(),
                      [&](const Queue& other) { return other.handle == queue.handle; });
      if (stays) continue;
      changed = true;
      door_->give_back(queue.handle);
    }
    return changed && !context.queues.empty();
  }

  /// Suspending it would hold up another, which may be the more urgent; or is a guess.
  Status refuse(Contexts::Value value, Context& context) XAUTO_REQUIRES(mutex_) {
    if (all_.refuted(value))
      return fail(ErrorCode::kUnavailable, "its context was made before `init`, another's, too");
    if (!all_.shared(value)) return {};
    if (!context.shared) {
      context.shared = true;
      count(&ContextCounts::shared, 1);
      log::warn("two {}, so neither is scheduled on its own", which_.type == QueueType::kDla
                                                                  ? "cuDLA handles have one queue"
                                                                  : "modules have one GPU context");
    }
    return fail(ErrorCode::kUnavailable, "its queue is another's, too");
  }

  const std::vector<QueueDoor::Handle>& handles(const Context& context) XAUTO_REQUIRES(mutex_) {
    handles_.clear();
    for (const Queue& queue : context.queues) handles_.push_back(queue.handle);
    return handles_;
  }

  bool any_gated(const Context& context) XAUTO_REQUIRES(mutex_) {
    return std::any_of(context.queues.begin(), context.queues.end(),
                       [&](const Queue& queue)
                           XAUTO_REQUIRES(mutex_) { return door_->gated(queue.handle); });
  }

  Contexts& all_ = Contexts::of_this_process();
  std::weak_ptr<Contexts::Making> making_;
  const Contexts::Which which_;
  ContextCounts* counts_ = nullptr;
  std::int64_t looked_ns_ = 0;  ///< the execution thread's
  const int again_ms_;
  PiMutex mutex_;  ///< the execution thread registers, the management thread suspends
  const std::unique_ptr<QueueDoor> door_ XAUTO_GUARDED_BY(mutex_);
  std::map<Contexts::Value, Context> contexts_ XAUTO_GUARDED_BY(mutex_);
  std::vector<QueueDoor::Handle> handles_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<std::uint64_t> generation_{0};  ///< of what has been taken; written under the lock
};

}  // namespace

std::unique_ptr<Backend> over_door(const XpuId& xpu, QueueType type,
                                   std::unique_ptr<QueueDoor> door) {
  return std::make_unique<DriverQueues>(type, xpu.index, std::move(door));
}

std::unique_ptr<Backend> over_door(const XpuId& xpu, std::unique_ptr<QueueDoor> door) {
  const QueueType type = xpu.type == XPU::GPU ? QueueType::kGpuTsg : QueueType::kDla;
  return over_door(xpu, type, std::move(door));
}

}  // namespace xauto::xpu
