// SPDX-License-Identifier: Apache-2.0
#include "base/pi_mutex.h"

#include <mutex>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace xauto {
namespace {

TEST(PiMutex, OneThreadAtATimeIsInside) {
  PiMutex mutex;
  long count = 0;  // no atomic: a data race for TSan if two are inside
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([&] {
      for (int i = 0; i < 20'000; ++i) {
        const std::lock_guard lock(mutex);
        const long seen = count;
        if (i % 64 == 0) std::this_thread::yield();  // so that others come and wait
        count = seen + 1;
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(count, 80'000);
}

TEST(PiMutex, WhoWaitsGetsItWhenTheOwnerLeaves) {
  PiMutex mutex;
  int value = 0;
  mutex.lock();
  std::thread waiter([&] {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(value, 1);
  });
  usleep(20'000);  // it sleeps by now, most of the time
  value = 1;
  mutex.unlock();
  waiter.join();
}

TEST(PiMutex, TheThreadsIdIsForgottenInTheChildOfAFork) {
#ifdef __SANITIZE_THREAD__
  GTEST_SKIP() << "ThreadSanitizer allows no threads in the child of a fork";
#endif
  PiMutex mutex;
  mutex.lock();  // this thread's id is known from here on
  mutex.unlock();
  const pid_t child = fork();
  if (child == 0) {
    PiMutex own;
    own.lock();
    std::thread waiter(
        [&] { const std::lock_guard lock(own); });  // asks the kernel who the owner is
    usleep(20'000);
    own.unlock();
    waiter.join();
    _exit(0);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace xauto
