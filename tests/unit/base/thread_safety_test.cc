// SPDX-License-Identifier: Apache-2.0
#include "base/thread_safety.h"

#include <thread>

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

namespace xauto {
namespace {

/// What becomes of a process whose second thread calls it.
int status_after_call_by_another(const OneThread& thread) {
  int status = -1;
  std::thread another([&] {
    const pid_t child = fork();  // the child's only thread is this one
    if (child == 0) {
      thread.check();
      _exit(0);
    }
    EXPECT_EQ(waitpid(child, &status, 0), child);
  });
  another.join();
  return status;
}

TEST(OneThread, AnotherOnesCallIsABug) {
#ifdef NDEBUG
  GTEST_SKIP() << "not checked in this build";
#endif
  OneThread thread;
  thread.check();
  thread.check();
  const int status = status_after_call_by_another(thread);
  EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGABRT) << status;
}

TEST(OneThread, WhoCallsFirstOwnsItAndTheNextOneAfterItWasGivenAway) {
  OneThread thread;
  EXPECT_EQ(status_after_call_by_another(thread), 0);
  thread.check();
  thread.give_away();
  EXPECT_EQ(status_after_call_by_another(thread), 0);
}

}  // namespace
}  // namespace xauto
