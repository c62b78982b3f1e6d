// SPDX-License-Identifier: Apache-2.0
#include "base/mutex.h"

#include <condition_variable>
#include <thread>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Lock, IsWhatAConditionWaitsWith) {
  Mutex mutex;
  std::condition_variable_any changed;
  bool asked = false, answered = false;
  std::thread other([&] {
    Lock lock(mutex);
    while (!asked) changed.wait(lock);
    answered = true;
    changed.notify_all();
  });
  Lock lock(mutex);
  asked = true;
  changed.notify_all();
  while (!answered) changed.wait(lock);
  lock.unlock();
  other.join();
  lock.lock();
  EXPECT_TRUE(answered);
}

}  // namespace
}  // namespace xauto
