// SPDX-License-Identifier: Apache-2.0
// Work that is shared among as many threads as the system gives.
#include "solver/threads.h"

#include <algorithm>
#include <atomic>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "solver/tables_run.h"

#include "../no_more_threads.h"

namespace xauto::solver {
namespace {

TEST(SolverThreads, WhatOneThrowsJoinThrows) {
  Threads threads;
  std::atomic<int> done{0};
  ASSERT_TRUE(threads.start([&] { ++done; }));
  ASSERT_TRUE(threads.start([] { throw std::runtime_error("no memory"); }));
  EXPECT_THROW(threads.join(), std::runtime_error);
  EXPECT_EQ(done, 1);
  threads.join();  // once
}

TEST(SolverThreads, WhereThreadsEndTablesAreSolvedOnThoseThatThereAre) {
  TablesOptions options;
  options.threads = 4;
  const TablesRun run(options, 1);
  std::vector<int> done(100);
  const auto work = [&](std::size_t k) { ++done[k]; };
  run.on_threads(done.size(), work);
  const NoMoreThreads none;
  run.on_threads(done.size(), work);
  EXPECT_EQ(std::count(done.begin(), done.end(), 2), 100);
}

}  // namespace
}  // namespace xauto::solver
