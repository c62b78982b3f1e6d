// SPDX-License-Identifier: Apache-2.0
// A small app to start from: two modules joined by a topic. `detect` finds objects in an image, on
// a CPU or on the GPU; `track` follows them, on a CPU. Replace what is marked TODO by your own
// work; the rest is how XAuto wants to be told about it.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;
using namespace xauto::literals;
using xauto::XPU;

namespace {

// Messages. Plain data travels between processes and into recordings as it is.
struct Image {
  std::uint64_t number = 0;
};
struct Objects {
  std::uint32_t count = 0;
};
struct Tracks {
  std::uint32_t alive = 0;
};

// What the XNodes of one module share: each leaves its result for the next one.
struct DetectState {
  Objects objects;
};
struct TrackState {
  Tracks tracks;
};

/// The context behind which a stage's work queues, one per XPU instance. Emulated here: work is a
/// duration.
/// TODO on a Jetson: a CUcontext (return SchedHandle::cuda_context(context)) or a cudlaDevHandle;
/// for a CPU stage no context at all (return SchedHandle::thread() and just compute in exec).
class Stage {
 public:
  xauto::SchedHandle open(const xauto::XpuId& xpu) {
    auto opened = xauto::emu::Context::open(xpu);
    if (!opened) throw std::runtime_error(opened.error().to_string());
    context_ = std::move(*opened);
    return context_->handle();
  }
  xauto::Status work(std::chrono::microseconds time) { return context_->run(time); }

 private:
  std::optional<xauto::emu::Context> context_;
};

}  // namespace

int main(int argc, char** argv) {
  const xauto::Topic<Image> image("camera/image");
  const xauto::Topic<Objects> objects("camera/objects");
  const xauto::Topic<Tracks> tracks("camera/tracks");

  Stage resize_cpu, detect_cpu, detect_gpu, track_cpu;

  xauto::XNode<DetectState> resize("detect.resize");
  resize.add_impl(
      XPU::CPU, [&](const xauto::XpuId& xpu) { return resize_cpu.open(xpu); },
      [&](DetectState&, const xauto::Input&) { return resize_cpu.work(1500us); });  // TODO

  // Two implementations of one stage: `xauto solve` chooses.
  xauto::XNode<DetectState> infer("detect.infer");
  infer.add_impl(
      XPU::CPU, [&](const xauto::XpuId& xpu) { return detect_cpu.open(xpu); },
      [&](DetectState& state, const xauto::Input& input) {
        state.objects.count = static_cast<std::uint32_t>(input.get(image).number % 5);  // TODO
        return detect_cpu.work(12000us);
      });
  infer.add_impl(
      XPU::GPU, [&](const xauto::XpuId& xpu) { return detect_gpu.open(xpu); },
      [&](DetectState& state, const xauto::Input& input) {
        state.objects.count = static_cast<std::uint32_t>(input.get(image).number % 5);  // TODO
        return detect_gpu.work(4000us);
      });

  xauto::XNode<TrackState> follow("track.follow");
  follow.add_impl(
      XPU::CPU, [&](const xauto::XpuId& xpu) { return track_cpu.open(xpu); },
      [&](TrackState& state, const xauto::Input& input) {
        state.tracks.alive = input.get(objects).count;  // TODO
        return track_cpu.work(1000us);
      });

  xauto::XModule<DetectState> detect("detect");
  detect.add_node(resize).add_node(infer);
  detect.add_input_topic(image);
  detect.add_output_topic(objects, &DetectState::objects);

  xauto::XModule<TrackState> track("track");
  track.add_node(follow);
  track.add_input_topic(objects);
  track.add_output_topic(tracks, &TrackState::tracks);

  std::map<std::uint32_t, unsigned> seen;  // how often so many tracks were alive
  xauto::App app("template");
  app.add_source(image, 30_hz, [](std::uint64_t number) { return Image{number}; });
  app.add_module(detect);
  app.add_module(track);
  app.on_message(tracks, [&](const Tracks& result, std::uint64_t) { ++seen[result.alive]; });
  app.on_end([&] {
    unsigned frames = 0;
    for (const auto& [alive, times] : seen) frames += times;
    std::fprintf(stderr, "template: %u frames tracked\n", frames);
  });
  return app.main(argc, argv);
}
