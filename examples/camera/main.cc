// SPDX-License-Identifier: Apache-2.0
// The paper's camera module: preprocess on a CPU, infer on the GPU or a DLA, postprocess on a CPU.
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <stdexcept>
#include <vector>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;
using xauto::XPU;

namespace {

struct Image {
  std::uint64_t number = 0;
};
struct Objects {
  std::vector<int> classes;
};

/// What the three stages share: each leaves its result for the next one.
struct CameraState {
  std::vector<float> tensor, logits;
  Objects objects;
};

/// On a Jetson this is a CUcontext or a cudlaDevHandle and the engine that was loaded into it.
struct Engine {
  std::optional<xauto::emu::Context> context;

  xauto::SchedHandle load(const xauto::XpuId& xpu) {
    auto opened = xauto::emu::Context::open(xpu);
    if (!opened) throw std::runtime_error(opened.error().to_string());
    context = std::move(*opened);
    return context->handle();
  }
  xauto::Status infer(const std::vector<float>& in, std::vector<float>& out,
                      std::chrono::microseconds time) {
    out.assign(in.size() / 2, 0.5f);
    return context->run(time);
  }
};

}  // namespace

int main(int argc, char** argv) {
  const xauto::Topic<Image> image("camera/image");
  const xauto::Topic<Objects> objects("camera/objects");

  Engine cpu_pre, cpu_post, gpu, dla;

  xauto::XNode<CameraState> preprocess("camera.preprocess");
  preprocess.add_impl(
      XPU::CPU, [&](const xauto::XpuId& xpu) { return cpu_pre.load(xpu); },
      [&](CameraState& state, const xauto::Input& input) {
        state.tensor.assign(64, static_cast<float>(input.get(image).number));
        return cpu_pre.context->run(2000us);
      });

  xauto::XNode<CameraState> infer("camera.infer");
  infer.add_impl(
      XPU::GPU, [&](const xauto::XpuId& xpu) { return gpu.load(xpu); },
      [&](CameraState& state, const xauto::Input&) {
        return gpu.infer(state.tensor, state.logits, 5000us);
      });
  infer.add_impl(
      XPU::DLA, [&](const xauto::XpuId& xpu) { return dla.load(xpu); },
      [&](CameraState& state, const xauto::Input&) {
        return dla.infer(state.tensor, state.logits, 8000us);
      });

  xauto::XNode<CameraState> postprocess("camera.postprocess");
  postprocess.add_impl(
      XPU::CPU, [&](const xauto::XpuId& xpu) { return cpu_post.load(xpu); },
      [&](CameraState& state, const xauto::Input&) {
        state.objects.classes.assign(state.logits.size(), 1);
        return cpu_post.context->run(1000us);
      });

  xauto::XModule<CameraState> camera("camera");
  camera.add_node(preprocess);
  camera.add_node(infer);
  camera.add_node(postprocess);
  camera.add_input_topic(image);
  camera.add_output_topic(objects, &CameraState::objects);

  std::size_t frames = 0, found = 0;
  xauto::App app("camera");
  app.add_source(image, 33ms, [](std::uint64_t number) { return Image{number}; });
  app.add_module(camera);
  app.on_message(objects, [&](const Objects& seen, std::uint64_t) {
    ++frames;
    found += seen.classes.size();
  });
  app.on_end([&] { std::fprintf(stderr, "camera: %zu objects in %zu frames\n", found, frames); });
  return app.main(argc, argv);
}
