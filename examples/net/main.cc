// SPDX-License-Identifier: Apache-2.0
// A net on a camera's topic, as small as it gets: from ROS 2's sensor_msgs/Image to BlazeFace's input, and whether
// there is a face. docs/nets.md walks through it.
//
// Usage, through the tool: xauto run ... -- net FACE-NET.onnx
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <span>
#include <stdexcept>

#include <sensor_msgs/msg/image.h>

#include <xauto/onnx.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;
using sensor_msgs::msg::Image;
using xauto::XPU;

namespace {

constexpr std::int64_t kSize = 128;  ///< the net's input is so wide and high

struct Faces {
  float best = 0;  ///< score, 0 to 1
};
struct State {
  std::vector<float> scaled = std::vector<float>(kSize * kSize * 3);
  Faces faces;
};

/// The nearest pixel of each, as RGB from -1 to 1. What comes from outside is checked.
void scale(const Image& image, std::span<float> to) {
  if (image.encoding != "rgb8" || image.width == 0 || image.height == 0 ||
      image.step < 3 * std::uint64_t{image.width} ||
      image.data.size() < std::uint64_t{image.step} * image.height)
    throw std::runtime_error("the image is not rgb8, or not whole");
  for (std::size_t y = 0; y < kSize; ++y)
    for (std::size_t x = 0; x < kSize; ++x) {
      const std::size_t at = y * image.height / kSize * image.step + x * image.width / kSize * 3;
      for (std::size_t k = 0; k < 3; ++k)
        to[(y * kSize + x) * 3 + k] = static_cast<float>(image.data[at + k]) / 127.5F - 1;
    }
}

/// What the camera sees while no bag and no driver is there.
Image pattern(std::uint64_t number) {
  Image image;
  image.header.frame_id = "camera";
  image.width = 640;
  image.height = 480;
  image.encoding = "rgb8";
  image.step = 3 * image.width;
  image.data.resize(std::size_t{image.step} * image.height);
  for (std::size_t i = 0; i < image.data.size(); ++i)
    image.data[i] = static_cast<std::uint8_t>(i / 7 + number);
  return image;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: xauto run ... -- net FACE-NET.onnx\n");
    return 2;
  }
  const xauto::Topic<Image> images("camera/image");
  const xauto::Topic<Faces> faces("faces");

  xauto::XNode<State> scaling("faces.scale");
  scaling.add_impl(
      XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [&](State& state, const xauto::Input& input) { scale(input.get(images), state.scaled); });

  using xauto::tensor;
  const xauto::onnx::Model model{.file = argv[1],
                                 .inputs = {tensor<float>("input:0", {1, kSize, kSize, 3})},
                                 .outputs = {tensor<float>("Identity:0", {1, 512, 1})}};
  xauto::XNode<State> net("faces.net");
  net.add_impl(
      XPU::CPU, xauto::onnx::load(model),
      [](xauto::onnx::Session& session, State& state, const xauto::Input&) -> xauto::Status {
        std::ranges::copy(state.scaled, session.input<float>(0).begin());
        XAUTO_TRY(session.run());
        const auto logits = session.output<float>(0);
        state.faces.best = 1 / (1 + std::exp(-*std::ranges::max_element(logits)));
        return {};
      });

  xauto::XModule<State> module("faces");
  module.add_node(scaling).add_node(net).add_input_topic(images).add_output_topic(faces,
                                                                                  &State::faces);
  unsigned frames = 0;
  float best = 0;
  xauto::App app("net");
  app.add_source(images, 100ms, pattern);
  app.add_module(module);
  app.on_message(faces, [&](const Faces& found, std::uint64_t) {
    ++frames;
    best = std::max(best, found.best);
  });
  app.on_end([&] { std::fprintf(stderr, "net: %u frames, best face %.2f\n", frames, best); });
  return app.main(argc, argv);
}
