// SPDX-License-Identifier: Apache-2.0
// xauto/cuda.h and xauto/cuda_graph.h by levels, against CUDA as its guide describes it (tests/nvidia/fake.h): a GPU
// runs the blocks that have begun to their end, then those of the stream with the greatest priority.
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/cuda_graph.h>

#include "xpu/callbacks.h"
#include "xpu/levels.h"

#include "fake.h"

namespace {

using xauto::ErrorCode;
using xauto::SchedHandle;
using xauto::Status;
using xauto::cuda::Context;
using xauto::cuda::Graph;

void expect_nothing_left() {
  const fake::Alive left = fake::alive();
  EXPECT_EQ(left.contexts, 0);
  EXPECT_EQ(left.streams, 0);
  EXPECT_EQ(left.graphs, 0);
}

/// As the runtime does it.
Status take(Context& context, int level) {
  return context.handle().callbacks()->take(level);
}

TEST(CudaLevels, WithoutThemEachHasAContextOfItsOwnThatIsSuspended) {
  {
    const auto one = Context::create(0), two = Context::create(0);
    EXPECT_NE((*one)->get(), (*two)->get());
    EXPECT_EQ((*one)->handle(), SchedHandle::cuda_context((*one)->get()));
  }
  expect_nothing_left();
}

TEST(CudaLevels, AllShareTheGpusContextAndItsHighestPriorities) {
  {
    auto one = Context::create(0, 3), two = Context::create(0, 3);
    ASSERT_TRUE(one && two);
    EXPECT_EQ((*one)->get(), (*two)->get());
    EXPECT_EQ(fake::alive().contexts, 1);
    EXPECT_EQ(fake::alive().streams, 3) << "one for each level, however many XNodes there are";
    EXPECT_EQ((*one)->handle().kind(), SchedHandle::Kind::kLevels);
    for (int level = 0; level < 3; ++level) {
      ASSERT_TRUE(take(**one, level));
      EXPECT_EQ(fake::priority_of((*one)->stream()), 3 + level) << "of 0 to 5";
    }
    EXPECT_EQ(fake::priority_of((*two)->stream()), 3) << "the other is where it was";
    for (const int level : {-1, 3}) EXPECT_EQ(take(**one, level).error().code, ErrorCode::kInvalid);
    EXPECT_EQ(fake::priority_of((*one)->stream()), 5);
  }
  expect_nothing_left();
}

TEST(CudaLevels, AnInitAsksHowManyThereAre) {
  const xauto::XpuId gpu{"gpu0", xauto::XPU::GPU, 0};
  EXPECT_EQ(xauto::levels(gpu), 0);
  {
    const xauto::xpu::TellLevels tell(2);
    EXPECT_EQ(xauto::levels(gpu), 2);
    std::thread([&] { EXPECT_EQ(xauto::levels(gpu), 0); }).join();
    EXPECT_EQ((*Context::create(gpu))->handle().kind(), SchedHandle::Kind::kLevels);
  }
  EXPECT_EQ((*Context::create(gpu))->handle().kind(), SchedHandle::Kind::kCudaContext);
  expect_nothing_left();
}

TEST(CudaLevels, AGpuThatHasFewerSaysHowMany) {
  fake::set_priorities(3);
  const auto six = Context::create(0, 6);
  ASSERT_FALSE(six);
  EXPECT_NE(six.error().what.find("has 3 stream priorities"), std::string::npos)
      << six.error().what;
  EXPECT_EQ(six.error().hint, "plan with \"levels\": 3");
  fake::set_priorities(1);
  EXPECT_EQ(Context::create(0, 2).error().hint, "plan without \"levels\"");
  fake::set_priorities(6);
  EXPECT_FALSE(Context::create(1, 2)) << "no such GPU";
  expect_nothing_left();
}

/// Queues blocks that write `name` and their number; block `at` does `then` as well.
void queue(Context& context, const std::string& name, int blocks, std::vector<std::string>& log,
           int at = -1, std::function<void()> then = {}) {
  const Context::Scope scope(context);
  for (int i = 0; i < blocks; ++i)
    ASSERT_TRUE(fake::enqueue(context.stream(), [&log, name, i, at, then] {
      log.push_back(name + std::to_string(i));
      if (i == at) then();
    }));
}

TEST(CudaLevels, AMoreUrgentJobWaitsForTheBlockThatRunsAndForNoOther) {
  auto slow = Context::create(0, 2), fast = Context::create(0, 2);
  std::vector<std::string> log;
  ASSERT_TRUE(take(**slow, 0));
  ASSERT_TRUE(take(**fast, 1));
  queue(**slow, "s", 5, log, 2, [&] { queue(**fast, "f", 2, log); });
  ASSERT_TRUE((*slow)->synchronize());
  EXPECT_EQ(log, (std::vector<std::string>{"s0", "s1", "s2", "f0", "f1", "s3", "s4"}));
  log.clear();  // on one level it waits for all
  ASSERT_TRUE(take(**fast, 0));
  queue(**slow, "s", 3, log, 0, [&] { queue(**fast, "f", 1, log); });
  ASSERT_TRUE((*slow)->synchronize());
  ASSERT_TRUE((*fast)->synchronize());
  EXPECT_EQ(log, (std::vector<std::string>{"s0", "s1", "s2", "f0"}));
}

TEST(CudaLevels, AGraphIsCapturedOnceAndRunsOnTheLevelOfEachJob) {
  {
    auto slow = Context::create(0, 2), fast = Context::create(0, 2);
    std::vector<std::string> log;
    ASSERT_TRUE(take(**fast, 0));  // captured on another level than it will run on
    auto graph = Graph::capture(**fast, [&](CUstream stream) -> Status {
      for (const char* kernel : {"g0", "g1"})
        EXPECT_TRUE(fake::enqueue(stream, [&log, kernel] { log.emplace_back(kernel); }));
      return {};
    });
    ASSERT_TRUE(graph) << graph.error().to_string();
    EXPECT_TRUE(log.empty()) << "a capture runs nothing";
    EXPECT_EQ(fake::alive().graphs, 1) << "what was captured has gone, what was made of it is here";
    ASSERT_TRUE((*graph)->run());
    ASSERT_TRUE((*graph)->run());
    EXPECT_EQ(log, (std::vector<std::string>{"g0", "g1", "g0", "g1"}));
    log.clear();
    ASSERT_TRUE(take(**fast, 1));
    std::thread job;
    queue(**slow, "s", 4, log, 1, [&] {
      job = std::thread([&] { EXPECT_TRUE((*graph)->run()); });
      while (fake::queued() < 4) std::this_thread::yield();  // two of slow's, two of the graph
    });
    ASSERT_TRUE((*slow)->synchronize());
    job.join();
    EXPECT_EQ(log, (std::vector<std::string>{"s0", "s1", "g0", "g1", "s2", "s3"}));
  }
  expect_nothing_left();
}

TEST(CudaLevels, WhatCannotBeCapturedSaysSoAndLeavesTheStreamUsable) {
  {
    auto context = Context::create(0, 2);
    const auto refused = Graph::capture(**context, [](CUstream) -> Status {
      return xauto::fail(ErrorCode::kNotFound, "no weights");
    });
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().what, "no weights");
    const auto waits = Graph::capture(**context, [](CUstream stream) {
      return xauto::cuda::checked(cuStreamSynchronize(stream), "cuStreamSynchronize");
    });
    ASSERT_FALSE(waits);
    EXPECT_NE(waits.error().what.find("900"), std::string::npos);
    EXPECT_TRUE(Graph::capture(**context, [](CUstream) { return Status(); }));
  }
  expect_nothing_left();
}

}  // namespace
