// SPDX-License-Identifier: Apache-2.0
// XNode::add_impl: every form of init and exec, as the runtime calls them.
#include <memory>

#include <gtest/gtest.h>

#include <xauto/xauto.h>

#include "graph/app_spec.h"
#include "graph/input_access.h"

namespace xauto {
namespace {

struct Sums {
  int sum = 0;
};
struct Engine {
  explicit Engine(int s) : step(s) {}
  int step;
};
struct Peek {};

}  // namespace

/// XModule is a friend of XNode, this one of the test's, too.
template <>
class XModule<Peek> {
 public:
  static std::vector<detail::ImplSpec>& impls(const XNode<Sums>& node) { return node.spec_->impls; }
};

namespace {

Status run(detail::ImplSpec& impl, Sums& state) {
  std::shared_ptr<void> object;
  (void)impl.init({"gpu0", XPU::GPU, 0}, &state, object);
  return impl.exec(object.get(), &state, InputAccess::make());
}

TEST(XNode, ThePapersFormIsAsItWas) {
  XNode<Sums> node("x");
  node.add_impl(
      XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
      [](Sums& s, const Input&) { s.sum += 1; });
  node.add_impl(
      XPU::GPU, [](const XpuId&) { return SchedHandle::gate(); },
      [](Sums& s, const Input&) -> Status {
        s.sum += 10;
        return fail(ErrorCode::kIo, "no");
      });
  Sums state;
  auto& impls = XModule<Peek>::impls(node);
  ASSERT_EQ(impls.size(), 2u);
  EXPECT_TRUE(run(impls[0], state));
  std::shared_ptr<void> object;
  EXPECT_EQ(impls[0].init({}, nullptr, object), SchedHandle::thread());
  EXPECT_EQ(object, nullptr);
  EXPECT_FALSE(run(impls[1], state));
  EXPECT_EQ(state.sum, 11);
}

/// Its camera module: `init` returns what the driver gave, `exec` takes the state.
TEST(XNode, ThePapersListingCompiles) {
  int contexts[2] = {};  // what the pointers name is never looked at
  using CUcontext = CUctx_st*;
  using cudlaDevHandle = cudlaDevHandle_t*;
  const auto cuda_init = [&](const XpuId&) { return reinterpret_cast<CUcontext>(&contexts[0]); };
  const auto cudla_init = [&](const XpuId&) {
    return reinterpret_cast<cudlaDevHandle>(&contexts[1]);
  };
  XNode<Sums> infer("camera.infer");
  infer.add_impl(XPU::GPU, cuda_init, [](Sums& state) { state.sum += 1; });
  infer.add_impl(XPU::DLA, cudla_init, [](Sums& state) -> Status {
    state.sum += 10;
    return fail(ErrorCode::kIo, "no");
  });
  infer.add_impl(
      XPU::CPU,
      [&](const XpuId& xpu) { return own(std::make_unique<Engine>(100), cuda_init(xpu)); },
      [](Engine& engine, Sums& state) { state.sum += engine.step; });
  auto& impls = XModule<Peek>::impls(infer);
  std::shared_ptr<void> object;
  EXPECT_EQ(impls[0].init({}, nullptr, object), SchedHandle::cuda_context(&contexts[0]));
  EXPECT_EQ(impls[1].init({}, nullptr, object), SchedHandle::cudla_device(&contexts[1]));
  EXPECT_EQ(object, nullptr);
  EXPECT_EQ(impls[2].init({}, nullptr, object), SchedHandle::cuda_context(&contexts[0]));
  Sums state;
  EXPECT_TRUE(run(impls[0], state));
  EXPECT_FALSE(run(impls[1], state));
  EXPECT_TRUE(run(impls[2], state));
  EXPECT_EQ(state.sum, 111);
}

/// Section 3.2: shared state "holds model parameters"; the init loads them there, of the XPU that it is given.
TEST(XNode, AnInitThatTakesTheStateFillsIt) {
  XNode<Sums> node("x");
  node.add_impl(
      XPU::GPU,
      [](Sums& state, const XpuId& xpu) {
        state.sum = 100 * (xpu.index + 1);
        return SchedHandle::gate();
      },
      [](Sums& state) { state.sum += 1; });
  node.add_impl(
      XPU::DLA,
      [](Sums& state, const XpuId&) {
        return own(std::make_unique<Engine>(state.sum), SchedHandle::gate());
      },
      [](Engine& engine, Sums& state) { state.sum += engine.step; });
  auto& impls = XModule<Peek>::impls(node);
  Sums state;
  EXPECT_TRUE(run(impls[0], state));
  EXPECT_EQ(state.sum, 101);
  EXPECT_TRUE(run(impls[1], state));
  EXPECT_EQ(state.sum, 202);
}

TEST(XNode, WhatInitOwnsIsGivenToExec) {
  XNode<Sums> node("x");
  int number = 0;
  node.add_impl(
      XPU::GPU,
      [&](const XpuId&) { return own(std::make_unique<Engine>(++number), SchedHandle::gate()); },
      [](Engine& engine, Sums& s, const Input&) { s.sum += engine.step++; });
  auto& impl = XModule<Peek>::impls(node).front();
  // An object per instance: what one exec does to its own, the other's does not see.
  std::shared_ptr<void> first, second;
  EXPECT_EQ(impl.init({"gpu0", XPU::GPU, 0}, nullptr, first), SchedHandle::gate());
  EXPECT_EQ(impl.init({"gpu1", XPU::GPU, 1}, nullptr, second), SchedHandle::gate());
  Sums state;
  const Input input = InputAccess::make();
  EXPECT_TRUE(impl.exec(first.get(), &state, input));
  EXPECT_TRUE(impl.exec(first.get(), &state, input));
  EXPECT_EQ(state.sum, 1 + 2);
  EXPECT_TRUE(impl.exec(second.get(), &state, input));
  EXPECT_EQ(state.sum, 1 + 2 + 2);
}

TEST(XNode, ANullObjectIsRefused) {
  XNode<Sums> node("x");
  node.add_impl(
      XPU::GPU, [](const XpuId&) { return own(std::unique_ptr<Engine>(), SchedHandle::gate()); },
      [](Engine&, Sums&, const Input&) {});
  std::shared_ptr<void> object;
  EXPECT_THROW((void)XModule<Peek>::impls(node).front().init({}, nullptr, object),
               std::logic_error);
}

}  // namespace
}  // namespace xauto
