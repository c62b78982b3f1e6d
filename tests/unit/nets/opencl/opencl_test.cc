// SPDX-License-Identifier: Apache-2.0
// xauto/opencl.h on whatever OpenCL device this machine has (PoCL, where it has none), against plain C++.
#include <cstdint>
#include <numeric>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/opencl.h>
#include <xauto/testing.h>

namespace {

using xauto::ErrorCode;
using xauto::Status;
using xauto::opencl::Buffer;
using xauto::opencl::Session;

constexpr const char* kSource = R"cl(
__kernel void scale(__global const int* in, __global int* out, const int factor) {
  out[get_global_id(0)] = factor * in[get_global_id(0)] + ADDED;
}
__kernel void transpose(__global const int* in, __global int* out) {
  const size_t x = get_global_id(0), y = get_global_id(1);
  out[x * get_global_size(1) + y] = in[y * get_global_size(0) + x];
}
)cl";

class OpenCl : public testing::Test {
 protected:
  void SetUp() override {
    auto made = Session::open({.source = kSource, .options = "-DADDED=5"});
    if (!made && made.error().code == ErrorCode::kNotFound)
      GTEST_SKIP() << made.error().to_string();
    ASSERT_TRUE(made) << made.error().to_string();
    session_ = std::move(made).value();
  }
  static std::vector<cl_int> numbers(std::size_t count) {
    std::vector<cl_int> made(count);
    std::iota(made.begin(), made.end(), -3);
    return made;
  }
  std::unique_ptr<Session> session_;
};

TEST_F(OpenCl, KernelsComputeOnWhatWasWritten) {
  Buffer in, out;
  std::vector<cl_int> y;
  for (const std::size_t count : {std::size_t{1000}, std::size_t{10}, std::size_t{2000}}) {
    const std::vector<cl_int> x = numbers(count);
    ASSERT_TRUE(session_->write<cl_int>(in, x));
    ASSERT_TRUE(session_->resize(out, count * sizeof(cl_int)));
    ASSERT_TRUE(session_->run("scale", {count}, in, out, cl_int{7}));
    y.assign(count, 0);
    ASSERT_TRUE(session_->read<cl_int>(out, y));
    for (std::size_t i = 0; i < count; ++i) ASSERT_EQ(y[i], 7 * x[i] + 5);
  }
}

TEST_F(OpenCl, GridsMayHaveTwoDimensions) {
  const std::vector<cl_int> x = numbers(3 * 4);
  std::vector<cl_int> y(x.size());
  Buffer in, out;
  ASSERT_TRUE(session_->write<cl_int>(in, x));
  ASSERT_TRUE(session_->resize(out, in.bytes()));
  ASSERT_TRUE(session_->run("transpose", {4, 3}, in, out));
  ASSERT_TRUE(session_->finish());
  ASSERT_TRUE(session_->read<cl_int>(out, y));
  for (std::size_t row = 0; row < 3; ++row)
    for (std::size_t column = 0; column < 4; ++column)
      EXPECT_EQ(y[column * 3 + row], x[row * 4 + column]);
}

TEST_F(OpenCl, BuffersKeepTheirMemoryWhileTheirSizeStays) {
  Buffer buffer;
  ASSERT_TRUE(session_->resize(buffer, 64));
  const cl_mem first = buffer.get();
  ASSERT_TRUE(session_->resize(buffer, 64));
  EXPECT_EQ(buffer.get(), first);
  ASSERT_TRUE(session_->resize(buffer, 128));
  EXPECT_EQ(buffer.bytes(), 128U);
}

TEST_F(OpenCl, MistakesAreSaid) {
  Buffer in, out;
  ASSERT_TRUE(session_->write<cl_int>(in, numbers(4)));
  ASSERT_TRUE(session_->resize(out, 16));
  const Status absent = session_->run("scales", {4}, in, out, cl_int{1});
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().what, "the program has no such kernel");
  EXPECT_NE(absent.error().hint.find("transpose"), std::string::npos);
  const Status fewer = session_->run("scale", {4}, in, out);
  ASSERT_FALSE(fewer);
  EXPECT_EQ(fewer.error().what, "it has 3 arguments, and 2 are given");
  const Status wider = session_->run("scale", {4}, in, out, cl_long{1});
  ASSERT_FALSE(wider);
  EXPECT_EQ(wider.error().where, "kernel scale, argument 2");
  std::vector<cl_int> more(5);
  const Status beyond = session_->read<cl_int>(out, more);
  ASSERT_FALSE(beyond);
  EXPECT_EQ(beyond.error().what, "the buffer has 16 bytes, and 20 are asked for");

  const auto broken = Session::open({.source = "__kernel void broken() { undeclared = 1; }"});
  ASSERT_FALSE(broken);
  EXPECT_EQ(broken.error().code, ErrorCode::kInvalid);
  EXPECT_NE(broken.error().what.find("undeclared"), std::string::npos);
  for (const int index : {-1, 1000}) {
    const auto beyond_all = Session::open({.source = kSource}, index);
    ASSERT_FALSE(beyond_all);
    EXPECT_EQ(beyond_all.error().code, ErrorCode::kNotFound);
  }
}

struct State {
  Buffer in, out;
  int answer = 0;
};

TEST_F(OpenCl, AnXNodeIsASourceAndAnExec) {
  const xauto::Topic<int> question("question"), answer("answer");
  xauto::XNode<State> node("kernel");
  node.add_impl(xauto::XPU("opencl"),
                xauto::opencl::load({.source = kSource, .options = "-DADDED=1"}),
                [&](Session& cl, State& state, const xauto::Input& input) -> Status {
                  XAUTO_TRY(cl.write<cl_int>(state.in, std::vector<cl_int>{input.get(question)}));
                  XAUTO_TRY(cl.resize(state.out, state.in.bytes()));
                  XAUTO_TRY(cl.run("scale", {1}, state.in, state.out, cl_int{2}));
                  return cl.read<int>(state.out, {&state.answer, 1});
                });
  xauto::XModule<State> module("KERNEL");
  module.add_node(node).add_input_topic(question).add_output_topic(answer, &State::answer);
  xauto::testing::Fire fire(module);
  for (const int x : {4, -3}) {
    const auto outcome = fire.put(question, x).run();
    ASSERT_TRUE(outcome) << outcome.error().to_string();
    EXPECT_EQ(outcome->get(answer), 2 * x + 1);
  }
}

}  // namespace
