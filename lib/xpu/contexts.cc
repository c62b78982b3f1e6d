// SPDX-License-Identifier: Apache-2.0
#include "xpu/contexts.h"

#include <algorithm>
#include <optional>
#include <utility>

#include <unistd.h>

#include "base/clock.h"

namespace xauto::xpu {
namespace {

/// Longer than xauto.ko keeps what was closed: sweep_ms is 1000 at most.
constexpr std::int64_t kHiddenForNs = 2'000'000'000;

using kernel::QueueFile;
using kernel::QueueType;
using Files = Contexts::Files;

template <class T>
bool contains(const std::vector<T>& all, const T& one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

template <class T>
void add_once(std::vector<T>& to, const T& one) {
  if (!contains(to, one)) to.push_back(one);
}

void add(Files& to, const Files& more) {
  to.insert(to.end(), more.begin(), more.end());
}

Files new_ones(const Files& now, const Files& known) {
  Files fresh;
  for (const QueueFile& file : now)
    if (!contains(known, file)) fresh.push_back(file);
  return fresh;
}

Files only(const Files& files, Contexts::Which which) {
  Files kept = files;
  std::erase_if(kept, [&](const QueueFile& file) {
    return file.type != which.type || file.instance != which.instance;
  });
  return kept;
}

/// Of a machine without /proc nothing is known, and `made` will say so.
Files all_files() {
  return kernel::find_own_queues().value_or(Files());
}

}  // namespace

Contexts& Contexts::of_this_process() {
  static Contexts contexts;
  return contexts;
}

Result<Files> Contexts::files(Which which) {
  XAUTO_ASSIGN(const Files files, kernel::find_own_queues());
  return only(files, which);
}

Files Contexts::unowned(const Files& files) const {
  Files free = files;
  for (const auto& [handle, context] : contexts_)
    if (!context.refuted) free = new_ones(free, context.files);
  return free;
}

/// A number that is used again is no longer whose it was.
void Contexts::forget_closed() {
  for (auto& [handle, context] : contexts_) {
    std::erase_if(context.files, [](const QueueFile& file) { return !kernel::is_open(file); });
    if (context.files.empty()) context.assumed = context.refuted = false;
  }
}

void Contexts::claim(Value handle, const Files& files) {
  forget_closed();
  Files& mine = contexts_[handle].files;
  for (const QueueFile& file : files) {
    for (auto& [other, theirs] : contexts_)
      if (other != handle) std::erase(theirs.files, file);
    add_once(mine, file);
  }
  ++generation_;
}

// ---- made --------------------------------------------------------------------------------------

Contexts::Making::Making(Contexts& all) : all_(all), alone_(all.alone_) {
  const Guard lock(all_.mutex_);
  for (auto& [which, seen] : all_.seen_) all_.look_at(which, seen);
  all_.forget_closed();
  if (all_.making_++ == 0) all_.taken_.clear();
  before_ = all_files();
}

/// Who ran meanwhile may have opened what has appeared and was not claimed.
Contexts::Making::~Making() {
  const Guard lock(all_.mutex_);
  if (--all_.making_ > 0) return;
  const Files now = all_files();
  for (const QueueFile& file : now) (void)all_.seen_[{file.type, file.instance}];
  for (auto& [which, seen] : all_.seen_) {
    const Files mine = only(now, which);
    if (!seen.suspects.empty())
      add(seen.ambiguous, new_ones(new_ones(mine, seen.known), all_.taken_));
    seen.known = mine;
    seen.suspects.clear();
    for (const Value value : seen.active) add_once(seen.suspects, value);
  }
}

Result<bool> Contexts::Making::made(Which which, Value handle) {
  const Guard lock(all_.mutex_);
  XAUTO_ASSIGN(const Files now, files(which));
  const Files fresh = new_ones(new_ones(now, before_), all_.taken_);
  if (fresh.empty()) return false;
  all_.claim(handle, fresh);
  add(all_.taken_, fresh);
  return true;
}

Status Contexts::made(Making& making, Which which, Value handle, const void* user) {
  XAUTO_ASSIGN(const bool fresh, making.made(which, handle));
  const Guard lock(mutex_);
  XAUTO_ASSIGN(const Files now, files(which));
  seen_[which].told.clear();
  if (!fresh) XAUTO_TRY(assume(which, handle, now));
  add_once(contexts_[handle].users, user);
  return {};
}

Status Contexts::assume(Which which, Value handle, const Files& now) {
  forget_closed();
  const char* advice = "make the context in `init`, or in xauto::make_context()";
  const auto mine = contexts_.find(handle);
  bool another = mine != contexts_.end() && mine->second.refuted;
  if (mine != contexts_.end() && !mine->second.files.empty() && !another) return {};
  const Files free = unowned(now);
  if (which.type == QueueType::kDla && now.size() == 1 && free.empty()) {
    contexts_[handle].files = now;  // beside whoever else has it
    ++generation_;
    return {};
  }
  for (auto& [other, context] : contexts_)
    if (other != handle && context.assumed && !only(context.files, which).empty())
      another = context.refuted = true;
  if (another)
    return fail(ErrorCode::kNotFound,
                "its context was made before `init`, and so was that of another scheduling handle: "
                "which TSGs or DLA queues are whose is not known",
                {}, advice);
  const Files theirs = new_ones(free, seen_[which].ambiguous);
  if (theirs.empty())
    return fail(ErrorCode::kNotFound,
                "no TSG or DLA queue of this process appeared while `init` ran, no earlier `init` "
                "returned this handle, and all that are there are another's",
                {}, advice);
  claim(handle, theirs);
  contexts_[handle].assumed = true;
  return {};
}

void Contexts::leave(const void* user) {
  const Guard lock(mutex_);
  for (auto& [handle, context] : contexts_) std::erase(context.users, user);
}

// ---- opened later ------------------------------------------------------------------------------

/// TSGs that no descriptor leads to. One that is being opened has none yet, and xauto.ko keeps one
/// that was closed until it has swept: so it counts what is there for some time. When nvgpu does not
/// say, that time begins anew; what has been counted stays.
void Contexts::Hidden::look(std::size_t descriptors) {
  const std::optional<std::size_t> all = kernel::count_tsgs(getpid());
  if (!all) {
    candidate = 0;
    return;
  }
  const std::size_t now = *all - std::min(*all, descriptors);
  const std::int64_t time = now_ns();
  if (now <= count) {
    count = now;
    told = std::min(told, count);
    candidate = 0;
  } else if (candidate == 0) {
    candidate = now;
    since_ns = time;
  } else if (candidate = std::min(candidate, now); time - since_ns >= kHiddenForNs) {
    count = std::exchange(candidate, 0);
  }
}

std::uint32_t Contexts::Hidden::untold() {
  return static_cast<std::uint32_t>(count - std::exchange(told, count));
}

/// Whose are those that nobody has seen? Of who may have opened them there is one, or they are
/// nobody's. While a context is made that is left to the look after it.
void Contexts::look_at(Which which, Seen& seen) {
  if (making_ > 0) return;
  forget_closed();
  if (auto now = files(which)) {
    const Files fresh = new_ones(*now, seen.known);
    seen.known = std::move(*now);
    std::erase_if(seen.ambiguous, [&](const QueueFile& file) { return !kernel::is_open(file); });
    if (!fresh.empty() && seen.suspects.size() == 1) claim(seen.suspects.front(), fresh);
    if (seen.suspects.size() > 1) add(seen.ambiguous, fresh);
    if (which.type == QueueType::kGpuTsg) seen.hidden.look(seen.known.size());
  }
  seen.suspects.clear();
  for (const Value value : seen.active) add_once(seen.suspects, value);
}

std::uint32_t Contexts::untold(Seen& seen) const {
  Files free = unowned(seen.known);
  const Files fresh = new_ones(free, seen.told);
  seen.told = std::move(free);
  return static_cast<std::uint32_t>(fresh.size()) + seen.hidden.untold();
}

std::uint32_t Contexts::begin(Which which, Value handle, bool look) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  const bool looked = look || !seen.first.empty();
  if (looked) look_at(which, seen);
  if (look) seen.first.push_back(handle);
  seen.active.push_back(handle);
  add_once(seen.suspects, handle);
  return looked ? untold(seen) : 0;
}

std::uint32_t Contexts::end(Which which, Value handle, bool look) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  const bool looked = look || !seen.first.empty();
  for (std::vector<Value>* of : {&seen.active, &seen.first})
    if (const auto it = std::find(of->begin(), of->end(), handle); it != of->end()) of->erase(it);
  if (looked) look_at(which, seen);
  return looked ? untold(seen) : 0;
}

std::uint32_t Contexts::look(Which which) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  look_at(which, seen);
  return untold(seen);
}

// ---- asked -------------------------------------------------------------------------------------

Files Contexts::of(Value handle) const {
  const Guard lock(mutex_);
  const auto it = contexts_.find(handle);
  return it == contexts_.end() ? Files() : it->second.files;
}

bool Contexts::shared(Value handle) const {
  const Guard lock(mutex_);
  const auto mine = contexts_.find(handle);
  if (mine == contexts_.end()) return false;
  if (mine->second.users.size() > 1) return true;
  return std::any_of(contexts_.begin(), contexts_.end(), [&](const auto& other) {
    return other.first != handle &&
           std::any_of(other.second.files.begin(), other.second.files.end(),
                       [&](const QueueFile& file) { return contains(mine->second.files, file); });
  });
}

bool Contexts::assumed(Value handle) const {
  const Guard lock(mutex_);
  const auto it = contexts_.find(handle);
  return it != contexts_.end() && it->second.assumed;
}

bool Contexts::refuted(Value handle) const {
  const Guard lock(mutex_);
  const auto it = contexts_.find(handle);
  return it != contexts_.end() && it->second.refuted;
}

}  // namespace xauto::xpu
