// SPDX-License-Identifier: Apache-2.0
#include "kernel/i915_contexts.h"

#include <cerrno>
#include <cstring>
#include <optional>
#include <string>

#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "kernel/i915.h"
#include "kernel/watched.h"

namespace xauto::kernel {
namespace {

auto* list_contexts() {
  static auto* const list =
      watch_function<decltype(xauto_watched_i915_contexts_1)>("xauto_watched_i915_contexts_1");
  return list;
}

QueueFile file_of(const xauto_watched_i915_context& context) {
  return {context.fd, QueueType::kI915Context, -1,
          "i915:" + std::to_string(context.context) + ":" + std::to_string(context.made)};
}

std::optional<xauto_watched_i915_context> find_context(const QueueFile& file) {
  for (const xauto_watched_i915_context& context : all_watched(list_contexts()))
    if (file_of(context) == file) return context;
  return std::nullopt;
}

/// 0, or a positive errno. Not through libxauto_watch.so, which need not know.
int ask(int fd, unsigned long request, void* argument) {
  long result;
  do result = syscall(SYS_ioctl, fd, request, argument);
  while (result < 0 && (errno == EINTR || errno == EAGAIN));
  return result < 0 ? errno : 0;
}

std::int32_t scheduler_of(int fd) {
  std::int32_t has = 0;
  i915::Get get{i915::kHasScheduler, &has};
  return ask(fd, i915::kGetCall, &get) == 0 ? has : 0;
}

int set_priority(int fd, std::uint32_t context, int priority) {
  i915::Parameter args{.context = context,
                       .size = 0,
                       .parameter = i915::kPriority,
                       .value = static_cast<std::uint64_t>(std::int64_t{priority})};
  return ask(fd, i915::kSetParameterCall, &args);
}

/// Three buckets: below, at and above 0, however far. Otherwise up to 0, which nobody is refused.
int priority_of(int level, bool three_buckets) {
  return three_buckets ? (level - 1) * 512 : i915::kLeastPriority + level;
}

/// As a context of its own is answered.
bool may_have_most(int fd) {
  i915::Context context{};
  if (ask(fd, i915::kCreateCall, &context) != 0) return false;
  const bool may = set_priority(fd, context.id, priority_of(2, true)) == 0;
  (void)ask(fd, i915::kDestroyCall, &context);
  return may;
}

tl::unexpected<Error> not_set(const QueueFile& file, int error) {
  if (error == EBADF || error == ENOENT)
    return fail(ErrorCode::kUnavailable, "is gone", file.target);
  if (error == EPERM)
    return fail(ErrorCode::kPermission, "may not have a priority above 0", file.target,
                "give the process CAP_SYS_NICE, or plan with \"levels\": 2");
  const bool lost = error == ENODEV || error == EIO;
  return fail(lost ? ErrorCode::kUnavailable : ErrorCode::kIo,
              std::string("CONTEXT_SETPARAM: ") + std::strerror(error), file.target,
              lost ? "the GPU is wedged or gone: see the kernel's log" : "");
}

}  // namespace

bool i915_is_watched() {
  return list_contexts() != nullptr;
}

std::vector<QueueFile> find_i915_contexts() {
  std::vector<QueueFile> files;
  for (const xauto_watched_i915_context& context : all_watched(list_contexts()))
    files.push_back(file_of(context));
  return files;
}

int i915_levels() {
  for (int i = 0; i < i915::kRenders; ++i) {
    const std::string node =
        std::string(i915::kFolder) + "renderD" + std::to_string(i915::kFirstRender + i);
    const UniqueFd fd(open(node.c_str(), O_RDWR | O_CLOEXEC));
    if (!fd || !i915::is_i915(fd.get(), ask)) continue;
    const std::int32_t has = scheduler_of(fd.get());
    if ((has & i915::kPriorities) == 0 || (has & i915::kPreemption) == 0) return 0;
    if ((has & i915::kThreeBuckets) == 0) return 1 - i915::kLeastPriority;
    return may_have_most(fd.get()) ? 3 : 2;
  }
  return 0;
}

Result<I915Contexts::Handle> I915Contexts::take(const QueueFile& file) {
  for (const auto& [handle, known] : contexts_)
    if (known.file == file) return handle;
  const auto now = find_context(file);
  if (!now) return fail(ErrorCode::kUnavailable, "is no i915 context of this process", file.target);
  const Duplicate copy(now->fd, now->node);
  Context context{.file = file};
  if (copy) {
    i915::Parameter args{
        .context = now->context, .size = 0, .parameter = i915::kPriority, .value = 0};
    if (ask(copy.get(), i915::kGetParameterCall, &args) == 0)
      context.given = static_cast<int>(static_cast<std::int64_t>(args.value));
    context.three_buckets = (scheduler_of(copy.get()) & i915::kThreeBuckets) != 0;
  }
  contexts_.emplace(++last_, context);
  return last_;
}

void I915Contexts::give_back(Handle handle) {
  const Context& context = contexts_.at(handle);
  if (const auto now = find_context(context.file))
    if (const Duplicate copy(now->fd, now->node); copy)
      (void)set_priority(copy.get(), now->context, context.given);
  contexts_.erase(handle);
}

Status I915Contexts::level(Handle handle, int level) {
  const Context& context = contexts_.at(handle);
  const int priority = priority_of(level, context.three_buckets);
  if (level < 0 || priority > (context.three_buckets ? priority_of(2, true) : 0))
    return fail(ErrorCode::kInvalid, "i915 has no level " + std::to_string(level),
                context.file.target, "plan with as many \"levels\" as `xauto doctor` says");
  const auto now = find_context(context.file);
  if (!now) return not_set(context.file, EBADF);
  const Duplicate copy(now->fd, now->node);
  const int error = copy ? set_priority(copy.get(), now->context, priority) : EBADF;
  if (error != 0) return not_set(context.file, error);
  return {};
}

I915Contexts::~I915Contexts() {
  while (!contexts_.empty()) give_back(contexts_.begin()->first);
}

}  // namespace xauto::kernel
