// SPDX-License-Identifier: Apache-2.0
// What an init has made, and what became of it.
#pragma once

#include <algorithm>
#include <atomic>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace xauto::runtime {

/// What became of objects of a test's, in this order: made and gone, with the thread's name if it
/// is not the same one.
struct Fates {
  std::mutex mutex;
  std::vector<std::string> gone;
  std::atomic<int> alive{0};

  std::vector<std::string> sorted() {
    std::vector<std::string> names = gone;
    std::sort(names.begin(), names.end());
    return names;
  }
};

struct Object {
  Object(std::string n, Fates& f)
      : node(std::move(n)), fates(f), thread(std::this_thread::get_id()) {
    ++fates.alive;
  }
  ~Object() {
    --fates.alive;
    const std::lock_guard lock(fates.mutex);
    fates.gone.push_back(node + (thread == std::this_thread::get_id() ? "" : " elsewhere"));
  }
  std::string node;
  Fates& fates;
  std::thread::id thread;
};

}  // namespace xauto::runtime
