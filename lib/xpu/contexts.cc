// SPDX-License-Identifier: Apache-2.0
#include "xpu/contexts.h"

#include <algorithm>
#include <climits>
#include <string>

#include <unistd.h>

namespace xauto::xpu {
namespace {

using kernel::QueueFile;
using kernel::QueueType;

template <class T>
bool contains(const std::vector<T>& all, const T& one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

void add_once(std::vector<Contexts::Value>& to, Contexts::Value value) {
  if (!contains(to, value)) to.push_back(value);
}

std::vector<QueueFile> new_ones(const std::vector<QueueFile>& now,
                                const std::vector<QueueFile>& known) {
  std::vector<QueueFile> fresh;
  for (const QueueFile& file : now)
    if (!contains(known, file)) fresh.push_back(file);
  return fresh;
}

}  // namespace

bool is_open(const QueueFile& file) {
  char target[PATH_MAX];
  const ssize_t size =
      readlink(("/proc/self/fd/" + std::to_string(file.fd)).c_str(), target, sizeof target);
  return size > 0 && file.target == std::string_view(target, static_cast<std::size_t>(size));
}

Contexts& Contexts::of_this_process() {
  static Contexts contexts;
  return contexts;
}

Result<std::vector<QueueFile>> Contexts::files(Which which) {
  XAUTO_ASSIGN(std::vector<QueueFile> files, kernel::find_queue_files(getpid()));
  std::erase_if(files, [&](const QueueFile& file) {
    return file.type != which.type || file.instance != which.instance;
  });
  return files;
}

void Contexts::claim(Value handle, const std::vector<QueueFile>& files) {
  std::vector<QueueFile>& mine = files_[handle];
  std::erase_if(mine, [](const QueueFile& file) { return !is_open(file); });
  for (const QueueFile& file : files) {
    // A number that is used again is no longer whose it was.
    for (auto& [other, theirs] : files_)
      if (other != handle) std::erase(theirs, file);
    if (!contains(mine, file)) mine.push_back(file);
  }
  ++generation_;
}

Status Contexts::before_making(Which which) {
  const Guard lock(mutex_);
  XAUTO_ASSIGN(seen_[which].known, files(which));
  return {};
}

Status Contexts::made(Which which, Value handle) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  XAUTO_ASSIGN(std::vector<QueueFile> now, files(which));
  const std::vector<QueueFile> fresh = new_ones(now, seen.known);
  seen.known = std::move(now);
  if (!fresh.empty()) {
    claim(handle, fresh);
    return {};
  }
  const auto it = files_.find(handle);
  if (it != files_.end() && std::any_of(it->second.begin(), it->second.end(), is_open)) return {};
  if (which.type == QueueType::kDla && seen.known.size() == 1) {
    files_[handle] = seen.known;  // beside whoever else has it
    ++generation_;
    return {};
  }
  return fail(
      ErrorCode::kNotFound,
      "no TSG or DLA queue of this process appeared while `init` ran, and no earlier `init` "
      "returned this handle",
      {}, "create the context inside `init`");
}

/// Whose are those that nobody has seen? Of who may have opened them there is one, or they are
/// nobody's.
std::uint32_t Contexts::look_at(Which which, Seen& seen) {
  auto now = files(which);
  std::uint32_t unclaimed = 0;
  if (now) {
    const std::vector<QueueFile> fresh = new_ones(*now, seen.known);
    seen.known = std::move(*now);
    if (!fresh.empty() && seen.suspects.size() == 1)
      claim(seen.suspects.front(), fresh);
    else
      unclaimed = static_cast<std::uint32_t>(fresh.size());
  }
  seen.suspects.clear();
  for (const Value value : seen.active) add_once(seen.suspects, value);
  return unclaimed;
}

std::uint32_t Contexts::begin(Which which, Value handle, bool look) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  const std::uint32_t unclaimed = look ? look_at(which, seen) : 0;
  seen.active.push_back(handle);
  add_once(seen.suspects, handle);
  return unclaimed;
}

std::uint32_t Contexts::end(Which which, Value handle, bool look) {
  const Guard lock(mutex_);
  Seen& seen = seen_[which];
  if (const auto it = std::find(seen.active.begin(), seen.active.end(), handle);
      it != seen.active.end())
    seen.active.erase(it);
  return look ? look_at(which, seen) : 0;
}

std::vector<QueueFile> Contexts::of(Value handle) const {
  const Guard lock(mutex_);
  const auto it = files_.find(handle);
  return it == files_.end() ? std::vector<QueueFile>() : it->second;
}

bool Contexts::shared(Value handle) const {
  const Guard lock(mutex_);
  const auto mine = files_.find(handle);
  if (mine == files_.end()) return false;
  return std::any_of(files_.begin(), files_.end(), [&](const auto& other) {
    return other.first != handle &&
           std::any_of(other.second.begin(), other.second.end(),
                       [&](const QueueFile& file) { return contains(mine->second, file); });
  });
}

}  // namespace xauto::xpu
