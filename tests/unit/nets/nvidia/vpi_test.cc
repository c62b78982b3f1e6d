// SPDX-License-Identifier: Apache-2.0
// xauto/vpi.h against a VPI that is acted out: what a stream is given runs when somebody waits for it, no sooner.
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/testing.h>
#include <xauto/vpi.h>

struct VPIStreamImpl {
  std::uint64_t flags = 0;
  std::vector<std::function<void()>> queued;
};
struct VPIImageImpl {
  int pixel = 0;
};

namespace {

int streams = 0, images = 0;
VPIStatus next_sync = VPI_SUCCESS;
std::string last_words;

void destroy(VPIImage image) {
  --images;
  delete image;
}
VPIImage make_image() {
  ++images;
  return new VPIImageImpl;
}

/// As vpiSubmitRescale and its like are: of a stream, by one of its backends.
VPIStatus submit_double(VPIStream stream, std::uint64_t backend, VPIImage from, VPIImage to) {
  if ((stream->flags & backend) == 0) return VPI_ERROR_INVALID_ARGUMENT;
  stream->queued.push_back([=] { to->pixel = 2 * from->pixel; });
  return VPI_SUCCESS;
}

}  // namespace

extern "C" {
const char* vpiStatusGetName(VPIStatus status) {
  return status == VPI_ERROR_INVALID_ARGUMENT ? "VPI_ERROR_INVALID_ARGUMENT" : "VPI_ERROR_INTERNAL";
}
VPIStatus vpiGetLastStatusMessage(char* message, std::int32_t length) {
  std::strncpy(message, last_words.c_str(), static_cast<std::size_t>(length));
  return next_sync;
}
VPIStatus vpiStreamCreate(std::uint64_t flags, VPIStream* stream) {
  *stream = new VPIStreamImpl{flags, {}};
  ++streams;
  return VPI_SUCCESS;
}
void vpiStreamDestroy(VPIStream stream) {
  EXPECT_TRUE(stream->queued.empty()) << "its work is lost";
  delete stream;
  --streams;
}
VPIStatus vpiStreamSync(VPIStream stream) {
  for (const auto& work : std::exchange(stream->queued, {})) work();
  return next_sync;
}
}

namespace xauto::vpi {
namespace {

struct State {
  VPIImage from = nullptr, to = nullptr;
  int pixel = 0;
};

TEST(Vpi, AnAlgorithmRunsOnItsEngineAndIsOverWhenExecReturns) {
  const Topic<int> in("in"), out("out");
  {
    XNode<State> resize("resize");
    State* shown = nullptr;
    resize.add_impl(
        XPU::VIC,
        [&shown](State& state, const XpuId& xpu) {
          shown = &state;
          return load(VPI_BACKEND_VIC, [&state](Session& session) -> Status {
            state.from = session.keep(make_image(), destroy);
            state.to = session.keep(make_image(), destroy);
            return {};
          })(xpu);
        },
        [](Session& session, State& state, const Input& input) -> Status {
          state.from->pixel = input.get<int>("in");
          XAUTO_TRY(checked(
              submit_double(session.stream(), session.backend(), state.from, state.to), "submit"));
          XAUTO_TRY(session.sync());
          state.pixel = state.to->pixel;
          return {};
        });
    XModule<State> module("M");
    module.add_node(resize).add_input_topic(in).add_output_topic(out, &State::pixel);
    testing::Fire fire(module);
    fire.on("resize", XPU::VIC);
    for (const int pixel : {3, 4}) {
      const auto outcome = fire.put(in, pixel).run();
      ASSERT_TRUE(outcome) << outcome.error().to_string();
      EXPECT_EQ(outcome->get(out), 2 * pixel);
    }
    EXPECT_EQ(streams, 1);
    EXPECT_EQ(images, 2);
  }
  EXPECT_EQ(streams, 0);
  EXPECT_EQ(images, 0);
}

TEST(Vpi, ItIsGatedAndOnOneEngine) {
  EXPECT_EQ(load(VPI_BACKEND_PVA)({"pva0", XPU::PVA, 0}).handle, SchedHandle::gate());
  EXPECT_EQ(streams, 0);
  const auto two = Session::open(VPI_BACKEND_PVA | VPI_BACKEND_CUDA);
  ASSERT_FALSE(two);
  EXPECT_EQ(two.error().code, ErrorCode::kInvalid);
  EXPECT_FALSE(Session::open(0));
  EXPECT_EQ(streams, 0);
}

TEST(Vpi, WhatFailsIsToldInVpisWords) {
  const auto session = Session::open(VPI_BACKEND_PVA);
  ASSERT_TRUE(session);
  next_sync = VPI_ERROR_INTERNAL;
  last_words = "the firmware does not answer";
  const Status failed = (*session)->sync();
  next_sync = VPI_SUCCESS;
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(failed.error().to_string(),
            "vpiStreamSync: VPI_ERROR_INTERNAL: the firmware does not answer");
  EXPECT_EQ(checked(VPI_ERROR_INVALID_ARGUMENT, "submit").error().code, ErrorCode::kInvalid);
  const auto init = load(VPI_BACKEND_VIC, [](Session&) -> Status {
    return fail(ErrorCode::kInvalid, "no such format", "vpiImageCreate");
  });
  EXPECT_THROW((void)init({"vic0", XPU::VIC, 0}), std::runtime_error);
}

}  // namespace
}  // namespace xauto::vpi
