// SPDX-License-Identifier: Apache-2.0
// Real nets on this machine's cores: people by HOG, faces and line segments by ONNX Runtime, in a real video.
//
//                          ┌─► PEOPLE people.detect ─┬─► TRACK track ───────┐
//   video ─► IN in.decode ─┤                         └─► FACES faces.net ───┼─► SCENE scene
//            in.grey       └─► LINES  lines.net, lines.decode ──────────────┘
//
// Each net comes in several sizes, which cost and see more or less; the command line chooses. The smaller
// ones for lines are variants of the chosen one: tables may use them where a scenario is degraded.
//
// Usage, through the tool: xauto run ... -- perception VIDEO NETS-FOLDER OUTPUT-FOLDER [FACES [LINES]]
#include <algorithm>
#include <cstdio>
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
#include <opencv2/imgproc.hpp>

#include <xauto/onnx.h>
#include <xauto/xauto.h>

#include "../pedestrians/stages.h"
#include "../pedestrians/video.h"
#include "nets.h"

namespace {

using namespace std::chrono_literals;
using namespace perception;
using pedestrians::Detection;
using pedestrians::Jpeg;
using pedestrians::Track;
using pedestrians::Video;
using xauto::XPU;

/// Frames of which a run leaves pictures.
constexpr std::uint64_t kShown[] = {3, 12, 25};

/// A net of one job: what the command line calls it, its file, the side of its square input, and how
/// much it found of what the largest one did (examples/perception/README.md).
struct Net {
  const char* name;
  const char* file;
  int size;
  int found;
};
// The cheapest first.
constexpr Net kFaces[] = {{"128", "face_detection_front_128x128_barracuda.onnx", 128, 0},
                          {"256", "face_detection_back_256x256_barracuda.onnx", 256, 7}};
constexpr Net kLines[] = {{"tiny-320", "mlsd_320x320_tiny.onnx", 320, 782},
                          {"tiny-512", "mlsd_512x512_tiny.onnx", 512, 1646},
                          {"large-320", "mlsd_320x320_large.onnx", 320, 809},
                          {"large-512", "mlsd_512x512_large.onnx", 512, 2429}};

template <std::size_t kCount>
const Net* chosen(const Net (&nets)[kCount], const std::string& name) {
  for (const Net& net : nets)
    if (name == net.name) return &net;
  return nullptr;
}

xauto::onnx::Model face_model(const std::string& folder, const Net& net) {
  using xauto::tensor;
  return {.file = folder + "/" + net.file,
          .inputs = {tensor<float>("input:0", {1, net.size, net.size, 3})},
          .outputs = {tensor<float>("Identity:0", {1, 512, 1}),
                      tensor<float>("Identity_1:0", {1, 384, 1}),
                      tensor<float>("Identity_2:0", {1, 512, 16}),
                      tensor<float>("Identity_3:0", {1, 384, 16})}};
}
xauto::onnx::Model line_model(const std::string& folder, const Net& net) {
  using xauto::tensor;
  const int half = net.size / 2;
  return {.file = folder + "/" + net.file,
          .inputs = {tensor<float>("input_image_with_alpha:0", {1, net.size, net.size, 4})},
          .outputs = {tensor<float>("scores", {1, half, half, 1}),
                      tensor<float>("offsets", {1, half, half, 4})}};
}

struct Image {
  cv::Mat colour;
  pedestrians::Grey grey;
};
struct InState {
  Image image;
};
struct PeopleState {
  std::vector<Detection> people;
};
struct TrackState {
  pedestrians::Tracker tracker;
  std::vector<Track> tracks;
};
struct FacesState {
  std::vector<Face> faces;
};
struct LinesState {
  int size = 0;                            ///< of the net's input
  std::span<const float> scores, offsets;  ///< the session's, until its next run
  std::vector<Line> lines;
};
struct Scene {
  std::vector<Detection> people;
  std::vector<Track> tracks;
  std::vector<Face> faces;
  std::vector<Line> lines;
};
struct SceneState {
  Scene scene;
};

xauto::SchedHandle on_thread(const xauto::XpuId&) {
  return xauto::SchedHandle::thread();
}

/// "[1.00, 2.00]"
std::string array(std::initializer_list<double> numbers) {
  std::string text;
  char one[32];
  for (const double number : numbers) {
    std::snprintf(one, sizeof one, "%s%.4f", text.empty() ? "[" : ", ", number);
    text += one;
  }
  return text + "]";
}
template <class Each>
std::string list(const char* name, std::size_t count, Each each) {
  std::string text = std::string("\"") + name + "\": [";
  for (std::size_t i = 0; i < count; ++i) text += (i == 0 ? "" : ", ") + each(i);
  return text + "]";
}

std::string json_of(const Scene& s) {
  return list("people", s.people.size(),
              [&](std::size_t i) {
                const cv::Rect& b = s.people[i].box;
                return array({double(b.x), double(b.y), double(b.width), double(b.height)});
              }) +
         ", " +
         list("tracks", s.tracks.size(),
              [&](std::size_t i) {
                const auto& b = s.tracks[i].box;
                return array({double(s.tracks[i].id), b.x, b.y, b.width, b.height});
              }) +
         ", " +
         list("faces", s.faces.size(),
              [&](std::size_t i) {
                const auto& f = s.faces[i];
                return array({f.score, f.box.x, f.box.y, f.box.width, f.box.height});
              }) +
         ", " + list("lines", s.lines.size(), [&](std::size_t i) {
           const Line& l = s.lines[i];
           return array({l.score, l.from.x, l.from.y, l.to.x, l.to.y});
         });
}

void annotate(cv::Mat& image, const Scene& scene) {
  for (const Line& line : scene.lines) cv::line(image, line.from, line.to, {233, 180, 86}, 2);
  pedestrians::annotate(image, scene.tracks, 12);
  for (const Face& face : scene.faces) cv::rectangle(image, face.box, {66, 228, 240}, 2);
}

}  // namespace

int main(int argc, char** argv) {
  const Net* face_net = chosen(kFaces, argc > 4 ? argv[4] : "128");
  const Net* line_net = chosen(kLines, argc > 5 ? argv[5] : "tiny-320");
  if (argc < 4 || argc > 6 || face_net == nullptr || line_net == nullptr) {
    std::fprintf(
        stderr,
        "usage: xauto run ... -- perception VIDEO NETS-FOLDER OUTPUT-FOLDER [FACES [LINES]]\n"
        "  FACES: 128 or 256; LINES: tiny-320, tiny-512, large-320 or large-512\n");
    return 2;
  }
  cv::setNumThreads(1);  // an XNode is one thread: its CPU is the policy's choice
  const std::string nets = argv[2], folder = argv[3];
  auto video = std::make_shared<std::optional<Video>>();  // opened at the first frame: a recording
                                                          // needs none

  const xauto::Topic<Jpeg> frames("video/frame");
  const xauto::Topic<Image> images("image");
  const xauto::Topic<std::vector<Detection>> people("people");
  const xauto::Topic<std::vector<Track>> tracks("tracks");
  const xauto::Topic<std::vector<Face>> faces("faces");
  const xauto::Topic<std::vector<Line>> lines("lines");
  const xauto::Topic<Scene> scenes("scene");

  xauto::XNode<InState> in_decode("in.decode");
  in_decode.add_impl(XPU::CPU, on_thread, [&](InState& state, const xauto::Input& input) {
    state.image.colour = pedestrians::decode(input.get(frames));
    state.image.grey = {};  // the last one is still being read downstream
  });
  xauto::XNode<InState> in_grey("in.grey");
  in_grey.add_impl(XPU::CPU, on_thread, [](InState& state, const xauto::Input&) {
    pedestrians::to_grey(state.image.colour, state.image.grey);
  });
  xauto::XModule<InState> in("IN");
  in.add_node(in_decode).add_node(in_grey).add_input_topic(frames).add_output_topic(
      images, &InState::image);

  xauto::XNode<PeopleState> people_detect("people.detect");
  people_detect.add_impl(
      XPU::CPU,
      [](const xauto::XpuId&
             xpu) {  // once in vain: what OpenCV makes for its first image is there then
        (void)pedestrians::detect_people(cv::Mat(576, 768, CV_8UC1, cv::Scalar(0)));
        return on_thread(xpu);
      },
      [&](PeopleState& state, const xauto::Input& input) {
        state.people = pedestrians::detect_people(input.get(images).grey.full);
      });
  xauto::XModule<PeopleState> detection("PEOPLE");
  detection.add_node(people_detect)
      .add_input_topic(images)
      .add_output_topic(people, &PeopleState::people);

  xauto::XNode<TrackState> track_node("track");
  track_node.add_impl(XPU::CPU, on_thread, [&](TrackState& state, const xauto::Input& input) {
    state.tracks = state.tracker.update(input.get(people));
  });
  xauto::XModule<TrackState> tracking("TRACK");
  tracking.add_node(track_node)
      .add_input_topic(people)
      .add_output_topic(tracks, &TrackState::tracks);

  xauto::XNode<FacesState> faces_net("faces.net");
  faces_net.add_impl(XPU::CPU, xauto::onnx::load(face_model(nets, *face_net)),
                     [&](xauto::onnx::Session& net, FacesState& state,
                         const xauto::Input& input) -> xauto::Status {
                       const cv::Mat& image = input.get(images).colour;
                       std::vector<cv::Rect> boxes;
                       for (const Detection& person : input.get(people))
                         boxes.push_back(person.box);
                       state.faces.clear();
                       for (const cv::Rect& head : heads_of(boxes, image.size())) {
                         to_face_input(image, head, face_net->size, net.input<float>(0));
                         XAUTO_TRY(net.run());
                         const FaceOutputs outputs{{net.output<float>(0), net.output<float>(1)},
                                                   {net.output<float>(2), net.output<float>(3)}};
                         for (const Face& face : to_faces(outputs, face_net->size, head))
                           state.faces.push_back(face);
                       }
                       return {};
                     });
  xauto::XModule<FacesState> face_detection("FACES");
  face_detection.add_node(faces_net)
      .add_input_topic(images)
      .add_input_topic(people)
      .add_output_topic(faces, &FacesState::faces);

  xauto::XNode<LinesState> lines_net("lines.net");
  const auto find_lines = [&](const Net& of) {
    return [&images, size = of.size](xauto::onnx::Session& net, LinesState& state,
                                     const xauto::Input& input) -> xauto::Status {
      to_line_input(input.get(images).colour, size, net.input<float>(0));
      XAUTO_TRY(net.run());
      state.size = size;
      state.scores = net.output<float>(0);
      state.offsets = net.output<float>(1);
      return {};
    };
  };
  lines_net.add_impl(XPU::CPU, xauto::onnx::load(line_model(nets, *line_net)),
                     find_lines(*line_net));
  for (const Net* less = kLines; less != line_net; ++less)
    if (less->found < line_net->found)
      lines_net.add_variant(less->name, 100 * less->found / line_net->found, XPU::CPU,
                            xauto::onnx::load(line_model(nets, *less)), find_lines(*less));
  xauto::XNode<LinesState> lines_decode("lines.decode");
  lines_decode.add_impl(XPU::CPU, on_thread, [&](LinesState& state, const xauto::Input& input) {
    state.lines =
        to_lines(state.scores, state.offsets, state.size, input.get(images).colour.size());
  });
  xauto::XModule<LinesState> line_detection("LINES");
  line_detection.add_node(lines_net)
      .add_node(lines_decode)
      .add_input_topic(images)
      .add_output_topic(lines, &LinesState::lines);

  xauto::XNode<SceneState> scene_node("scene");
  scene_node.add_impl(XPU::CPU, on_thread, [&](SceneState& state, const xauto::Input& input) {
    state.scene = {input.get(people), input.get(tracks), input.get(faces), input.get(lines)};
  });
  xauto::XModule<SceneState> fusion("SCENE");
  fusion.add_node(scene_node)
      .add_input_topic(people)
      .add_input_topic(tracks)
      .add_input_topic(faces)
      .add_input_topic(lines)
      .add_output_topic(scenes, &SceneState::scene);

  // What the run leaves behind: the scene of every frame, and some frames to look at.
  std::mutex mutex;
  std::map<std::uint64_t, Scene> seen;
  std::map<std::uint64_t, cv::Mat> shown;

  xauto::App app("perception");
  app.add_source(frames, 500ms, [&, video](std::uint64_t) {
    if (!*video) video->emplace(argv[1]);
    return (*video)->frame();
  });
  app.add_module(in)
      .add_module(detection)
      .add_module(tracking)
      .add_module(face_detection)
      .add_module(line_detection)
      .add_module(fusion);
  app.on_message(images, [&](const Image& image, std::uint64_t number) {
    if (std::find(std::begin(kShown), std::end(kShown), number) == std::end(kShown)) return;
    const std::lock_guard lock(mutex);
    shown[number] = image.colour;
  });
  app.on_message(scenes, [&](const Scene& scene, std::uint64_t number) {
    const std::lock_guard lock(mutex);
    seen[number] = scene;
  });
  app.on_end([&] {
    std::ofstream out(folder + "/scenes.json");
    out << "{\"faces\": \"" << face_net->file << "\", \"lines\": \"" << line_net->file
        << "\", \"frames\": [\n";
    for (auto at = seen.begin(); at != seen.end(); ++at)
      out << "  {\"frame\": " << at->first << ", " << json_of(at->second) << "}"
          << (std::next(at) == seen.end() ? "\n" : ",\n");
    out << "]}\n";
    if (!out.flush()) throw std::runtime_error(folder + "/scenes.json cannot be written");
    for (const auto& [number, image] : shown) {
      if (!seen.contains(number)) continue;
      const std::string name = folder + "/frame-" + std::to_string(number);
      cv::Mat picture = image.clone();
      annotate(picture, seen[number]);
      // As it was, too, for a check that starts from the same pixels.
      if (!cv::imwrite(name + ".png", picture) || !cv::imwrite(name + ".ppm", image))
        throw std::runtime_error(name + ".png cannot be written");
    }
  });
  return app.main(argc, argv);
}
