// SPDX-License-Identifier: Apache-2.0
#include "stages.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/objdetect.hpp>

namespace pedestrians {
namespace {

constexpr double kMinHogWeight = 0.3;
constexpr double kMinForeground = 0.12;  ///< share of a HOG box that must move
constexpr int kMinBlobArea = 180;        ///< pixels of the half image
constexpr double kSameObject = 0.3;      ///< overlap (IoU) from which two boxes are one object
constexpr int kMaxMissed = 5;            ///< frames a track survives without a detection

double overlap(const cv::Rect2d& a, const cv::Rect2d& b) {
  const double both = (a & b).area();
  return both <= 0 ? 0.0 : both / (a.area() + b.area() - both);
}

cv::Point2d centre(const cv::Rect2d& box) {
  return {box.x + box.width / 2, box.y + box.height / 2};
}

/// Drops boxes that overlap a better one.
std::vector<Detection> best_of_overlapping(std::vector<Detection> all) {
  std::stable_sort(all.begin(), all.end(),
                   [](const Detection& a, const Detection& b) { return a.score > b.score; });
  std::vector<Detection> kept;
  for (const Detection& d : all) {
    const auto inside = [&](const Detection& k) {
      const double both = (k.box & d.box).area();
      return both > 0.6 * std::min(k.box.area(), d.box.area());
    };
    if (std::none_of(kept.begin(), kept.end(), inside)) kept.push_back(d);
  }
  return kept;
}

}  // namespace

cv::Mat decode(const std::vector<std::byte>& jpeg) {
  const cv::Mat bytes(1, static_cast<int>(jpeg.size()), CV_8UC1,
                      const_cast<std::byte*>(jpeg.data()));  // imdecode does not write to it
  cv::Mat image = cv::imdecode(bytes, cv::IMREAD_COLOR);
  if (image.empty())
    throw std::runtime_error("frame of " + std::to_string(jpeg.size()) + " bytes is no image");
  return image;
}

void to_grey(const cv::Mat& bgr, Grey& grey) {
  grey.full.create(bgr.size(), CV_8UC1);
  grey.half.create(bgr.rows / 2, bgr.cols / 2, CV_8UC1);
  for (int y = 0; y < bgr.rows; ++y) {
    const cv::Vec3b* in = bgr.ptr<cv::Vec3b>(y);
    unsigned char* out = grey.full.ptr(y);
    for (int x = 0; x < bgr.cols; ++x)
      out[x] =
          static_cast<unsigned char>((77 * in[x][2] + 150 * in[x][1] + 29 * in[x][0] + 128) >> 8);
  }
  for (int y = 0; y < grey.half.rows; ++y) {
    const unsigned char* a = grey.full.ptr(2 * y);
    const unsigned char* b = grey.full.ptr(2 * y + 1);
    unsigned char* out = grey.half.ptr(y);
    for (int x = 0; x < grey.half.cols; ++x)
      out[x] =
          static_cast<unsigned char>((a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1] + 2) >> 2);
  }
}

std::vector<Detection> detect_people(const cv::Mat& grey) {
  static const cv::HOGDescriptor hog = [] {
    cv::HOGDescriptor made;
    made.setSVMDetector(cv::HOGDescriptor::getDefaultPeopleDetector());
    return made;
  }();
  std::vector<cv::Rect> boxes;
  std::vector<double> weights;
  hog.detectMultiScale(grey, boxes, weights, 0.0, cv::Size(8, 8), cv::Size(), 1.1, 2.0);
  std::vector<Detection> people;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    if (weights[i] < kMinHogWeight) continue;
    // The detector's window has a margin of about an eighth around the person.
    cv::Rect box = boxes[i];
    box.x += box.width / 8;
    box.y += box.height / 16;
    box.width -= box.width / 4;
    box.height -= box.height / 8;
    people.push_back({box & cv::Rect(0, 0, grey.cols, grey.rows), weights[i]});
  }
  return people;
}

cv::Ptr<cv::BackgroundSubtractorMOG2> make_background() {
  return cv::createBackgroundSubtractorMOG2(100, 25, false);
}

void subtract_background(cv::BackgroundSubtractorMOG2& background, const cv::Mat& half,
                         cv::Mat& mask) {
  background.apply(half, mask);
}

void clean_mask(const cv::Mat& mask, cv::Mat& clean) {
  clean.create(mask.size(), CV_8UC1);
  for (int y = 0; y < mask.rows; ++y)
    for (int x = 0; x < mask.cols; ++x) {
      int set = 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          const int yy = y + dy, xx = x + dx;
          if (yy >= 0 && yy < mask.rows && xx >= 0 && xx < mask.cols)
            set += mask.ptr(yy)[xx] != 0 ? 1 : 0;
        }
      clean.ptr(y)[x] = set >= 5 ? 255 : 0;
    }
}

std::vector<Detection> fuse(const std::vector<Detection>& people, const cv::Mat& foreground) {
  std::vector<Detection> moving;
  for (const Detection& person : people) {
    const cv::Rect half(person.box.x / 2, person.box.y / 2, person.box.width / 2,
                        person.box.height / 2);
    const cv::Rect inside = half & cv::Rect(0, 0, foreground.cols, foreground.rows);
    if (inside.area() == 0) continue;
    const double share = static_cast<double>(cv::countNonZero(foreground(inside))) / inside.area();
    if (share >= kMinForeground) moving.push_back({person.box, person.score + share});
  }
  cv::Mat labels, stats, centroids;
  const int blobs = cv::connectedComponentsWithStats(foreground, labels, stats, centroids, 8);
  for (int i = 1; i < blobs; ++i) {
    const cv::Rect box(
        2 * stats.at<int>(i, cv::CC_STAT_LEFT), 2 * stats.at<int>(i, cv::CC_STAT_TOP),
        2 * stats.at<int>(i, cv::CC_STAT_WIDTH), 2 * stats.at<int>(i, cv::CC_STAT_HEIGHT));
    const double upright = static_cast<double>(box.height) / box.width;
    if (stats.at<int>(i, cv::CC_STAT_AREA) < kMinBlobArea || upright < 1.2 || upright > 4.5)
      continue;
    moving.push_back({box, 0.2});  // less than any HOG detection: kept only where there is none
  }
  return best_of_overlapping(std::move(moving));
}

std::vector<Track> Tracker::update(const std::vector<Detection>& detections) {
  for (Track& track : tracks_) {
    track.box.x += track.velocity.x;
    track.box.y += track.velocity.y;
    ++track.age;
    ++track.missed;
  }
  struct Pair {
    double overlap;
    std::size_t track, detection;
  };
  std::vector<Pair> pairs;
  for (std::size_t t = 0; t < tracks_.size(); ++t)
    for (std::size_t d = 0; d < detections.size(); ++d)
      if (const double o = overlap(tracks_[t].box, detections[d].box); o >= kSameObject)
        pairs.push_back({o, t, d});
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const Pair& a, const Pair& b) { return a.overlap > b.overlap; });
  std::vector<char> track_used(tracks_.size(), 0), detection_used(detections.size(), 0);
  for (const Pair& pair : pairs) {
    if (track_used[pair.track] || detection_used[pair.detection]) continue;
    track_used[pair.track] = detection_used[pair.detection] = 1;
    Track& track = tracks_[pair.track];
    const cv::Rect2d seen = detections[pair.detection].box;
    const cv::Point2d error = centre(seen) - centre(track.box);
    track.velocity += 0.3 * error;
    const cv::Point2d at = centre(track.box) + 0.7 * error;
    track.box.width += 0.3 * (seen.width - track.box.width);
    track.box.height += 0.3 * (seen.height - track.box.height);
    track.box.x = at.x - track.box.width / 2;
    track.box.y = at.y - track.box.height / 2;
    track.missed = 0;
  }
  std::erase_if(tracks_, [](const Track& track) { return track.missed > kMaxMissed; });
  for (std::size_t d = 0; d < detections.size(); ++d)
    if (!detection_used[d]) tracks_.push_back({next_id_++, detections[d].box, {0, 0}, 0, 0});
  std::vector<Track> seen;
  for (const Track& track : tracks_)
    if (track.age >= 2 && track.missed == 0) seen.push_back(track);
  return seen;
}

std::vector<cv::Point2d> predict(const Track& track, int frames) {
  std::vector<cv::Point2d> path;
  for (int i = 1; i <= frames; ++i) path.push_back(centre(track.box) + i * track.velocity);
  return path;
}

void annotate(cv::Mat& image, const std::vector<Track>& tracks, int path_frames) {
  static const cv::Scalar kColours[] = {{0, 159, 230},  {233, 180, 86}, {115, 158, 0},
                                        {66, 228, 240}, {178, 114, 0},  {0, 94, 213},
                                        {167, 121, 204}};
  for (const Track& track : tracks) {
    const cv::Scalar& colour = kColours[static_cast<std::size_t>(track.id) % std::size(kColours)];
    cv::rectangle(image, track.box, colour, 2);
    cv::putText(image, "#" + std::to_string(track.id), track.box.tl() + cv::Point2d(2, -5),
                cv::FONT_HERSHEY_SIMPLEX, 0.6, colour, 1, cv::LINE_AA);
    cv::Point2d from = centre(track.box);
    for (const cv::Point2d& to : predict(track, path_frames)) {
      cv::line(image, from, to, colour, 2);
      from = to;
    }
    cv::circle(image, from, 3, colour, -1);
  }
}

}  // namespace pedestrians
