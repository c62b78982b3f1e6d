// SPDX-License-Identifier: Apache-2.0
#include "nets.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include <opencv2/imgproc.hpp>

namespace perception {
namespace {

constexpr float kFaceOverlap = 0.3F;  ///< of two boxes (IoU) from which on they are one face
constexpr std::size_t kFaceNumbers =
    16;                            ///< per anchor: a box, and six points that are not used here
constexpr float kLineLength = 10;  ///< of the nets' pixels, at least

float overlap(const cv::Rect2f& a, const cv::Rect2f& b) {
  const float both = (a & b).area();
  return both <= 0 ? 0 : both / (a.area() + b.area() - both);
}

}  // namespace

std::vector<cv::Rect> heads_of(const std::vector<cv::Rect>& people, cv::Size frame) {
  std::vector<cv::Rect> boxes = people;
  std::stable_sort(boxes.begin(), boxes.end(),
                   [](const cv::Rect& a, const cv::Rect& b) { return a.height > b.height; });
  if (boxes.size() > kMostHeads) boxes.resize(kMostHeads);
  std::vector<cv::Rect> heads;
  for (const cv::Rect& box : boxes) {
    const int side = std::min({std::max(box.width, 16), frame.width, frame.height});
    const int x = box.x + box.width / 2 - side / 2, y = box.y - side / 4;
    heads.emplace_back(std::clamp(x, 0, frame.width - side), std::clamp(y, 0, frame.height - side),
                       side, side);
  }
  return heads;
}

void to_face_input(const cv::Mat& bgr, const cv::Rect& square, int size, std::span<float> input) {
  cv::Mat scaled, rgb;
  cv::resize(bgr(square), scaled, {size, size}, 0, 0, cv::INTER_LINEAR);
  cv::cvtColor(scaled, rgb, cv::COLOR_BGR2RGB);
  cv::Mat target(size, size, CV_32FC3, input.data());
  rgb.convertTo(target, CV_32FC3, 1 / 127.5, -1);
}

std::vector<Face> to_faces(const FaceOutputs& outputs, int size, const cv::Rect& square) {
  struct Grid {
    std::size_t cells, anchors;
  };
  constexpr Grid kGrids[] = {{16, 2}, {8, 6}};
  std::vector<Face> found;
  const auto side = static_cast<float>(square.width);
  const float scale = side / static_cast<float>(size);
  for (std::size_t g = 0; g < 2; ++g) {
    const Grid grid = kGrids[g];
    for (std::size_t i = 0; i < grid.cells * grid.cells * grid.anchors; ++i) {
      const float logit = outputs.scores[g][i];
      if (logit <= 0) continue;
      const float* box = &outputs.boxes[g][i * kFaceNumbers];
      const std::size_t cell = i / grid.anchors;
      const auto at = [&](std::size_t place) {
        return side * (static_cast<float>(place) + 0.5F) / static_cast<float>(grid.cells);
      };
      const float x = static_cast<float>(square.x) + at(cell % grid.cells) + box[0] * scale;
      const float y = static_cast<float>(square.y) + at(cell / grid.cells) + box[1] * scale;
      const float width = box[2] * scale, height = box[3] * scale;
      found.push_back({{x - width / 2, y - height / 2, width, height}, 1 / (1 + std::exp(-logit))});
    }
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const Face& a, const Face& b) { return a.score > b.score; });
  std::vector<Face> faces;
  for (const Face& face : found)
    if (std::none_of(faces.begin(), faces.end(),
                     [&](const Face& f) { return overlap(f.box, face.box) > kFaceOverlap; }))
      faces.push_back(face);
  return faces;
}

void to_line_input(const cv::Mat& bgr, int size, std::span<float> input) {
  cv::Mat scaled, rgba;
  cv::resize(bgr, scaled, {size, size}, 0, 0, cv::INTER_AREA);
  cv::cvtColor(scaled, rgba, cv::COLOR_BGR2RGBA);
  cv::Mat target(size, size, CV_32FC4, input.data());
  rgba.convertTo(target, CV_32FC4);
  for (std::size_t i = 3; i < input.size(); i += 4) input[i] = 1;
}

std::vector<Line> to_lines(std::span<const float> scores, std::span<const float> offsets, int size,
                           cv::Size frame) {
  const auto map = static_cast<std::size_t>(size / 2);
  const float to_x = static_cast<float>(frame.width) / static_cast<float>(map);
  const float to_y = static_cast<float>(frame.height) / static_cast<float>(map);
  std::vector<Line> lines;
  for (std::size_t i = 0; i < map * map; ++i) {
    if (scores[i] < kLineScore) continue;
    const float* offset = &offsets[4 * i];
    if (2 * std::hypot(offset[2] - offset[0], offset[3] - offset[1]) < kLineLength) continue;
    const std::size_t row = i / map;
    const auto x = static_cast<float>(i % map), y = static_cast<float>(row);
    lines.push_back({{(x + offset[0]) * to_x, (y + offset[1]) * to_y},
                     {(x + offset[2]) * to_x, (y + offset[3]) * to_y},
                     scores[i]});
  }
  std::stable_sort(lines.begin(), lines.end(),
                   [](const Line& a, const Line& b) { return a.score > b.score; });
  if (lines.size() > kMostLines) lines.resize(kMostLines);
  return lines;
}

}  // namespace perception
