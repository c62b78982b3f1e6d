// SPDX-License-Identifier: Apache-2.0
// Pedestrians in a real video, for real: decode, grey, HOG detection, background subtraction,
// fusion, tracking, prediction, on this machine's cores and an OpenCL device.
//
//                          ┌─► HOG   hog.detect ───────────────┐
//   video ─► IN in.decode ─┤                                   ├─► FUSE ─► TRACK ─► PREDICT
//            in.grey (*)   └─► MOTION bg.subtract, bg.clean (*)┘   fuse     track     predict
//
//   (*) has a second implementation for XPU "opencl", which is gated: one job at a time.
//
// Usage, through the tool: xauto run ... -- pedestrians VIDEO OUTPUT-FOLDER
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>

#include <xauto/xauto.h>

#include "opencl.h"
#include "stages.h"
#include "video.h"

namespace {

using namespace std::chrono_literals;
using namespace pedestrians;
using xauto::XPU;

const XPU kOpenCl("opencl");
constexpr int kPathFrames = 12;
constexpr std::uint64_t kShownFrame = 55;  ///< the one that is annotated, or the last one before it

struct Image {
  cv::Mat colour;
  Grey grey;
};
struct InState {
  Image image;
  OpenClBuffers opencl;
};
struct HogState {
  std::vector<Detection> people;
};
struct MotionState {
  cv::Ptr<cv::BackgroundSubtractorMOG2> background = make_background();
  cv::Mat raw, clean;
  OpenClBuffers opencl;
};
struct FuseState {
  std::vector<Detection> detections;
};
struct TrackState {
  Tracker tracker;
  std::vector<Track> tracks;
};
using Paths = std::map<int, std::vector<cv::Point2d>>;
struct PredictState {
  Paths paths;
};

xauto::SchedHandle on_thread(const xauto::XpuId&) {
  return xauto::SchedHandle::thread();
}

std::string json_of(const std::map<std::uint64_t, std::vector<Track>>& tracks) {
  std::string out = "{\"frames\": [\n";
  for (auto at = tracks.begin(); at != tracks.end(); ++at) {
    out += "  {\"frame\": " + std::to_string(at->first) + ", \"tracks\": [";
    for (std::size_t i = 0; i < at->second.size(); ++i) {
      const Track& t = at->second[i];
      char text[128];
      std::snprintf(text, sizeof text, "%s{\"id\": %d, \"box\": [%.0f, %.0f, %.0f, %.0f]}",
                    i == 0 ? "" : ", ", t.id, t.box.x, t.box.y, t.box.width, t.box.height);
      out += text;
    }
    out += std::next(at) == tracks.end() ? "]}\n" : "]},\n";
  }
  return out + "]}\n";
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: xauto run ... -- pedestrians VIDEO OUTPUT-FOLDER\n");
    return 2;
  }
  cv::setNumThreads(1);  // an XNode is one thread: its CPU is the policy's choice
  setenv("POCL_MAX_PTHREAD_COUNT", "1", 0);  // and so is PoCL's
  const std::string folder = argv[2];
  auto video = std::make_shared<std::optional<Video>>();  // opened at the first frame: a recording
                                                          // needs none

  const xauto::Topic<Jpeg> frames("video/frame");
  const xauto::Topic<Image> images("image");
  const xauto::Topic<std::vector<Detection>> people("people"), detections("detections");
  const xauto::Topic<cv::Mat> motion("motion");
  const xauto::Topic<std::vector<Track>> tracks("tracks");
  const xauto::Topic<Paths> paths("paths");

  xauto::XNode<InState> in_decode("in.decode");
  in_decode.add_impl(XPU::CPU, on_thread, [&](InState& state, const xauto::Input& input) {
    state.image.colour = decode(input.get(frames));
    state.image.grey = {};  // the last one is still being read downstream
  });
  xauto::XNode<InState> in_grey("in.grey");
  in_grey.add_impl(XPU::CPU, on_thread, [](InState& state, const xauto::Input&) {
    to_grey(state.image.colour, state.image.grey);
  });
  in_grey.add_impl(kOpenCl, xauto::opencl::load(opencl_program()),
                   [](xauto::opencl::Session& cl, InState& state, const xauto::Input&) {
                     return to_grey(cl, state.opencl, state.image.colour, state.image.grey);
                   });
  xauto::XModule<InState> in("IN");
  in.add_node(in_decode).add_node(in_grey).add_input_topic(frames).add_output_topic(
      images, &InState::image);

  xauto::XNode<HogState> hog_detect("hog.detect");
  hog_detect.add_impl(XPU::CPU, on_thread, [&](HogState& state, const xauto::Input& input) {
    state.people = detect_people(input.get(images).grey.full);
  });
  xauto::XModule<HogState> hog("HOG");
  hog.add_node(hog_detect).add_input_topic(images).add_output_topic(people, &HogState::people);

  xauto::XNode<MotionState> bg_subtract("bg.subtract");
  bg_subtract.add_impl(XPU::CPU, on_thread, [&](MotionState& state, const xauto::Input& input) {
    subtract_background(*state.background, input.get(images).grey.half, state.raw);
  });
  xauto::XNode<MotionState> bg_clean("bg.clean");
  bg_clean.add_impl(XPU::CPU, on_thread, [](MotionState& state, const xauto::Input&) {
    state.clean = cv::Mat();  // the last one is still being read downstream
    clean_mask(state.raw, state.clean);
  });
  bg_clean.add_impl(kOpenCl, xauto::opencl::load(opencl_program()),
                    [](xauto::opencl::Session& cl, MotionState& state, const xauto::Input&) {
                      state.clean = cv::Mat();  // the last one is still being read downstream
                      return clean_mask(cl, state.opencl, state.raw, state.clean);
                    });
  xauto::XModule<MotionState> background("MOTION");
  background.add_node(bg_subtract)
      .add_node(bg_clean)
      .add_input_topic(images)
      .add_output_topic(motion, &MotionState::clean);

  xauto::XNode<FuseState> fuse_node("fuse");
  fuse_node.add_impl(XPU::CPU, on_thread, [&](FuseState& state, const xauto::Input& input) {
    state.detections = fuse(input.get(people), input.get(motion));
  });
  xauto::XModule<FuseState> fusion("FUSE");
  fusion.add_node(fuse_node).add_input_topic(people).add_input_topic(motion).add_output_topic(
      detections, &FuseState::detections);

  xauto::XNode<TrackState> track_node("track");
  track_node.add_impl(XPU::CPU, on_thread, [&](TrackState& state, const xauto::Input& input) {
    state.tracks = state.tracker.update(input.get(detections));
  });
  xauto::XModule<TrackState> tracking("TRACK");
  tracking.add_node(track_node)
      .add_input_topic(detections)
      .add_output_topic(tracks, &TrackState::tracks);

  xauto::XNode<PredictState> predict_node("predict");
  predict_node.add_impl(XPU::CPU, on_thread, [&](PredictState& state, const xauto::Input& input) {
    state.paths.clear();
    for (const Track& track : input.get(tracks))
      state.paths[track.id] = predict(track, kPathFrames);
  });
  xauto::XModule<PredictState> prediction("PREDICT");
  prediction.add_node(predict_node)
      .add_input_topic(tracks)
      .add_output_topic(paths, &PredictState::paths);

  // What the run leaves behind: the tracks of every frame, and one frame to look at.
  std::mutex mutex;
  std::map<std::uint64_t, std::vector<Track>> seen;
  std::map<std::uint64_t, cv::Mat> shown;

  xauto::App app("pedestrians");
  app.add_source(frames, 150ms, [&, video](std::uint64_t) {
    if (!*video) video->emplace(argv[1]);
    return (*video)->frame();
  });
  app.add_module(in)
      .add_module(hog)
      .add_module(background)
      .add_module(fusion)
      .add_module(tracking)
      .add_module(prediction);
  app.on_message(images, [&](const Image& image, std::uint64_t number) {
    if (number > kShownFrame) return;
    const std::lock_guard lock(mutex);
    shown.clear();
    shown[number] = image.colour;
  });
  app.on_message(tracks, [&](const std::vector<Track>& now, std::uint64_t number) {
    const std::lock_guard lock(mutex);
    seen[number] = now;
  });
  app.on_end([&] {
    std::ofstream(folder + "/detections.json") << json_of(seen);
    if (shown.empty()) return;
    cv::Mat picture = shown.begin()->second.clone();
    annotate(picture, seen[shown.begin()->first], kPathFrames);
    if (!cv::imwrite(folder + "/annotated.png", picture))
      throw std::runtime_error(folder + "/annotated.png cannot be written");
  });
  return app.main(argc, argv);
}
